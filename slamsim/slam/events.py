"""Events: collected from what is seen scan by scan, and told with their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.result import Event, EventKind
from slamsim.core.types import FloatArray

JOIN_NS = 1_000_000_000
"""Spells of the same thing with a shorter pause between them are one."""

TOLD_PER_KIND = 5

BY_WEIGHT: tuple[EventKind, ...] = (
    *("kidnapped", "torn", "joined", "odometry", "lost", "lidar", "open loop"),
    *("unrefined", "blind", "frozen", "jump", "slip", "gap"),
)
"""From what makes a map wrong, over what may have done so, to what the map has coped with."""


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


def in_words(events: Iterable[Event], begin_ns: int) -> tuple[str, ...]:
    """One line per event, times in seconds since the log's begin; of many of a kind the longest."""
    by_kind: dict[EventKind, list[Event]] = {}
    for event in events:
        by_kind.setdefault(event.kind, []).append(event)
    told: list[tuple[int, str]] = []
    for kind, alike in by_kind.items():
        longest = sorted(alike, key=lambda one: one.start_ns - one.end_ns)[:TOLD_PER_KIND]
        told += [(one.start_ns, f"{_when(one, begin_ns)}: {one.words}") for one in longest]
        if len(alike) > len(longest):
            rest = len(alike) - len(longest)
            told.append((alike[-1].start_ns, f"{rest} more like this ({kind}), shorter"))
    return tuple(words for _, words in sorted(told, key=lambda one: one[0]))


def by_weight(events: Iterable[Event], begin_ns: int) -> list[tuple[EventKind, str]]:
    """A line for each kind, the gravest first: its longest event, and how many more there are."""
    by_kind: dict[EventKind, list[Event]] = {}
    for event in events:
        by_kind.setdefault(event.kind, []).append(event)
    told: list[tuple[EventKind, str]] = []
    for kind in sorted(by_kind, key=BY_WEIGHT.index):
        longest = max(by_kind[kind], key=lambda one: one.end_ns - one.start_ns)
        more = f" ({rest} more like this)" if (rest := len(by_kind[kind]) - 1) else ""
        told.append((kind, f"{_when(longest, begin_ns)}: {longest.words}{more}"))
    return told


def _when(event: Event, begin_ns: int) -> str:
    start_s, end_s = (event.start_ns - begin_ns) * 1e-9, (event.end_ns - begin_ns) * 1e-9
    if end_s - start_s < 0.1:
        return f"at {start_s:.1f} s"
    return f"{start_s:.1f} to {end_s:.1f} s"
