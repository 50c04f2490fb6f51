"""Events: collected from what is seen scan by scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import FloatArray

JOIN_NS = 1_000_000_000
"""Spells of the same thing with a shorter pause between them are one."""


@dataclass(slots=True)
class Spell:
    """A stretch of scans of which the same can be said.

    moved: (3,) from the pose before its first scan to that of its last.
    """

    start_ns: int
    end_ns: int
    scans: int
    T_before: FloatArray
    T_last: FloatArray

    @property
    def moved_m(self) -> float:
        """Distance between its beginning and its end."""
        moved = between(self.T_before, self.T_last)
        return float(np.hypot(moved[0], moved[1]))

    @property
    def turned_rad(self) -> float:
        """Turn between its beginning and its end, without sign."""
        return abs(float(between(self.T_before, self.T_last)[2]))

    @property
    def seconds(self) -> float:
        """From its first scan to its last."""
        return (self.end_ns - self.start_ns) * 1e-9


class Spells:
    """Joins single scans to spells."""

    def __init__(self) -> None:
        self._spells: list[Spell] = []

    def __iter__(self) -> Iterator[Spell]:
        return iter(self._spells)

    def mark(self, stamp_ns: int, T_before: FloatArray, T_map_base: FloatArray) -> None:
        """One more scan of the kind, and the pose before it. Both (3,)."""
        last = self._spells[-1] if self._spells else None
        if last is None or stamp_ns - last.end_ns > JOIN_NS:
            self._spells.append(Spell(stamp_ns, stamp_ns, 1, T_before, T_map_base))
            return
        last.end_ns, last.T_last = stamp_ns, T_map_base
        last.scans += 1
