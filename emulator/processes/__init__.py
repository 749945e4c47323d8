"""Launches and supervises the nodes' processes: fork server, control channels, the array of real processes.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
