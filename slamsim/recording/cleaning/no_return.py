"""Estimates from the readings of a lidar which values mean no return.

Drivers write 0, ``inf``, the declared maximum or a code of their own (81.91, 51.05 to 51.12): a
pile-up at the top of the readings. Two tests ask how likely surfaces would show as much.

1. Over the path. The readings of a surface change with the robot's position, so over looks from
   different places a narrow band at the top is occupied about as often as other bands of that width
   at long range. The number of looks that occupy it is compared with the most often occupied of
   those by a Chernoff bound of the binomial distribution. Where positions are not known all scans
   are looks and bands at every range are compared, which a robot at rest fills as often.
2. Within a scan. On a flat wall ranges grow as 1/cos of the angle to its normal: a run of more
   beams within a band than that allows needs unrelated surfaces at one distance, each with a chance
   of the band's width over half the range.

Just below the declared maximum a band may hold surfaces that the range cuts off, as a wall along
which the robot drives. There the first test asks, where positions are known, only readings between
two much nearer ones, which are no part of such a surface. A surface that is seen through gaps, and
wherever the robot drives in the last quarter of a percent of the range, would be lost.

Surfaces alone are taken for a code with a probability below ``FALSE_ALARM``.

Simulators add noise to the maximum that stands for no return. Half of such readings fall short of
it, by the noise of the lidar; where both beams beside one return nothing, every second one does,
which no surface makes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray

FALSE_ALARM = 1e-6
WIDEST_BAND = 2.5e-3
"""Of the range: 51.05 to 51.16 m is the widest pile-up seen in practice, 0.22 %."""
HALVINGS = 6
CELL_M = 0.25
"""Looks come from different cells of this size, which the widest band does not exceed at 80 m."""
OUTLIERS = 1e-4
"""Share of readings that may lie above a code: single wrong measurements."""
NEAR_DECLARED = 0.99
"""From here on a spread of readings may be surfaces cut off by the range: repeats count, and
readings that stand out."""
STANDS_OUT = 0.9
"""Both neighbours of a reading that stands out are nearer than this share of it: a surface of all
three would slant by more than 80 degrees even where beams are a degree apart."""
LEAST_SHORT, LEAST_SHORT_SHARE = 20, 0.25
"""Of the beams between two that return nothing, so many and such a share fall short where noise is
added to no return, which makes a half. Surfaces that are cut off by the range, or lose most of
their returns, make some per cent: the rest of the view returns nothing at all."""
MOST_NOISE, NOISE_SIGMAS = 0.03, 5.0
"""Of the range; no lidar has more noise. Of readings that fall short, one in two million does so by
more than so many sigmas."""
LEAST_BEYOND, MAX_BEYOND, MOST_BEYOND = 20, 2e-3, 0.5
"""A declared maximum is wrong if so many readings exceed it and more than the first share: fewer
are rounding. If more than the second share do, the unit is wrong."""
SAMPLED_READINGS = 1_000_000

_Rows = Sequence[Float32Array] | Float32Array
_UNKNOWN_STEP_RAD = 1e-9  # so small that no run of beams is too long for a flat wall
MOST_CODES = 25
"""Scanners have up to nine error codes (SICK), and noise or units may split each of them. What
seems to have more is a room in which all beams of a scan are alike: peeling those off took minutes.
"""
_LOG_LEVEL = math.log(FALSE_ALARM / (2 * 2 * (HALVINGS + 2) * MOST_CODES))
"""Both tests, both tops, every width, and all codes share the false alarm rate."""


@dataclass(frozen=True, slots=True)
class Code:
    """Readings from lowest_m to highest_m mean no return; count of them in the sample. is_noisy:
    whether they do because noise is added to what stands for no return."""

    lowest_m: float
    highest_m: float
    count: int
    is_noisy: bool = False

    def __str__(self) -> str:
        lowest = "" if self.lowest_m == self.highest_m else f"{self.lowest_m:.6g} to "
        return f"{lowest}{self.highest_m:.6g} m"


@dataclass(frozen=True, slots=True)
class RangeLimit:
    """What the readings say of a lidar's range.

    codes: below the declared maximum, or any if that is wrong. beyond: share of readings above the
    declared maximum, 0 unless these are surfaces. usable_m: readings from here on are no return;
    None where the declared maximum stands.
    """

    codes: tuple[Code, ...] = ()
    beyond: float = 0.0
    usable_m: float | None = None

    def maximum_m(self, declared_m: float) -> float:
        """From where on readings of a scan with that declared maximum are no return."""
        if self.usable_m is None:
            return declared_m
        return self.usable_m if self.beyond else min(self.usable_m, declared_m)

    def warnings(self, declared_m: float) -> list[str]:
        """What was concluded, in one line each."""
        told = []
        if self.beyond:
            told.append(
                f"{100.0 * self.beyond:.2g} % of the readings exceed the declared maximum of "
                f"{declared_m:g} m and are surfaces: {self.usable_m:g} m is used"
            )
        if self.codes:
            bands = ", ".join(str(code) for code in reversed(self.codes))
            told.append(f"readings of {bands} come so often that they mean no return")
        return told


AS_DECLARED = RangeLimit()


class RangeSample:
    """Scans spread evenly over a recording, with at most ``SAMPLED_READINGS``."""

    def __init__(self) -> None:
        self.rows: list[Float32Array] = []
        self.numbers: list[int] = []
        """Of the scans in rows, among all that were added."""
        self._steps = Counter[float]()
        self._every = 1
        self._count = self._readings = 0

    def add(self, readings_m: Float32Array, angle_step_rad: float) -> None:
        """The next scan, its readings (beams,) as recorded."""
        if self._count % self._every == 0:
            self.rows.append(readings_m)
            self.numbers.append(self._count)
            self._steps[abs(angle_step_rad)] += 1
            self._readings += readings_m.size
        self._count += 1
        while self._readings > SAMPLED_READINGS and len(self.rows) > 1:
            self.rows, self.numbers = self.rows[::2], self.numbers[::2]
            self._readings = sum(row.size for row in self.rows)
            self._every *= 2

    def limit(self, declared_m: float, positions_m: FloatArray | None = None) -> RangeLimit:
        """What the sample says; positions_m: (k, 2) of the robot at its scans, if known."""
        step_rad = max(self._steps, key=self._steps.__getitem__, default=0.0)
        return find_limit(self.rows, step_rad, declared_m, positions_m)


def find_limit(
    rows: _Rows,
    angle_step_rad: float,
    declared_m: float,
    positions_m: FloatArray | None = None,
) -> RangeLimit:
    """The range limit and the codes for no return in scans of one lidar.

    rows: readings in metres of each scan, as recorded. declared_m: maximum that is declared,
    ``inf`` for none. positions_m: (k, 2) of the robot at each scan, None if not known.
    """
    step_rad = abs(angle_step_rad) if math.isfinite(angle_step_rad) else 0.0
    readings = _Readings.of(rows, max(step_rad, _UNKNOWN_STEP_RAD), positions_m)
    with np.errstate(over="ignore"):
        declared_m = float(np.float32(declared_m))
    codes, surfaces = _peeled(readings, declared_m)
    noisy = _noisy(readings, min([declared_m, *(code.lowest_m for code in codes[:1])]))
    if noisy is not None:
        below = readings.of_those(readings.values < noisy.lowest_m)
        codes = [noisy, *_peeled(below, declared_m)[0]]
        return RangeLimit(tuple(codes), 0.0, codes[-1].lowest_m)
    beyond = _beyond(surfaces.values, declared_m)
    if beyond:
        largest_m = np.float32(surfaces.values.max())
        next_m = float(np.nextafter(largest_m, np.float32(np.inf)))
        usable_m = codes[-1].lowest_m if codes else next_m
        return RangeLimit(tuple(codes), beyond, usable_m)
    within = surfaces.of_those(surfaces.values < declared_m)
    if within.values.size < surfaces.values.size:  # what lies above may have hidden a code below
        codes += _peeled(within, declared_m)[0]
    found = tuple(code for code in codes if code.lowest_m < declared_m)
    return RangeLimit(found, 0.0, found[-1].lowest_m if found else None)


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Readings that are distances, in the order of scans and beams.

    values: (n,). scan, beam: (n,) of which each is; beams are counted on from scan to scan.
    stands_out: (n,) whether both beams beside it end at a surface that is much nearer.
    is_look: (scans,) which are compared. is_elsewhere: whether these are from different places.
    """

    values: FloatArray
    scan: IntArray
    beam: IntArray
    stands_out: BoolArray
    is_look: BoolArray
    is_elsewhere: bool
    step_rad: float

    @classmethod
    def of(cls, rows: _Rows, step_rad: float, positions_m: FloatArray | None) -> Self:
        values = np.concatenate([np.zeros(0, dtype=np.float32), *rows]).astype(np.float64)
        beam = np.flatnonzero(np.isfinite(values) & (values > 0.0))
        scan = np.repeat(np.arange(len(rows)), [row.size for row in rows])[beam]
        is_look = np.ones(len(rows), dtype=np.bool_)
        if positions_m is not None:
            cells = np.floor(positions_m / CELL_M)
            is_look[:] = False
            is_look[np.unique(cells, axis=0, return_index=True)[1]] = True
        out = _stands_out(values[beam], scan, beam)
        return cls(values[beam], scan, beam, out, is_look, positions_m is not None, step_rad)

    def of_those(self, which: BoolArray) -> Self:
        """The same readings without some."""
        names = ("values", "scan", "beam", "stands_out")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def are_beside(self, which: BoolArray) -> BoolArray:
        """(n,) whether both beams beside a reading are some of those."""
        beside = (np.diff(self.beam) == 1) & (np.diff(self.scan) == 0)
        after, before = np.zeros((2, self.values.size), dtype=np.bool_)
        after[:-1] = beside & which[1:]
        before[1:] = beside & which[:-1]
        return after & before


