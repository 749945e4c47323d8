"""Loads user code into a node: the form of a program, its compilation, and where it enters the ray step.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
