"""The lidars of a recording: when each scan was taken, and which lidars are used together."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory, ScanSource
from slamsim.guard.errors import InputRefused
from slamsim.recording import RawOdometry, RawScans
from slamsim.recording.cleaning.rising_stamps import NoTime, Times, is_late, rising_times
from slamsim.recording.cleaning.scans import RecordedScans, ScansTogether, ScanSurvey
from slamsim.recording.cleaning.streams import planar_poses
from slamsim.recording.frames import FrameTree, mounting_beside

_USUAL_SPEED_M_S, _USUAL_TURN_RAD_S = 0.5, 0.5
_LEAST_PERIOD_NS, _LONGEST_PERIOD_NS = 100_000_000, 10_000_000_000
_MOST_GROWTH = 1.05
"""Of the odometry path by sorting: by a few lines in the wrong place it grows no more."""


class OtherLidars:
    """The lidars beside the first one whose place on the robot is known.

    first, scans: the first lidar as recorded, and as used. told: what is odd about the others,
    and why some are not used.
    """

    def __init__(
        self,
        first: RawScans,
        scans: RecordedScans,
        tree: FrameTree,
        base_frame: str,
        odometry: PlanarTrajectory | None,
    ) -> None:
        self._tree, self._base_frame, self._odometry = tree, base_frame, odometry
        self._first, self._scans = first, scans
        self._places: dict[str, FloatArray] = {}
        self._others: list[tuple[RecordedScans, FloatArray]] = []
        self.told: list[str] = []

    def add(self, raw: RawScans, source: Path) -> None:
        """Use one more lidar, or tell why it cannot be used. source: named in errors."""
        try:
            self._places = self._places or {self._first.topic: self._mounting(self._first)}
            T_base_laser = self._mounting(raw)
            scans, told = self._usable(raw, source)
        except _NotUsed as why:
            self.told.append(f"the scans of {raw.topic} are not used: {why}")
            return
        self._others.append((scans, T_base_laser))
        self._places[raw.topic] = T_base_laser
        self.told += [f"{raw.topic}: {words}" for words in told]

    def together(self) -> ScanSource:
        """The scans of all of them."""
        return ScansTogether(self._scans, self._others) if self._others else self._scans

    def _mounting(self, raw: RawScans) -> FloatArray:
        """4 x 4 T_base_laser. Raises _NotUsed for a lidar that has no place of its own."""
        found = mounting_beside(self._tree, self._base_frame, raw.frame_ids[0], self._places)
        if isinstance(found, str):
            raise _NotUsed(found)
        return found

    def _usable(self, raw: RawScans, source: Path) -> tuple[RecordedScans, list[str]]:
        survey = ScanSurvey(raw)
        try:
            times = scan_times(raw, survey, source)
        except InputRefused as error:
            raise _NotUsed(error.reason) from None
        own_ns = self._scans.stamps_ns
        if times.stamps_ns[-1] < own_ns[0] or times.stamps_ns[0] > own_ns[-1]:
            raise _NotUsed(f"they have no time in common with {self._first.topic}")
        limit, told = survey.limit(times, self._odometry)
        kept, stuck = survey.moving_on(times, self._odometry)
        told = [*survey.warnings(times, has_beam_times=True), *stuck, *told]
        rows, stamps_ns = survey.rows[times.order][kept], times.stamps_ns[kept]
        return RecordedScans(raw, rows, stamps_ns, limit), told


class _NotUsed(Exception):
    """Why a lidar is not used."""


def scan_times(
    raw: RawScans, survey: ScanSurvey, source: Path, carried: RawOdometry | None = None
) -> Times:
    """When the scans were taken that describe a lidar.

    carried: odometry in the same messages. source: named in errors. Raises InputRefused if none
    of the scans describes a lidar, and for scans of whose times nothing is known.
    """
    rows = survey.rows
    where = f"topic {raw.topic}"
    if not rows.size:
        reason = f"none of {len(raw)} scans describes a lidar: {_described(raw)}"
        raise InputRefused(source, reason, where)
    stamps_ns = raw.stamps_ns[rows]
    received_ns = None if raw.received_ns is None else raw.received_ns[rows]
    is_repeat, sorting, period_ns = survey.is_repeat, None, None
    if carried is not None:
        poses = planar_poses(carried, rows)
        is_repeat = is_repeat & np.array([False, *(np.diff(poses, axis=0) == 0).all(axis=1)])
        sorting = _is_sorting_right(stamps_ns, poses)
        period_ns = _likely_period_ns(poses)
    try:
        return rising_times(
            stamps_ns, received_ns, is_repeat=is_repeat, sorting=sorting, period_ns=period_ns
        )
    except NoTime:
        few = np.unique(stamps_ns)
        stamps = f"the stamp {few[0]} ns" if few.size == 1 else f"one of {few.size} stamps"
        reason = (
            f"all {rows.size} scans carry {stamps}, and were received at no time: "
            "when they were taken is not known"
        )
        raise InputRefused(source, reason, where) from None


def _described(raw: RawScans) -> str:
    """The first scan in words, of which one number or another makes no sense."""
    layout, beams = raw.layout(0), raw.ranges_m[0].size
    return (
        f"the first has {beams:,} beams {math.degrees(layout.angle_step_rad):.4g} degrees and "
        f"{1e3 * layout.beam_dt_s:.4g} ms apart, for ranges of {layout.range_min_m:.4g} to "
        f"{layout.range_max_m:.4g} m; `slamsim check` looks for the fault"
    )


def _is_sorting_right(stamps_ns: IntArray, poses: FloatArray) -> bool | None:
    """Whether stamps that fall back are right and the order of the scans is not.

    If so the odometry path does not grow by sorting. None where the robot does not move, or scans
    are late by no more than transport explains.
    """
    as_recorded_m = _path_length_m(poses)
    if as_recorded_m == 0.0 or not is_late(stamps_ns):
        return None
    as_stamped_m = _path_length_m(poses[np.argsort(stamps_ns, kind="stable")])
    return as_stamped_m <= _MOST_GROWTH * as_recorded_m


def _likely_period_ns(poses: FloatArray) -> int:
    """Between scans without any time: that of a robot at its usual speed."""
    if len(poses) < 2:
        return _LEAST_PERIOD_NS
    turned_rad = float(np.abs(wrap_angle(np.diff(poses[:, 2]))).sum())
    moved_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    busy_s = max(moved_m / _USUAL_SPEED_M_S, turned_rad / _USUAL_TURN_RAD_S)
    return max(_LEAST_PERIOD_NS, min(round(1e9 * busy_s / (len(poses) - 1)), _LONGEST_PERIOD_NS))


def _path_length_m(poses: FloatArray) -> float:
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(poses[:, :2]))
