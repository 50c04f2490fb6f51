"""What happens on the way that a user should know of: looked for at every scan, told at the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.result import Event
from slamsim.core.types import FloatArray
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.matching.base import Match

TrackingState = Literal["first", "matched", "blind", "lost", "held back"]
"""A scan that began a map, that was matched, that saw too little, that fitted nowhere, that is kept
to be matched with the next ones."""

FEW_SCANS = 3
"""So many scans in a row without a place are not worth telling."""

LONG_GAP_S = 3.0
SHORT_GAP_S = 1.0
MOVED_M = 0.5
TURNED_RAD = 0.5
"""A gap counts if it is long, or if the robot has moved meanwhile."""

FROZEN_M = 1e-6
FROZEN_S = 2.0
TURN_TO_COMPARE_RAD = 0.01
MIN_TURNED_RAD = 1.5
"""Turns of the odometry are compared with those of the scans when they add up to this much."""

MIRRORED_SHARE = -0.3
"""Turns of the scans along those of the odometry, over all turns: 1 for a lidar the right way up,
-1 for one that is mirrored, about 0 for noise."""


UNPLACED_SHARE = 0.5
"""Of the path: a map of which scans place less than this is one of the odometry."""

SIDEWAYS = 0.5
"""A direction that scans do not show is a turn, not a way, if less of it than this is metres."""

LEAST_PATH_M = 2.0
"""A robot that has hardly moved is where it was, whatever its scans show."""

JOIN_NS = 1_000_000_000
"""Spells of the same thing with a shorter pause between them are one."""


class EventMonitor:
    """Sees each tracked scan once, in time order, and remembers what was odd."""

    def __init__(self) -> None:
        self._blind, self._lost, self._frozen, self._jumps = Spells(), Spells(), Spells(), Spells()
        self._silent, self._reported = Spells(), False
        self._single: list[Event] = []
        self._held_back: list[tuple[int, FloatArray, FloatArray]] = []
        self._last_ns: int | None = None
        self._first_ns = 0
        self._T_map_base: FloatArray = np.zeros(3)
        self._turned = self._same_turn = 0.0
        self._path_m = self._unplaced_m = 0.0

    def see(
        self,
        prediction: Prediction,
        T_map_base: FloatArray,
        state: TrackingState,
        match: Match | None = None,
    ) -> None:
        """One more scan, where it was placed, and why there. T_map_base: (3,)."""
        before, stamp_ns = self._T_map_base, prediction.stamp_ns
        if state == "held back" and self._last_ns is not None:
            self._look_for_gap(stamp_ns, between(before, T_map_base))
            self._held_back.append((stamp_ns, before, T_map_base))
            self._last_ns = stamp_ns
            return
        self._T_map_base = T_map_base
        if self._last_ns is None:
            self._first_ns = self._last_ns = stamp_ns
            return
        if state in ("blind", "lost"):
            spells = self._blind if state == "blind" else self._lost
            for one in (*self._held_back, (stamp_ns, before, T_map_base)):
                spells.mark(*one)
        self._held_back.clear()
        moved, step = between(before, T_map_base), prediction.T_last_base
        moved_m = float(np.hypot(moved[0], moved[1]))
        self._path_m += moved_m
        self._unplaced_m += moved_m if state in ("blind", "lost") else _unseen_m(moved, match)
        self._look_for_gap(stamp_ns, moved)
        self._reported |= prediction.odometry is not None
        if prediction.odometry is None:
            self._silent.mark(stamp_ns, before, T_map_base)
        if prediction.jump:
            self._jumps.mark(stamp_ns, np.zeros(3), step)
        elif state == "matched":
            if np.hypot(step[0], step[1]) < FROZEN_M:
                self._frozen.mark(stamp_ns, before, T_map_base)
            if abs(step[2]) > TURN_TO_COMPARE_RAD:
                self._turned += abs(float(step[2]))
                self._same_turn += float(moved[2] * np.sign(step[2]))
        self._last_ns = stamp_ns

    def add(self, event: Event) -> None:
        """An event from elsewhere."""
        self._single.append(event)

    def events(self) -> tuple[Event, ...]:
        """All events so far, by their starts."""
        return tuple(sorted(self._all(), key=lambda event: event.start_ns))

    def _all(self) -> Iterator[Event]:
        yield from self._single
        if self._path_m > LEAST_PATH_M and self._unplaced_m > UNPLACED_SHARE * self._path_m:
            share = self._unplaced_m / self._path_m
            words = f"{share:.0%} of the path follow the odometry alone: the map is no better there"
            yield Event(self._first_ns, self._last_ns or self._first_ns, "odometry", words)
        for spell in self._blind:
            if spell.scans > FEW_SCANS:
                words = f"{spell.scans} scans with too few returns, placed by odometry alone"
                yield Event(spell.start_ns, spell.end_ns, "blind", words)
        for spell in self._lost:
            if spell.scans > FEW_SCANS:
                words = f"{spell.scans} scans fitted nowhere, placed by odometry alone"
                yield Event(spell.start_ns, spell.end_ns, "lost", words)
        for spell in self._silent if self._reported else ():
            if spell.seconds >= SHORT_GAP_S:
                words = f"no odometry for {spell.seconds:.1f} s: followed by the scans alone"
                yield Event(spell.start_ns, spell.end_ns, "gap", words)
        for spell in self._jumps:
            size = f"{spell.moved_m:.1f} m and {np.rad2deg(spell.turned_rad):.0f} deg"
            words = f"the odometry jumped by {size}, which was not believed"
            yield Event(spell.start_ns, spell.end_ns, "jump", words)
        for spell in self._frozen:
            if spell.seconds >= FROZEN_S and spell.moved_m > MOVED_M:
                words = f"the odometry stood still while the robot moved {spell.moved_m:.1f} m"
                yield Event(spell.start_ns, spell.end_ns, "frozen", words)
        if self._turned > MIN_TURNED_RAD and self._same_turn < MIRRORED_SHARE * self._turned:
            yield Event(self._first_ns, self._last_ns or self._first_ns, "lidar", _MIRRORED)

    def _look_for_gap(self, stamp_ns: int, moved: FloatArray) -> None:
        assert self._last_ns is not None
        seconds = (stamp_ns - self._last_ns) * 1e-9
        moved_m, turned_rad = float(np.hypot(moved[0], moved[1])), abs(float(moved[2]))
        far = moved_m > MOVED_M or turned_rad > TURNED_RAD
        if seconds >= LONG_GAP_S or (seconds >= SHORT_GAP_S and far):
            words = f"no scans for {seconds:.1f} s, in which the robot moved {moved_m:.1f} m"
            self._single.append(Event(self._last_ns, stamp_ns, "gap", words))


def _unseen_m(moved: FloatArray, match: Match | None) -> float:
    """How far the robot moved in directions that its scan does not show, as along a corridor."""
    if match is None or not match.degenerate:
        return 0.0
    directions = match.degenerate_directions[:, :2]
    lengths = np.linalg.norm(directions, axis=1)
    along = directions[lengths > SIDEWAYS] / lengths[lengths > SIDEWAYS, None]
    return float(np.abs(along @ moved[:2]).max(initial=0.0))


_MIRRORED = (
    "the scans turn against the odometry: the lidar seems to be mounted upside down, "
    "and the transform to it does not say so"
)


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