def _noisy(readings: _Readings, top_m: float) -> Code | None:
    """The code that noise about top_m makes, if that stands for no return; None if it does not."""
    nothing = readings.values >= top_m
    between = readings.are_beside(nothing)
    short_m = top_m - readings.values[between & ~nothing]
    short_m = short_m[short_m < NOISE_SIGMAS * MOST_NOISE * top_m]
    if short_m.size < LEAST_SHORT:
        return None
    reach_m = NOISE_SIGMAS * SIGMAS_PER_MEDIAN * float(np.median(short_m))
    count = int((short_m < reach_m).sum())
    share = count / (count + int((between & nothing).sum()))
    if share < LEAST_SHORT_SHARE or reach_m > NOISE_SIGMAS * MOST_NOISE * top_m:
        return None
    inside = readings.values[readings.values >= top_m - reach_m]
    return Code(float(inside.min()), float(inside.max()), int(inside.size), is_noisy=True)


def _stands_out(values: FloatArray, scan: IntArray, beam: IntArray) -> BoolArray:
    """See ``_Readings``; a beam without a reading is no surface."""
    beside = (np.diff(beam) == 1) & (np.diff(scan) == 0)
    after, before = np.zeros((2, values.size), dtype=np.bool_)
    after[:-1] = beside & (values[1:] < STANDS_OUT * values[:-1])
    before[1:] = beside & (values[:-1] < STANDS_OUT * values[1:])
    return after & before


