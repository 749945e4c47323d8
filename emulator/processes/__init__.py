"""Launches and supervises the nodes' processes: fork server, control channels, the array of real processes.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
