"""Holds space and surfaces: the lattice, the walk over cells, surfaces and motions, hits, the hierarchy, the spanning tree.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