def _beyond(values: FloatArray, declared_m: float) -> float:
    """Share of readings above the declared maximum, 0 if they may be none of surfaces.

    Surfaces are at many distances: no band of the width of a code holds most of them.
    """
    above = values[values > declared_m]
    share = above.size / max(values.size, 1)
    if above.size < LEAST_BEYOND or not MAX_BEYOND < share <= MOST_BEYOND:
        return 0.0
    bands = np.floor(np.log(above / declared_m) / WIDEST_BAND).astype(np.int64)
    return share if np.bincount(bands).max() < 0.5 * above.size else 0.0


def _peeled(readings: _Readings, declared_m: float) -> tuple[list[Code], _Readings]:
    """(the codes at the top, highest first, the readings without them)."""
    codes: list[Code] = []
    left = readings
    while (code := _code_at_top(left, declared_m)) is not None:
        codes.append(code)
        left = left.of_those(left.values < code.lowest_m)
        if len(codes) > MOST_CODES:
            return [], readings
    return codes, left


def _code_at_top(readings: _Readings, declared_m: float) -> Code | None:
    if readings.values.size == 0:
        return None
    largest_m = float(readings.values.max())
    tops = (largest_m, float(np.quantile(readings.values, 1.0 - OUTLIERS, method="lower")))
    found: list[tuple[float, Code]] = []
    for top_m in dict.fromkeys(tops):
        from_m = 0.5 * top_m if readings.is_elsewhere else 0.0
        near = (readings.values >= from_m) & (readings.values <= top_m)
        comparable = readings.of_those(near)
        alone = comparable.of_those(comparable.stands_out & readings.is_elsewhere)
        is_cut_off = NEAR_DECLARED * declared_m <= top_m <= declared_m
        for low_m in _lows(top_m):
            telling = alone if is_cut_off and low_m < top_m else comparable
            chance = min(_of_occupancy(telling, low_m, top_m), _of_runs(telling, low_m, top_m))
            if chance < _LOG_LEVEL:
                inside = comparable.values[comparable.values >= low_m]
                found.append((chance, Code(float(inside.min()), top_m, int(inside.size))))
    return min(found, key=lambda one: one[0])[1] if found else None


