"""Deskewed scans as point clouds, for the KITTI layout."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import Drive, Float32Array, FloatArray, IntArray
from slamsim.dataset.truth.key_scans import frame_at
from slamsim.io.text.kitti import KittiFolder
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.mountings import declared_laser_mounting
from slamsim.sensors.motion import Motion, joined, kept_since
from slamsim.sensors.rays import beam_rays

_TAIL_NS = 2_000_000_000
"""Motion kept for scans that are not there yet: longer than any scan takes."""


class DeskewedScans:
    """Clouds of a recording's scans, each as seen midway through it, into a KITTI folder.

    Clouds and times are what the recording says: its ranges at the declared angles, freed of the
    robot's true motion by the declared times of the beams and the declared mounting, at the scan's
    stamp. Poses are the true ones of a laser that sits where the recording declares it.
    """

    def __init__(self, folder: KittiFolder) -> None:
        self._folder = folder
        self._T_base_laser: FloatArray | None = None
        self._motion: Motion | None = None

    def write(self, part: Recording, true_stamps_ns: IntArray, window: Drive) -> None:
        """The next part of the recording, when its scans truly began, and the drive meanwhile."""
        if self._T_base_laser is None:
            self._T_base_laser = declared_laser_mounting(part)
        motion = joined(self._motion, window)
        for scans in part.scans[:1]:
            for number, true_ns in enumerate(true_stamps_ns.tolist()):
                self._write_one(motion, self._T_base_laser, scans, number, true_ns)
        self._motion = kept_since(motion, motion.covered_ns - _TAIL_NS)

    def _write_one(
        self, motion: Motion, T_base_laser: FloatArray, scans: RawScans, number: int, true_ns: int
    ) -> None:
        ranges_m, layout = scans.ranges_m[number], scans.layout(number)
        met = np.flatnonzero(np.isfinite(ranges_m))
        half_ns, beams_ns = _since_first(layout, ranges_m.size, met)
        end_ns = motion.covered_ns  # a wrong time of the beams may reach beyond the drive
        samples = motion.pose_samples(T_base_laser, true_ns, min(true_ns + 2 * half_ns + 1, end_ns))
        T_map_laser = frame_at(samples, min(true_ns + half_ns, end_ns))
        instants_ns = np.minimum(true_ns + beams_ns, end_ns)
        rays = beam_rays(samples, instants_ns, _directions(layout, met), T_map_laser[:3, 3])
        points = np.zeros((met.size, 4), dtype=np.float32)
        _place(points, rays, ranges_m[met], T_map_laser[:3, :3])
        if scans.intensities is not None and scans.intensities[number].size == ranges_m.size:
            points[:, 3] = scans.intensities[number][met]
        self._folder.add(int(scans.stamps_ns[number]) + half_ns, T_map_laser, points)


def _since_first(layout: ScanLayout, count: int, beams: IntArray) -> tuple[int, IntArray]:
    """Half of a scan as it is declared, and when these beams fired after the first; ns."""
    beam_dt_ns = max(round(layout.beam_dt_s * 1e9), 0)
    return beam_dt_ns * (count - 1) // 2, beam_dt_ns * beams


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
