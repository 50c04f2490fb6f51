"""Scans as SLAM reads them, built lazily from the rows of a recording."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    PlanarTrajectory,
    Scan,
    ScanBeside,
    ScanGeometry,
)
from slamsim.guard.numbers import MOST, BadNumbers
from slamsim.recording import RawScans, ScanLayout
from slamsim.recording.cleaning.no_return import AS_DECLARED, RangeLimit, RangeSample
from slamsim.recording.cleaning.rising_stamps import Times

MOVING_M_S, MOVING_RAD_S = 0.02, 0.05
"""Well above the noise of odometry and of a standing gyroscope (0.01 rad/s), well below any
drive."""

LEAST_REPEATED = 30
"""Of so few beams that met something chance makes two scans alike: of readings in steps of twice
their noise half repeat, of 30 such beams all once in 1e9 scans."""

WITHOUT_NOISE = 0.5
"""If more scans repeat the one before, of all or of those of a robot that stands, it is not the
driver that is stuck: ranges have no noise, or are made up."""


def moves(steps: FloatArray, seconds: FloatArray | float) -> BoolArray:
    """(...) whether a robot that makes steps (..., 3), m, m, rad, in so many seconds is driven."""
    along = np.hypot(steps[..., 0], steps[..., 1]) > MOVING_M_S * seconds
    return np.asarray(along | (np.abs(steps[..., 2]) > MOVING_RAD_S * seconds))


class StoredScans:
    """A ScanSource over scans that are in memory already, in the order of their stamps."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans = tuple(scans)

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self._scans)


