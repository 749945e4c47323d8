"""Runs a living node: its processor, its state, the event loop, reductions, increments, probes and reports.

What it gives to other layers is listed in `__init__.pyi`; each name is loaded when it is first used.
"""

from raygrid.node.faces import face

__getattr__, __dir__ = face(__name__, __file__)
