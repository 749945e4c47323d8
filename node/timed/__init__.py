"""Keeps machine time in a node: the service clock, conservative look-ahead, and the processor that uses both.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
