"""The errors that raygrid raises on purpose. Anything else that escapes is a bug.

RaygridError                     every message is one sentence: where, what came, what was wanted
├── SceneError                   a scene, mesh or camera that cannot be rendered
├── OutputError                  a picture or record that cannot be written
├── ProtocolError                a neighbour (or the host) sent what it must not
│   └── PacketError              25 bytes that are no packet of this frame
└── ArrayError                   the machine itself
    ├── TooLarge                 it does not fit this computer, with the largest that does
    ├── LostProcess              a processor ended or stopped
    ├── Garbled                  what came is not what was sent: refused, miscounted
    └── Stuck                    no counter moves, and packets are still in flight
"""

from __future__ import annotations


class RaygridError(Exception):
    """Base of all errors that a user can meet."""


class SceneError(RaygridError):
    """A scene, mesh or camera that cannot be rendered."""


class OutputError(RaygridError):
    """A picture or record that cannot be written."""


class ProtocolError(RaygridError):
    """A neighbour or the host sent what it must not send now."""


class PacketError(ProtocolError):
    """Twenty-five bytes that are not a packet of this frame."""


class ArrayError(RaygridError):
    """The array could not be launched, loaded or driven."""


class TooLarge(ArrayError):
    """The array asked for does not fit this computer."""


class LostProcess(ArrayError):
    """A processor ended or stopped answering."""


class Garbled(ArrayError):
    """Nodes refused what came to them, or the counts of what was sent and what came do not agree."""


class Stuck(ArrayError):
    """No counter moves although packets are in flight."""
