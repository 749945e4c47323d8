"""Loads user code into a node: the form of a program, its compilation, and where it enters the ray step.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
