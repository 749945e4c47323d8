"""Compiles kernels: decorators, the cache on disk, vectors of eight. The only package that knows numba's and llvmlite's insides.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
