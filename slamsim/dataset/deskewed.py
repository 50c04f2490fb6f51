"""Recorded scans as clouds without motion, by the truth: what the KITTI layout asks for."""

from __future__ import annotations

import numpy as np

from slamsim.dataset.key_scans import frame_at
from slamsim.jit import kernel
from slamsim.logs.kitti import KittiFolder
from slamsim.recording import RawScans, ScanLayout
from slamsim.sensors.motion import Course, Motion, joined, kept_since
from slamsim.sensors.rays import beam_rays
from slamsim.types import Drive, Float32Array, FloatArray, IntArray

_TAIL_NS = 2_000_000_000
"""Motion kept for scans that are not there yet: longer than any scan takes."""


class DeskewedScans:
    """Clouds of a recording's scans, each as seen midway through it, into a KITTI folder.

    Points are where the true motion carries the recorded ranges; they keep noise and lack what
    was not returned. T_base_laser: 4 x 4; course: how the laser truly looks, as for sensing.
    beam_dt_ns: true time from each beam to the next.
    """

    def __init__(
        self, folder: KittiFolder, T_base_laser: FloatArray, course: Course, beam_dt_ns: int
    ) -> None:
        self._folder, self._T_base_laser, self._course = folder, T_base_laser, course
        self._beam_dt_ns = beam_dt_ns
        self._motion: Motion | None = None

    def write(self, scans: RawScans | None, true_stamps_ns: IntArray, window: Drive) -> None:
        """The next window of the drive; the scans, if any, that were sensed up to its end."""
        motion = joined(self._motion, window)
        for number, true_ns in enumerate(true_stamps_ns.tolist() if scans is not None else ()):
            assert scans is not None
            self._write_one(motion, scans, number, true_ns)
        self._motion = kept_since(motion, motion.covered_ns - _TAIL_NS)

    def _write_one(self, motion: Motion, scans: RawScans, number: int, true_ns: int) -> None:
        ranges_m = scans.ranges_m[number]
        met = np.flatnonzero(np.isfinite(ranges_m))
        last_ns = true_ns + self._beam_dt_ns * (ranges_m.size - 1)
        knots = self._course(motion.knots(self._T_base_laser, true_ns, last_ns))
        middle_ns = (true_ns + last_ns) // 2
        T_map_laser = frame_at(knots, middle_ns)
        directions = _directions(scans.layout(number), met)
        rays = beam_rays(knots, true_ns + met * self._beam_dt_ns, directions, T_map_laser[:3, 3])
        points = np.zeros((met.size, 4), dtype=np.float32)
        _place(points, rays, ranges_m[met], T_map_laser[:3, :3])
        if scans.intensities is not None:
            points[:, 3] = scans.intensities[number][met]
        self._folder.add(middle_ns, T_map_laser, points)


def _directions(layout: ScanLayout, beams: IntArray) -> FloatArray:
    angles_rad = layout.angle_min_rad + beams * layout.angle_step_rad
    return np.stack([np.cos(angles_rad), np.sin(angles_rad)])


@kernel
def _place(
    points: Float32Array, rays: Float32Array, ranges_m: Float32Array, R_map_laser: FloatArray
) -> None:
    """Ends of rays, given from the laser's place in map axes, as seen in the laser's own."""
    for beam in range(rays.shape[0]):
        for axis in range(3):
            value = 0.0
            for i in range(3):
                end = rays[beam, i] + ranges_m[beam] * rays[beam, 3 + i]
                value += R_map_laser[i, axis] * end
            points[beam, axis] = value
