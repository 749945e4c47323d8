"""raygrid: the parallel ray tracing computer of 1983, running.

    import raygrid

    with raygrid.launch("2x2x2") as array:
        picture = array.render("scenes/room.glb", size=(640, 480))
        picture.save("room.png")
        radiance = picture.linear()      # float64 (480, 640, 3)

Names are loaded when first used, because nodes import parts of this package and nothing of the front end.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raygrid.host.client.client import Result, Service, Submitted, connect
    from raygrid.host.machine_time.predict import Prediction, predict
    from raygrid.host.render.api import Machine, Picture, Scene, launch, load_scene
    from raygrid.node.errors import ArrayError, OutputError, RaygridError, SceneError

    __version__: str

_HOMES = {
    "raygrid.host.client.client": ("Result", "Service", "Submitted", "connect"),
    "raygrid.host.machine_time.predict": ("Prediction", "predict"),
    "raygrid.host.render.api": ("Machine", "Picture", "Scene", "launch", "load_scene"),
    "raygrid.node.errors": ("ArrayError", "OutputError", "RaygridError", "SceneError"),
}

__all__ = [
    "ArrayError",
    "Machine",
    "OutputError",
    "Picture",
    "Prediction",
    "RaygridError",
    "Result",
    "Scene",
    "SceneError",
    "Service",
    "Submitted",
    "connect",
    "launch",
    "load_scene",
    "predict",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("raygrid")
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module 'raygrid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name.startswith("__"))})
