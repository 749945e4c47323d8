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
    from raygrid import aio
    from raygrid.host.client.client import Service, Submitted, connect
    from raygrid.host.client.job_events import Result
    from raygrid.host.machine_time.predict import Prediction, predict
    from raygrid.host.render.api import Machine, Picture, launch, load_scene
    from raygrid.host.render.progress import RenderProgress
    from raygrid.host.render.renderer import Renderer
    from raygrid.host.scene.formats.memory_scene import MemoryScene as Scene
    from raygrid.host.scene.scene import Scene as LoadedScene
    from raygrid.host.text.remarks import RemarkWarning
    from raygrid.node.errors import ArrayError, OutputError, RaygridError, SceneError

    __version__: str

# public name -> module, and what it is called there
_HOMES = {
    **dict.fromkeys(("Service", "Submitted", "connect"), ("raygrid.host.client.client", "")),
    **dict.fromkeys(("Machine", "Picture", "launch", "load_scene"), ("raygrid.host.render.api", "")),
    **dict.fromkeys(("Prediction", "predict"), ("raygrid.host.machine_time.predict", "")),
    **dict.fromkeys(("ArrayError", "OutputError", "RaygridError", "SceneError"), ("raygrid.node.errors", "")),
    "RemarkWarning": ("raygrid.host.text.remarks", ""),
    "RenderProgress": ("raygrid.host.render.progress", ""),
    "Renderer": ("raygrid.host.render.renderer", ""),
    "Result": ("raygrid.host.client.job_events", ""),
    "Scene": ("raygrid.host.scene.formats.memory_scene", "MemoryScene"),
    "LoadedScene": ("raygrid.host.scene.scene", "Scene"),
}

__all__ = [
    "ArrayError",
    "LoadedScene",
    "Machine",
    "OutputError",
    "Picture",
    "Prediction",
    "RaygridError",
    "RemarkWarning",
    "RenderProgress",
    "Renderer",
    "Result",
    "Scene",
    "SceneError",
    "Service",
    "Submitted",
    "aio",
    "connect",
    "launch",
    "load_scene",
    "predict",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("raygrid")
    if name == "aio":
        return import_module("raygrid.aio")
    if name in _HOMES:
        module, known = _HOMES[name]
        return getattr(import_module(module), known or name)
    raise AttributeError(f"module 'raygrid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name.startswith("__"))})
