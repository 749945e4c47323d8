"""Chooses the planes between cells: uniform, or balanced by a sampling pre-pass and its costs.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
