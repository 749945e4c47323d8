"""Explains what an array does: the ray tree of a sample, one packet at a time, and the deadlock of finite buffers.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
