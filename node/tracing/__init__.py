"""Traces rays through one cell: the ray step, a pure function of cell, surfaces, frame and packets, and what it reads and writes.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
