"""What a walk over a damaged recording comes by, besides chunks and declarations."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LoneMessage:
    """record: of a message outside of all compressed chunks, whole, as it is in the file."""

    record: bytes


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that are of no use. messages: how many by channel or connection id, None where
    nothing tells."""

    first_byte: int
    bytes: int
    reason: str
    messages: dict[int, int] | None = None
