"""In which order files of tests begin, two at a time: so that both workers have work until the end.

A worker gets a file at a time. One that takes long and comes last leaves the other worker idle, so the longest begin first. Before
them the kernels are compiled, which one process must do: by the file that needs most of them, while the other worker has files
that need none. Two that began with kernels would each compile the same ones, as neither finds them in the cache yet.

Names of files, wherever they are below this folder.
"""

from __future__ import annotations

COMPILES = ("test_programs",)
WITHOUT_KERNELS = (  # or with small ones of their own; about as long as compiling
    *(
        "test_cache",
        "test_fork_server_client",
        "test_nff",
        "test_messages",
        "test_commands",
        "test_link_flow",
        "test_link",
    ),
    *(
        "test_meshes",
        "test_gltf",
        "test_file_access",
        "test_bad_scenes",
        "test_toml",
        "test_scene",
        "test_ply",
    ),
    *(
        "test_polygons",
        "test_socket_directory",
        "test_control_channel",
        "test_journal",
        "test_imports",
        "test_provenance",
    ),
)
LONG = (
    *(
        "test_campaign",
        "test_docs_commands",
        "test_increments",
        "test_step",
        "test_timed_processor",
        "test_service_keeps",
    ),
    *(
        "test_fast_load",
        "test_service_faults",
        "test_service_hostile",
        "test_stopping",
        "test_bounds",
        "test_grid_walk",
    ),
    *(
        "test_service_clients",
        "test_service_programs",
        "test_service_commands",
        "test_service_films",
        "test_right_picture",
    ),
    *("test_memory_array", "test_probe_array", "test_known_pictures", "test_simulator", "test_service_animations"),
)
FIRST = (*COMPILES, *WITHOUT_KERNELS, *LONG)
_PLACES = {name: place for place, name in enumerate(FIRST)}


def place_of(name: str) -> int:
    """Where a file comes; those that are not named come after all others, in their own order."""
    return _PLACES.get(name, len(FIRST))