def _lows(top_m: float) -> Iterator[float]:
    """Where bands below a largest reading begin: that reading alone, and wider ones."""
    yield top_m
    for halving in range(HALVINGS + 1):
        yield top_m * (1.0 - WIDEST_BAND * 0.5**halving)


def _of_occupancy(readings: _Readings, low_m: float, top_m: float) -> float:
    """Logarithm of the chance that surfaces occupy the band at the top in as many looks."""
    looks = int(readings.is_look.sum())
    inside = readings.values >= low_m
    is_look = readings.is_look[readings.scan]
    occupied = int(_begins(readings.scan[inside & is_look]).sum())
    if _log_tail(occupied, looks, 1.0 / (looks + 1.0)) >= _LOG_LEVEL:
        return 0.0  # not even if no other band is ever occupied
    others = ~inside & is_look
    most = _most_occupied(readings.values[others], readings.scan[others], top_m - low_m)
    return _log_tail(occupied, looks, (most + 1.0) / (looks + 1.0))


def _most_occupied(values: FloatArray, scan: IntArray, width_m: float) -> int:
    """Most scans with a reading in one band of a width; in one value if it is 0."""
    if values.size == 0:
        return 0
    if width_m > 0.0:
        bands = np.floor(values / width_m).astype(np.int64)
    else:
        bands = np.unique(values, return_inverse=True)[1].ravel()
    scans = int(scan.max()) + 1
    # Sorted, not hashed as by np.unique, which takes forty times as long for a million.
    keys = np.sort(bands * scans + scan)
    occupied = keys[_begins(keys)] // scans
    ends = np.append(np.flatnonzero(_begins(occupied)), occupied.size)
    return int(np.diff(ends).max())


def _begins(ascending: IntArray) -> BoolArray:
    """(n,) whether each differs from the one before."""
    return np.concatenate([np.ones(min(ascending.size, 1), np.bool_), np.diff(ascending) != 0])


def _log_tail(hits: int, trials: int, chance: float) -> float:
    """Chernoff bound of the logarithm of P(at least so many hits), 0 if that is no rare event."""
    share = hits / max(trials, 1)
    if share <= chance:
        return 0.0
    divergence = share * math.log(share / chance)
    if share < 1.0:
        divergence += (1.0 - share) * math.log((1.0 - share) / (1.0 - chance))
    return -trials * divergence


def _of_runs(readings: _Readings, low_m: float, top_m: float) -> float:
    """Logarithm of the chance of runs of beams in the band longer than a flat wall's.

    Only the scan with the longest runs counts: others may show the same surfaces."""
    inside = readings.values >= low_m
    scan, beam = readings.scan[inside], readings.beam[inside]
    begins = np.ones(beam.size, dtype=np.bool_)
    begins[1:] = (np.diff(beam) != 1) | (np.diff(scan) != 0)
    lengths = np.bincount(np.cumsum(begins) - 1)
    if lengths.max(initial=0) <= _flat_wall(low_m, top_m - low_m, readings.step_rad):
        return 0.0
    quantum_m = float(np.diff(np.unique(readings.values)).min(initial=top_m))
    width_m = top_m - low_m + quantum_m
    excess = np.maximum(lengths - _flat_wall(low_m, width_m, readings.step_rad), 0)
    of_scan = np.bincount(scan[begins], weights=excess)
    return float(of_scan.max()) * math.log(min(2.0 * width_m / top_m, 1.0))


def _flat_wall(nearest_m: float, width_m: float, step_rad: float) -> int:
    """Most beams that a wall nearest_m away returns within a band of that width."""
    return math.floor(2.0 * math.acos(nearest_m / (nearest_m + width_m)) / step_rad) + 2
