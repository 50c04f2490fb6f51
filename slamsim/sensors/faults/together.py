"""Which faults may be in one recording, such that each can be told."""

from __future__ import annotations

from slamsim.sensors.faults.base import Fault


def told_apart(one: Fault, other: Fault) -> bool:
    """Whether neither hides the other, nor looks like it."""
    names = ({one.expects, *one.also}, {other.expects, *other.also})
    if names[0] & names[1]:
        return False
    return other.expects not in one.hides and one.expects not in other.hides
