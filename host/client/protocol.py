"""Packs and reads the messages between a client and an array that stays: maps in msgpack, each behind its length.

No socket in here. What comes is checked before it is used: the length before it is waited for, the number of items and the depth of
nesting, and that there are only strings, numbers, booleans, nothing, lists and maps with string keys.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgpack

from raygrid.host.text.clean_text import SHOWN, shown
from raygrid.node.errors import ProtocolError
from raygrid.node.protocol import MapLimits, Splitter, framed, read_map

Message = dict[str, Any]

VERSION = 1
LONGEST = 1 << 23  # bytes of a message
LONGEST_GREETING = 1 << 10  # of the first message of a client, before it is known
MOST_ITEMS = 1 << 17  # of a list or map
DEEPEST = 6  # lists and maps within each other
LIMITS = MapLimits(MOST_ITEMS, DEEPEST, most_bytes=0)
PLAIN = (str, int, float, bool, type(None))


def pack(message: Message, escape: bool = False) -> bytes:
    """A message as bytes. Raises ProtocolError if it is too long, or cannot be one.

    escape  text that is no UTF-8, such as a path may be, instead of refusing the message: for what is only to be read
    """
    try:
        body: bytes = msgpack.packb(
            message, use_bin_type=True, unicode_errors="backslashreplace" if escape else "strict"
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise ProtocolError(f"a message cannot be sent: {str(error).splitlines()[0][:200]}") from None
    if len(body) > LONGEST:
        raise ProtocolError(f"a message of {len(body)} bytes was to be sent, wanted at most {LONGEST}")
    return framed(body)


def unpack(body: bytes | bytearray) -> Message:
    """The map in the body of a message. Raises ProtocolError for anything else."""
    message = read_map(body, "a message", LIMITS)
    _check_plain(message)
    return message


def _check_plain(value: Message | list[object]) -> None:
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            _check_plain(inner)
        elif not isinstance(inner, PLAIN):  # msgpack lets a string of no bytes pass
            raise ProtocolError(f"a message came with {type(inner).__name__}, wanted plain text and numbers")


def message_splitter(longest: int = LONGEST) -> Splitter[Message]:
    """Cuts what comes from the other side into messages."""
    return Splitter(unpack, longest)


def unsendable(message: Message) -> str:
    """What in a message cannot be sent, in one sentence; "" if all can."""
    for place, value, wanted in _wrong(message, "", DEEPEST):
        return f"{place.removeprefix('settings.') or 'a message'} came as {shown(value)}, wanted {wanted}"
    return ""


def _wrong(value: object, place: str, deeper: int) -> Iterator[tuple[str, object, str]]:
    if isinstance(value, dict | list):
        if deeper == 0 or len(value) > MOST_ITEMS:
            yield place, value, f"at most {MOST_ITEMS} items, and at most {DEEPEST} lists and maps within each other"
            return
        pairs = [(place, item) for item in value]
        if isinstance(value, dict):
            pairs = [(".".join(filter(None, (place, _name(key)))), item) for key, item in value.items()]
            of = f"a key of {place or 'a message'}"
            yield from ((of, key, "text in UTF-8") for key in value if type(key) is not str or _is_torn(key))
        for inner, item in pairs:
            yield from _wrong(item, inner, deeper - 1)
    elif isinstance(value, str):
        if _is_torn(value):
            yield place, value, "a name in UTF-8"
    elif isinstance(value, int):
        if not -(1 << 63) <= value < 1 << 64:
            yield place, value, "a whole number of at most 64 bits"
    elif not isinstance(value, PLAIN):
        yield place, value, "text, a number, true or false, or a list of these"


def _is_torn(text: str) -> bool:
    """Whether a text has halves of characters, as names have that are no UTF-8."""
    return any("\ud800" <= letter <= "\udfff" for letter in text)


def _name(key: object) -> str:
    return key[:SHOWN] if isinstance(key, str) and key.isprintable() else shown(key)
