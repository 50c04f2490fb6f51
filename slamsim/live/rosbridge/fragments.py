"""Messages that are sent in several parts: the operation ``fragment``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from slamsim.io.ros.values import WrongMessage

LARGEST_MESSAGE = 4 << 20
"""Bytes of a message that a client may send, in one frame or in fragments. Parsing that much JSON
holds the interpreter's lock for some 40 ms, and no client shall delay another by more."""
MOST_OPEN = 16
"""Fragmented messages of one client that may be incomplete at a time."""
MOST_PARTS = 10_000
LONGEST_AGE_S = 60.0
"""How long parts of a message may take to arrive after its first one."""


@dataclass(slots=True)
class _Open:
    total: int
    since_s: float
    parts: dict[int, str] = field(default_factory=dict)
    size: int = 0


class Fragments:
    """Joins the fragments of one connection. largest: bytes of all that are incomplete."""

    def __init__(self, largest: int = LARGEST_MESSAGE) -> None:
        self._largest = largest
        self._open: dict[str | int, _Open] = {}

    def add(self, operation: Mapping[str, Any], now_s: float) -> str | None:
        """The whole text once its last part is here. now_s: any steady clock.

        Raises WrongMessage for a part that does not fit, and forgets the message it belongs to.
        """
        self._open = {
            k: one for k, one in self._open.items() if now_s - one.since_s < LONGEST_AGE_S
        }
        key, number, total, data = (operation.get(k) for k in ("id", "num", "total", "data"))
        if type(number) is not int or type(total) is not int or not isinstance(key, str | int):
            raise WrongMessage("a fragment needs an 'id', and whole numbers as 'num' and 'total'")
        if not isinstance(data, str):
            raise WrongMessage("the 'data' of a fragment must be a string")
        if not 0 <= number < total <= MOST_PARTS:
            self._open.pop(key, None)
            raise WrongMessage(f"fragment {number} of {total}; at most {MOST_PARTS} are read")
        if key not in self._open and len(self._open) >= MOST_OPEN:
            raise WrongMessage(f"{MOST_OPEN} fragmented messages are incomplete already")
        message = self._open.setdefault(key, _Open(total, now_s))
        if message.total != total or message.parts.get(number, data) != data:
            del self._open[key]
            raise WrongMessage(f"fragment {number} contradicts those before it")
        if number not in message.parts:
            message.parts[number] = data
            message.size += len(data)
        if sum(one.size for one in self._open.values()) > self._largest:
            del self._open[key]
            raise WrongMessage(f"fragments of more than {self._largest:,} bytes")
        if len(message.parts) < total:
            return None
        del self._open[key]
        return "".join(message.parts[n] for n in range(total))


def split(text: bytes, size: int, name: str) -> Iterator[bytes]:
    """ASCII text of one operation as operations of at most ``size`` bytes of it each; as it is
    where it is no longer."""
    if len(text) <= size:
        yield text
        return
    total = -(-len(text) // size)
    for number in range(total):
        data = text[number * size : (number + 1) * size].decode("ascii")
        part = {"op": "fragment", "id": name, "data": data, "num": number, "total": total}
        yield json.dumps(part).encode()
