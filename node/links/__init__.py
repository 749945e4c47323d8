"""Carries messages between two neighbours: the link protocol over channels of ZeroMQ, of memory, or bad on purpose.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
