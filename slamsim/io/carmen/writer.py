"""Writes scans and odometry as a CARMEN log, as ``read_carmen`` reads it back.

A fan that a FLASER line implies by its number of beams is written so, any other as ROBOTLASER1,
which describes itself. Each line carries the odometry at the stamp of its scan. Lengths are in
millimetres (three decimals); no return is the lidar's maximum, an invalid reading 0. The format
has no word for a pose that is no number: it is left out.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from slamsim.core.geometry import compose, se2_from_se3, yaw_from_xyzw
from slamsim.core.types import Float32Array, FloatArray, IntArray, PlanarTrajectory
from slamsim.guard.numbers import is_sound
from slamsim.io.carmen.lines import sick_fan
from slamsim.io.staged_writer import StagedWriter
from slamsim.io.text.tum import decimal_from_stamp_ns
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.frames import declared_laser_mounting

_HOST = "slamsim"
_SAME_FAN_RAD = 1e-4
"""What single precision and decimals leave of an angle."""
_MM_PER_M = 1000.0
"""CARMEN writes metres with three decimals, counted here in millimetres so that they round once."""


class CarmenFile(StagedWriter):
    """A CARMEN log being written; a context manager.

    The laser sits where the first part of the recording declares it. Without odometry no line can
    be written, for each carries a pose.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self._open.enter_context(path.open("x", encoding="ascii"))
        self._T_base_laser: FloatArray | None = None
        self._odometry: list[PlanarTrajectory] = []
        self._waiting: list[tuple[int, str, str]] = []

    def write(self, part: Recording) -> None:
        """The next part of the recording: its first lidar and its first odometry."""
        if self._T_base_laser is None:
            self._T_base_laser = se2_from_se3(declared_laser_mounting(part))
        for moved in part.odometries[:1]:
            yaw = yaw_from_xyzw(moved.quats_xyzw)
            poses = np.column_stack([moved.positions_m[:, :2], yaw])
            sound = np.flatnonzero(is_sound(poses))
            stamps_ns, first = np.unique(moved.stamps_ns[sound], return_index=True)
            if stamps_ns.size:
                self._odometry.append(PlanarTrajectory(stamps_ns, poses[sound[first]]))
        for scans in part.scans[:1]:
            if self._file.tell() == 0 and len(scans):
                self._declare(scans)
            self._waiting += _lines(scans)
        self._write_covered(last=False)

    def _finish(self) -> None:
        self._write_covered(last=True)

    def _declare(self, scans: RawScans) -> None:
        """What the lines do not say: from which reading on nothing was there."""
        stamp = decimal_from_stamp_ns(int(scans.stamps_ns[0]))
        limit_m = scans.layout(0).range_max_m
        self._file.write(f"PARAM robot_front_laser_max {limit_m:.3f} {stamp} {_HOST} {stamp}\n")

    def _write_covered(self, *, last: bool) -> None:
        """The lines whose odometry is known, in the order of the scans."""
        if not self._odometry or self._T_base_laser is None:
            return
        known = PlanarTrajectory.joined(self._odometry)
        first_ns, last_ns = int(known.stamps_ns[0]), int(known.stamps_ns[-1])
        count = 0
        while count < len(self._waiting) and (last or self._waiting[count][0] <= last_ns):
            count += 1
        ready, self._waiting = self._waiting[:count], self._waiting[count:]
        stamps_ns = np.array([stamp_ns for stamp_ns, _, _ in ready], dtype=np.int64)
        bases = known.at(np.clip(stamps_ns, first_ns, last_ns))
        lasers = compose(bases, np.broadcast_to(self._T_base_laser, bases.shape))
        for (stamp_ns, head, twist), base, laser in zip(ready, bases, lasers, strict=True):
            stamp = decimal_from_stamp_ns(stamp_ns)
            poses = " ".join(f"{value:.6f}" for value in (*laser.tolist(), *base.tolist()))
            self._file.write(f"{head} {poses}{twist} {stamp} {_HOST} {stamp}\n")
        self._odometry = [_since(known, stamps_ns)]


def _since(path: PlanarTrajectory, written_ns: IntArray) -> PlanarTrajectory:
    """What later lines may still need: from the last written one on."""
    if written_ns.size == 0:
        return path
    begin = max(int(np.searchsorted(path.stamps_ns, written_ns.max())) - 1, 0)
    return path.select(slice(begin, None))


def _lines(scans: RawScans) -> list[tuple[int, str, str]]:
    """(stamp, the line up to the poses, what stands between poses and stamp) of each scan."""
    found = []
    for number, stamp_ns in enumerate(scans.stamps_ns.tolist()):
        layout, ranges_m = scans.layout(number), scans.ranges_m[number]
        strengths = None if scans.intensities is None else scans.intensities[number]
        found.append((stamp_ns, *_parts(layout, ranges_m, strengths)))
    return found


def _parts(
    layout: ScanLayout, ranges_m: Float32Array, strengths: Float32Array | None
) -> tuple[str, str]:
    readings = _readings(ranges_m, layout.range_max_m)
    fan = sick_fan(ranges_m.size) if ranges_m.size > 1 else None
    implied = fan is not None and (
        abs(fan.angle_min_rad - layout.angle_min_rad) < _SAME_FAN_RAD
        and abs(fan.angle_step_rad - layout.angle_step_rad) * ranges_m.size < _SAME_FAN_RAD
    )
    if implied and strengths is None:
        return f"FLASER {ranges_m.size} {readings}", ""
    view_rad = layout.angle_step_rad * (ranges_m.size - 1)
    head = (
        f"ROBOTLASER1 0 {layout.angle_min_rad:.9f} {view_rad:.9f} {layout.angle_step_rad:.9f} "
        f"{layout.range_max_m:.3f} 0.001 0 {ranges_m.size} {readings}"
    )
    if strengths is None:
        return f"{head} 0", " 0 0 0 0 0"
    return f"{head} {strengths.size} {' '.join(f'{s:.6g}' for s in strengths)}", " 0 0 0 0 0"


def _readings(ranges_m: Float32Array, range_max_m: float) -> str:
    largest, met = round(range_max_m * _MM_PER_M), np.isfinite(ranges_m)
    millimetres = np.where(np.isinf(ranges_m), largest, 0)
    millimetres[met] = np.clip(np.rint(ranges_m[met] * _MM_PER_M), 1, largest - 1)
    return " ".join(map(_in_metres, millimetres.tolist()))


@lru_cache(maxsize=1 << 16)
def _in_metres(millimetres: int) -> str:
    return f"{millimetres // 1000}.{millimetres % 1000:03d}"
