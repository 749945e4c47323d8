"""Defines the errors of a wrong request, whatever the files hold: exit code 2, where the others are 1.

Each is also the error that the Python interface documents for its place. Whether a file is there, can be read or
written, holds what is wanted, or fits this computer is no misuse.
"""

from __future__ import annotations

from raygrid.node.errors import ArrayError, CostError, OutputError, RaygridError, SceneError


class Misuse(RaygridError):
    """Arguments that cannot be, alone or together."""


class SceneMisuse(Misuse, SceneError):
    """Of what is to be rendered."""


class OutputMisuse(Misuse, OutputError):
    """Of what is to be written."""


class CostMisuse(Misuse, CostError):
    """Of a cost model."""


class ArrayMisuse(Misuse, ArrayError):
    """Of the array."""