class RecordedScans:
    """A ScanSource over rows of a recording, whose ranges may be in a file.

    rows: (n,) the scans to use, in the order of time. stamps_ns: (n,) rising. limit: beyond which
    a reading is no return.
    """

    def __init__(self, raw: RawScans, rows: IntArray, stamps_ns: IntArray, limit: RangeLimit):
        self._raw, self._rows, self.stamps_ns = raw, rows, stamps_ns
        self.topic = raw.topic
        self.limit, self._geometries = limit, _Geometries(raw, limit)

    def __len__(self) -> int:
        return int(self._rows.size)

    def __iter__(self) -> Iterator[Scan]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, number: int) -> Scan:
        row = int(self._rows[number])
        geometry = self._geometries.of(row)
        assert geometry is not None, "a scan that describes no lidar"
        ranges_m = _measured(self._raw.ranges_m[row], geometry)
        return Scan(int(self.stamps_ns[number]), ranges_m, geometry, self._intensities(row))

    @property
    def middles_ns(self) -> IntArray:
        """(n,) halfway through each scan, as long as the first one takes."""
        return np.asarray(self.stamps_ns + self[0].geometry.duration_ns // 2)

    def _intensities(self, row: int) -> Float32Array | None:
        if self._raw.intensities is None:
            return None
        strengths = np.asarray(self._raw.intensities[row], dtype=np.float32)
        return strengths if strengths.size == self._raw.ranges_m[row].size else None


class ScansTogether:
    """A ScanSource over the scans of one lidar, each with those of others nearest to it in time.

    others: (scans, 4 x 4 T_base_laser) of each further lidar. A scan of theirs is used at most
    once, and only beside one that is no farther away than the next scan of the first lidar.
    """

    def __init__(
        self, own: RecordedScans, others: Sequence[tuple[RecordedScans, FloatArray]]
    ) -> None:
        self._own, self._others = own, others
        self._beside = [paired(own.middles_ns, scans.middles_ns) for scans, _ in others]

    def __len__(self) -> int:
        return len(self._own)

    def __iter__(self) -> Iterator[Scan]:
        for number, scan in enumerate(self._own):
            beside = [
                ScanBeside(scans[int(nearest[number])], T_base_laser, scans.topic)
                for (scans, T_base_laser), nearest in zip(self._others, self._beside, strict=True)
                if nearest[number] >= 0
            ]
            yield replace(scan, beside=tuple(beside))


def paired(own_ns: IntArray, others_ns: IntArray) -> IntArray:
    """(n,) for each of our rising instants which of the others is nearest to it, -1 for none.

    Only such others count as are nearer to it than to any other of ours, and no farther away than
    ours usually are from each other.
    """
    nearest = np.full(own_ns.size, -1, dtype=np.int64)
    owner = np.searchsorted((own_ns[:-1] + own_ns[1:]) // 2, others_ns)
    away_ns = np.abs(others_ns - own_ns[owner])
    usual_ns = np.median(np.diff(own_ns)) if own_ns.size > 1 else 0
    order = np.argsort(-away_ns, kind="stable")
    order = order[away_ns[order] <= usual_ns]
    nearest[owner[order]] = order  # the nearest is written last
    return nearest


class _Geometries:
    """What the scans of a lidar look like under a limit of its ranges: alike for most of them."""

    def __init__(self, raw: RawScans, limit: RangeLimit = AS_DECLARED) -> None:
        self._raw, self._limit = raw, limit
        self._layout_of = raw.layout_of.tolist()
        self._known: dict[tuple[int, int], ScanGeometry | None] = {}

    def of(self, row: int) -> ScanGeometry | None:
        """None where angles or limits describe no lidar."""
        number, ranges_m = self._layout_of[row], self._raw.ranges_m[row]
        layout = self._raw.layouts[number]
        if not math.isfinite(layout.range_max_m):  # then it depends on the readings
            return self._made(layout, ranges_m)
        key = number, int(ranges_m.size)
        if key not in self._known:
            self._known[key] = self._made(layout, ranges_m)
        return self._known[key]

    def _made(self, layout: ScanLayout, ranges_m: Float32Array) -> ScanGeometry | None:
        layout = layout.unfolded(ranges_m.size)
        step_rad, beam_dt_s = layout.angle_step_rad, layout.beam_dt_s
        range_min_m = max(layout.range_min_m if math.isfinite(layout.range_min_m) else 0.0, 0.0)
        sound = all(map(math.isfinite, (layout.angle_min_rad, step_rad, beam_dt_s)))
        if not sound or step_rad == 0.0 or ranges_m.size == 0:
            return None
        if not (layout.range_max_m > range_min_m and abs(beam_dt_s) < 1.0):
            return None
        if layout.folds(ranges_m.size):
            return None
        range_max_m = self._limit.maximum_m(layout.range_max_m)
        try:
            return ScanGeometry(
                angle_min_rad=layout.angle_min_rad,
                angle_step_rad=step_rad,
                beam_count=int(ranges_m.size),
                beam_dt_ns=round(beam_dt_s * 1e9),
                range_min_m=range_min_m,
                range_max_m=range_max_m if math.isfinite(range_max_m) else _largest_m(ranges_m),
                frame_id=self._raw.frame_ids[0],
            )
        except BadNumbers:
            return None


def _largest_m(ranges_m: Float32Array) -> float:
    """Just above every reading, for a driver that declares no maximum."""
    finite = ranges_m[ranges_m < np.float32(MOST)]
    return float(np.nextafter(finite.max(initial=np.float32(1.0)), np.float32(np.inf)))


def _measured(ranges_m: Float32Array, geometry: ScanGeometry) -> Float32Array:
    """Readings at or beyond the maximum are no return (``inf``); of 0, below the minimum or not a
    number they are no reading (``nan``), as REP 117 has it."""
    far = ranges_m >= np.float32(geometry.range_max_m)
    found = np.where(far, np.float32(np.inf), ranges_m)
    too_close = ~(found > 0.0) | (found < np.float32(geometry.range_min_m))
    return np.where(too_close, np.float32(np.nan), found)


def usable_rows(raw: RawScans) -> IntArray:
    """(k,) the scans that describe a lidar."""
    geometries = _Geometries(raw)
    usable = [row for row in range(len(raw)) if geometries.of(row) is not None]
    return np.array(usable, dtype=np.int64)


class ScanSurvey:
    """What a pass over all scans of a lidar finds.

    rows: (k,) those that describe a lidar. is_repeat: (k,) whether a scan is the one before once
    more, stamp and all. is_same: (k,) whether one of ``LEAST_REPEATED`` returns or more has the
    ranges of the one before, bit for bit.
    """

    def __init__(self, raw: RawScans) -> None:
        self._raw = raw
        self._sample = RangeSample()
        self._declared_m: Counter[float] = Counter()
        self._beam_counts: set[int] = set()
        self._odd_angle_max = self._rounded_steps = 0
        self._instantaneous, self._backward = True, False
        geometries = _Geometries(raw)
        rows, is_same, is_repeat = list[int](), list[bool](), list[bool]()
        before: tuple[ScanGeometry, bytes] | None = None
        for row in range(len(raw)):
            geometry = geometries.of(row)
            if geometry is None:
                continue
            self._add(row, geometry)
            ranges_m = _measured(raw.ranges_m[row], geometry)
            now = geometry, ranges_m.tobytes()
            same_stamp = bool(rows) and bool(raw.stamps_ns[rows[-1]] == raw.stamps_ns[row])
            is_repeat.append(now == before and same_stamp)
            is_same.append(now == before and np.isfinite(ranges_m).sum() >= LEAST_REPEATED)
            rows.append(row)
            before = now
        self.rows: IntArray = np.array(rows, dtype=np.int64)
        self.is_same: BoolArray = np.array(is_same, dtype=np.bool_)
        self.is_repeat: BoolArray = np.array(is_repeat, dtype=np.bool_)

    def _add(self, row: int, geometry: ScanGeometry) -> None:
        layout = self._raw.layout(row)
        self._sample.add(self._raw.ranges_m[row], geometry.angle_step_rad)
        self._declared_m[layout.range_max_m] += 1
        self._beam_counts.add(geometry.beam_count)
        spanned_rad = (geometry.beam_count - 1) * geometry.angle_step_rad
        off_rad = abs(layout.angle_max_rad - geometry.angle_min_rad - spanned_rad)
        self._odd_angle_max += not off_rad < 0.5 * abs(geometry.angle_step_rad)
        self._rounded_steps += geometry.angle_step_rad != layout.angle_step_rad
        self._instantaneous &= geometry.beam_dt_ns == 0
        self._backward |= geometry.beam_dt_ns < 0

    def moving_on(
        self, times: Times, odometry: PlanarTrajectory | None
    ) -> tuple[BoolArray, list[str]]:
        """(which scans to use, (k,) in the order of time; in words which not).

        Noise alone makes any two scans of a lidar differ; a driver that is stuck publishes its last
        one again while the robot moves, as if it stood. All are used where most repeat, or most of
        those of a robot that stands.
        """
        kept = np.ones(times.order.size, dtype=np.bool_)
        repeats = self.is_same[times.order][1:] & (np.diff(times.order) == 1)
        if odometry is None or len(odometry) < 2 or not repeats.any():
            return kept, []
        at_ns = np.clip(times.stamps_ns, odometry.stamps_ns[0], odometry.stamps_ns[-1])
        poses, seconds = odometry.at(at_ns), np.diff(times.stamps_ns) * 1e-9
        steps = between(poses[:-1], poses[1:])
        moved = moves(steps, seconds)
        at_rest = repeats[~moved]
        if max(repeats.mean(), at_rest.mean() if at_rest.size else 0.0) > WITHOUT_NOISE:
            return kept, []
        kept[1:] = ~(repeats & moved)
        stuck = int((~kept).sum())
        words = f"{stuck} scans repeat the one before while the robot moves: left out"
        return kept, [words] if stuck else []

    def limit(
        self, times: Times, odometry: PlanarTrajectory | None
    ) -> tuple[RangeLimit, list[str]]:
        """(the limit of the ranges, in words what of it is not as declared)."""
        if self._raw.range_is_estimated:
            return AS_DECLARED, []
        declared_m = self._declared_m.most_common(1)[0][0]
        positions_m = None
        if odometry is not None and len(odometry):
            stamps_ns = np.full(self.rows.size, times.stamps_ns[0])
            stamps_ns[times.order] = times.stamps_ns
            first_ns, last_ns = odometry.stamps_ns[0], odometry.stamps_ns[-1]
            sampled_ns = np.clip(stamps_ns[self._sample.numbers], first_ns, last_ns)
            positions_m = odometry.at(sampled_ns)[:, :2]
        limit = self._sample.limit(declared_m, positions_m)
        return limit, limit.warnings(declared_m)

    def warnings(self, times: Times, *, has_beam_times: bool) -> list[str]:
        """What was odd, and what was done about it. has_beam_times: whether the format does."""
        beams = ", ".join(map(str, sorted(self._beam_counts)))
        without = sum(
            n for declared_m, n in self._declared_m.items() if not np.isfinite(declared_m)
        )
        unusable = len(self._raw) - self.rows.size
        found = [
            (unusable, f"{unusable} scans that describe no lidar left out"),
            *((True, words) for words in times.told),
            (len(self._beam_counts) > 1, f"the number of beams changes: {beams}"),
            (
                self._odd_angle_max,
                f"angle_max of {self._odd_angle_max} scans contradicts increment and count, "
                "which are believed",
            ),
            (
                self._rounded_steps,
                f"the angle between beams of {self._rounded_steps} scans is rounded to more than a "
                "turn: taken from the first and last angle",
            ),
            (
                has_beam_times and self._instantaneous,
                "time_increment is 0: all beams of a scan count as one instant, until scans show "
                "how long a sweep takes",
            ),
            (
                self._backward,
                "time_increment is negative: the last beam of a scan counts as fired first, the "
                "first one at the stamp, unless scans show otherwise",
            ),
            (without, f"{without} scans declare no range_max"),
        ]
        return [text for applies, text in found if applies]
