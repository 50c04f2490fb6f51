"""Approximates scans in other directions or at other instants, from recorded scans alone.

This stays beside the sensors and is no edit of ``slamsim.recording.edits``: it is the substitute,
for recordings that cannot be sensed again, of casting the rays anew. What is hidden in a scan is
not in it, and the motion between beams is known only as the recording's own odometry or gyroscope
tell it. Near enough to inject a fault, no more, and never a repair.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.edits.base import SCANS, CannotEdit
from slamsim.recording.edits.ranges import ChangeRanges

_FULL_TURN = 2.0 * np.pi
"""Radians."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMotion:
    """headings_rad (n,) unwrapped and path_m (n,) signed, at increasing stamps_ns (n,)."""

    stamps_ns: IntArray
    headings_rad: FloatArray
    path_m: FloatArray

    def heading_at(self, stamps_ns: IntArray) -> FloatArray:
        """(m,) heading, held beyond the ends."""
        return np.interp(stamps_ns, self.stamps_ns, self.headings_rad)

    def velocity_at(self, stamps_ns: IntArray, over_ns: int) -> tuple[FloatArray, FloatArray]:
        """(m,) forward speed, m/s, and (m,) yaw rate, rad/s, over a span about each instant."""
        ends = stamps_ns - over_ns // 2, stamps_ns + over_ns // 2
        path = [np.interp(end, self.stamps_ns, self.path_m) for end in ends]
        heading = [self.heading_at(end) for end in ends]
        return (path[1] - path[0]) / (over_ns * 1e-9), (heading[1] - heading[0]) / (over_ns * 1e-9)


def plane_motion(recording: Recording) -> PlaneMotion:
    """Of the first odometry, else of the first gyroscope. Raises CannotEdit without either."""
    if recording.odometries and len(recording.odometries[0]) > 1:
        odometry = recording.odometries[0]
        headings = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
        step = np.diff(odometry.positions_m[:, :2], axis=0)
        ahead = np.cos(headings[:-1]) * step[:, 0] + np.sin(headings[:-1]) * step[:, 1]
        path = np.concatenate([[0.0], np.cumsum(ahead)])
        return _ordered(odometry.stamps_ns, headings, path)
    if recording.imus and len(recording.imus[0]) > 1:
        imu = recording.imus[0]
        turned = imu.angular_velocity_rad_s[:-1, 2] * np.diff(imu.stamps_ns) * 1e-9
        headings = np.concatenate([[0.0], np.cumsum(turned)])
        return _ordered(imu.stamps_ns, headings, np.zeros(headings.size))
    raise CannotEdit(f"{recording.name} has neither odometry nor gyroscope to turn its scans by")


def is_timed(recording: Recording) -> bool:
    """Whether the beams of any lidar have times of their own."""
    return any(layout.beam_dt_s for scans in recording.scans for layout in scans.layouts)


def require_timed(recording: Recording) -> None:
    """Raises CannotEdit for scans whose beams are all of one instant."""
    if not is_timed(recording):
        raise CannotEdit(f"the beams of {recording.name} have no times of their own")


def refired(recording: Recording, steps: Callable[[FloatArray], FloatArray]) -> ChangeRanges:
    """As if its beams had fired at other times: later by so many steps from beam to beam.

    steps: from the numbers of the beams (beams,) to (beams,). Raises CannotEdit for scans of
    one instant and where nothing tells the motion.
    """
    require_timed(recording)
    motion = plane_motion(recording)

    def changed(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
        later_s = steps(np.arange(ranges_m.shape[1], dtype=np.float64)) * scans.layout(0).beam_dt_s
        return fired_later(ranges_m, scans, motion, later_s)

    return ChangeRanges(SCANS, changed)


def fired_later(
    ranges_m: Float32Array, scans: RawScans, motion: PlaneMotion, later_s: FloatArray
) -> Float32Array:
    """(n, beams) the scans with beam j fired later_s (beams,) after it was."""
    span_ns = max(int(1e9 * np.ptp(later_s)), 50_000_000)
    speed, rate = motion.velocity_at(scans.stamps_ns, span_ns)
    layout = scans.layout(0)
    angles = beam_angles(layout, ranges_m.shape[1])
    seen = looked_at(ranges_m, layout, rate[:, None] * later_s)
    return (seen - speed[:, None] * later_s * np.cos(angles)).astype(np.float32)


def looked_at(ranges_m: Float32Array, layout: ScanLayout, turned_rad: FloatArray) -> Float32Array:
    """(n, beams) what beam j sees once it looks turned_rad further to the left.

    turned_rad: broadcasts to (n, beams). Beyond the edge of the scan nothing returns, unless the
    scan closes the circle.
    """
    scans, beams = ranges_m.shape
    shift = np.rint(turned_rad / layout.angle_step_rad).astype(np.int64)
    source = np.arange(beams) + np.broadcast_to(shift, (scans, beams))
    around = round(_FULL_TURN / abs(layout.angle_step_rad))
    source = np.where(source % around < beams, source % around, -1)
    seen = np.take_along_axis(ranges_m, np.maximum(source, 0), axis=1)
    return np.where(source >= 0, seen, np.float32(np.inf))


def beam_angles(layout: ScanLayout, beams: int) -> FloatArray:
    """(beams,) directions that the scan declares."""
    return np.asarray(layout.angle_min_rad + np.arange(beams) * layout.angle_step_rad)


def _ordered(stamps_ns: IntArray, headings: FloatArray, path: FloatArray) -> PlaneMotion:
    unique, first = np.unique(stamps_ns, return_index=True)
    return PlaneMotion(unique, headings[first], path[first])
