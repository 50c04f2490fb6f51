"""From a rolling sweep to a cloud at one instant: the only road from Scan to Cloud."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import (
    BoolArray,
    Cloud,
    Float32Array,
    FloatArray,
    IntArray,
    OutsideTimeRange,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
)
from slamsim.guard.errors import SlamsimError

MAX_TILT_RAD = np.deg2rad(20.0)
"""Beams steeper than this against the floor see other walls than a planar map can hold."""

REFUSED_TILT_RAD = np.deg2rad(45.0)
"""A lidar tilted more than this scans floor and ceiling; upside down it is level again."""

FLOOR_CLEARANCE_M = 0.03
"""A return lower than this, from a lidar that looks down, is the floor."""

MIN_FLOOR_HEIGHT_M = 0.05
"""A lidar said to be mounted lower has no known height; its floor returns are not sought."""


def tilt_of(T_base_laser: FloatArray) -> float:
    """How far the plane of the beams is off the level, in radians; upside down is level.

    Raises SlamsimError where it is so far off that the scans are no cut through the walls.
    T_base_laser: (4, 4).
    """
    upright = abs(float(T_base_laser[2, 2])) / max(float(np.linalg.norm(T_base_laser[:3, 2])), 1e-9)
    tilt_rad = float(np.arccos(min(upright, 1.0)))
    if not tilt_rad <= REFUSED_TILT_RAD:
        raise SlamsimError(
            f"the transform to the lidar tilts it by {np.rad2deg(tilt_rad):.0f} degrees: a map of "
            "the floor needs scans that are level; correct the transform in the recording"
        )
    return tilt_rad


def deskew(scan: Scan, motion: PlanarTrajectory, at_ns: int, T_base_laser: FloatArray) -> Cloud:
    """The scan, and those beside it, as seen from the base at ``at_ns``, each beam moved by the
    motion until then.

    motion: the base in any fixed frame, linear between its poses. T_base_laser: 4 x 4; the
    beams are projected onto the floor, those tilted by more than 20 degrees or ending on the
    floor are dropped. Invalid (nan) and too close returns are dropped; no return (inf, or at
    the maximum range) becomes a beam without hit that ends at the maximum range. Raises
    OutsideTimeRange if the motion covers not all of the beams and ``at_ns``.
    """
    first, last = scan.span_ns
    first, last = min(first, at_ns), max(last, at_ns)
    if len(motion) == 0 or first < motion.stamps_ns[0] or last > motion.stamps_ns[-1]:
        have = f"{motion.stamps_ns[0]}..{motion.stamps_ns[-1]}" if len(motion) else "no"
        raise OutsideTimeRange(f"motion covers {have} ns, the scan needs {first}..{last} ns")
    own = _deskewed(scan, motion, at_ns, T_base_laser)
    if not scan.beside:
        return Cloud(at_ns, *own)
    others = (_deskewed(each.scan, motion, at_ns, each.T_base_laser) for each in scan.beside)
    points_m, origins_m, hit = map(np.concatenate, zip(own, *others, strict=True))
    return Cloud(at_ns, points_m, origins_m, hit, own_beams=len(own[0]))


def _deskewed(
    scan: Scan, motion: PlanarTrajectory, at_ns: int, T_base_laser: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(points, origins, hit) of the beams of one lidar."""
    rays = _rays(scan.geometry, T_base_laser[:3, :2].tobytes())
    points, origins, hit = _deskew(
        scan.ranges_m,
        rays,
        np.ascontiguousarray(T_base_laser[:3, 3]),
        (scan.geometry.range_min_m, scan.geometry.range_max_m, float(np.sin(MAX_TILT_RAD))),
        (scan.stamp_ns, scan.geometry.beam_dt_ns, at_ns),
        motion.stamps_ns,
        motion.poses,
    )
    return points, origins, hit


@lru_cache(maxsize=16)
def _rays(geometry: ScanGeometry, rotation: bytes) -> FloatArray:
    """(3, beams) unit vectors in the base frame; rotation: the first two columns of it."""
    directions = geometry.angles_rad()
    columns = np.frombuffer(rotation, dtype=np.float64).reshape(3, 2)
    return np.asarray(columns @ np.stack([np.cos(directions), np.sin(directions)]))


@kernel
def _pose_at(
    t_ns: int, left: int, stamps_ns: IntArray, poses: FloatArray
) -> tuple[float, float, float, int]:
    """Linear between the neighbouring poses; ``left`` is where to begin to look."""
    last = stamps_ns.size - 2
    left = max(0, min(left, last))
    while left < last and stamps_ns[left + 1] <= t_ns:
        left += 1
    while left > 0 and stamps_ns[left] > t_ns:
        left -= 1
    if stamps_ns.size == 1:
        return poses[0, 0], poses[0, 1], poses[0, 2], 0
    span = stamps_ns[left + 1] - stamps_ns[left]
    fraction = (t_ns - stamps_ns[left]) / span
    turn = poses[left + 1, 2] - poses[left, 2]
    turn -= 2.0 * np.pi * np.floor((turn + np.pi) / (2.0 * np.pi))
    x = poses[left, 0] + fraction * (poses[left + 1, 0] - poses[left, 0])
    y = poses[left, 1] + fraction * (poses[left + 1, 1] - poses[left, 1])
    return x, y, poses[left, 2] + fraction * turn, left


@kernel
def _deskew(
    ranges_m: Float32Array,
    rays: FloatArray,
    origin: FloatArray,
    limits: tuple[float, float, float],
    times_ns: tuple[int, int, int],
    stamps_ns: IntArray,
    poses: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    range_min, range_max, max_rise = limits
    start_ns, beam_dt_ns, at_ns = times_ns
    count = ranges_m.size
    points, origins = np.empty((count, 2)), np.empty((count, 2))
    hit = np.empty(count, np.bool_)
    left = int(np.searchsorted(stamps_ns, at_ns))
    at_x, at_y, at_yaw, left = _pose_at(at_ns, left, stamps_ns, poses)
    at_cos, at_sin = np.cos(at_yaw), np.sin(at_yaw)
    x = y = sin = 0.0
    cos = 1.0
    kept = 0
    for i in range(count):
        if i == 0 or beam_dt_ns != 0:
            now_x, now_y, now_yaw, left = _pose_at(
                start_ns + i * beam_dt_ns, left, stamps_ns, poses
            )
            x = at_cos * (now_x - at_x) + at_sin * (now_y - at_y)
            y = -at_sin * (now_x - at_x) + at_cos * (now_y - at_y)
            cos, sin = np.cos(now_yaw - at_yaw), np.sin(now_yaw - at_yaw)
        reach = float(ranges_m[i])
        if np.isnan(reach) or reach < range_min or np.abs(rays[2, i]) > max_rise:
            continue
        returned = reach < range_max
        reach = min(reach, range_max)
        end_height = origin[2] + reach * rays[2, i]
        if (
            rays[2, i] < -1e-6
            and origin[2] >= MIN_FLOOR_HEIGHT_M
            and end_height < FLOOR_CLEARANCE_M
        ):
            continue
        base_x, base_y = origin[0] + reach * rays[0, i], origin[1] + reach * rays[1, i]
        points[kept, 0] = x + cos * base_x - sin * base_y
        points[kept, 1] = y + sin * base_x + cos * base_y
        origins[kept, 0] = x + cos * origin[0] - sin * origin[1]
        origins[kept, 1] = y + sin * origin[0] + cos * origin[1]
        hit[kept] = returned
        kept += 1
    return points[:kept], origins[:kept], hit[:kept]
