"""Key scans of a drive, about 0.5 m or 30 degrees apart, with the true surfaces of their beams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slamsim.config.lidar import LidarConfig
from slamsim.core.geometry import se3_from_parts, wrap_angle
from slamsim.core.types import Drive, FloatArray, IntArray
from slamsim.dataset.truth.surfaces import TrueSurfaces
from slamsim.sensors.motion import Motion, PoseOverride, PoseSamples, beam_rays, joined, kept_since
from slamsim.sensors.readings import ScanBatch

EVERY_M, EVERY_RAD = 0.5, np.radians(30.0)
MOST_BEAMS = 180
"""Of a key scan so many beams are kept, evenly spread: enough to tell shares to a few percent."""

_FLOOR = -1


@dataclass(frozen=True, slots=True, eq=False)
class KeyScan:
    """One scan, of which every few beams are kept if they met a wall within the lidar's limits.

    row: its number among all scans. true_stamp_ns: of beam 0. pose: ``T_map_base`` (3,) then.
    way_m: driven until then. T_map_laser: 4 x 4, midway through the scan. ends_m: (n, 3) where
    the beams met walls, in the map. surfaces: (n,) which of them.
    """

    row: int
    true_stamp_ns: int
    pose: FloatArray
    way_m: float
    T_map_laser: FloatArray
    ends_m: FloatArray
    surfaces: IntArray


class Mounted(Protocol):
    """What is asked of the robot."""

    @property
    def T_base_laser(self) -> FloatArray: ...  # noqa: N802


class KeyScans:
    """The key scans of a drive, picked window by window.

    override: how the laser truly looks, as for sensing. scans: those picked so far.
    """

    def __init__(
        self, lidar: LidarConfig, robot: Mounted, override: PoseOverride, surfaces: TrueSurfaces
    ) -> None:
        self.scans: list[KeyScan] = []
        self._lidar, self._T_base_laser, self._override = lidar, robot.T_base_laser, override
        self._surfaces = surfaces
        self._motion: Motion | None = None
        self._rows, self._way_m = 0, 0.0
        self._last_m: FloatArray | None = None

    def take(self, scans: ScanBatch, window: Drive) -> None:
        """The next window of the drive, and the scans that ended in it, with their truth."""
        motion = joined(self._motion, window)
        if len(scans):
            poses, ways_m = self._places(motion, scans)
            due = self._due(poses)
            if due:
                samples = self._poses_during(motion, scans, due)
                for number in due:
                    key = self._picked(samples, scans, number, poses[number], float(ways_m[number]))
                    self.scans.append(key)
        self._rows += len(scans)
        self._motion = kept_since(motion, motion.covered_ns - round(2e9 / self._lidar.rate_hz))

    def _places(self, motion: Motion, scans: ScanBatch) -> tuple[FloatArray, FloatArray]:
        """(k, 3) poses of the base at the scans' beginnings, and (k,) the way until there."""
        stamps_ns = scans.true_stamps_ns
        path_m = motion.positions_at(stamps_ns)[:, :2]
        planar = motion.drive.trajectory().planar()
        yaws = np.interp(stamps_ns, planar.stamps_ns, np.unwrap(planar.poses[:, 2]))
        before = path_m[:1] if self._last_m is None else self._last_m
        steps_m = np.linalg.norm(np.diff(np.vstack([before, path_m]), axis=0), axis=1)
        ways_m = self._way_m + np.cumsum(steps_m)
        self._last_m, self._way_m = path_m[-1:], float(ways_m[-1])
        return np.column_stack([path_m, wrap_angle(yaws)]), ways_m

    def _due(self, poses: FloatArray) -> list[int]:
        """Which of the next scans are far enough, each from the one before that was."""
        due = list[int]()
        last = self.scans[-1].pose.tolist() if self.scans else None
        for number, (x_m, y_m, yaw_rad) in enumerate(poses.tolist()):
            if last is not None:
                turned = abs((yaw_rad - last[2] + math.pi) % (2.0 * math.pi) - math.pi)
                if math.hypot(x_m - last[0], y_m - last[1]) < EVERY_M and turned < EVERY_RAD:
                    continue
            due.append(number)
            last = (x_m, y_m, yaw_rad)
        return due

    def _poses_during(self, motion: Motion, scans: ScanBatch, due: list[int]) -> PoseSamples:
        """How the laser moved from the first of these scans to the last."""
        begin_ns, end_ns = (int(scans.true_stamps_ns[due[place]]) for place in (0, -1))
        end_ns += scans.geometry.duration_ns
        return self._override(motion.pose_samples(self._T_base_laser, begin_ns, end_ns))

    def _picked(
        self, samples: PoseSamples, scans: ScanBatch, number: int, pose: FloatArray, way_m: float
    ) -> KeyScan:
        truth, geometry = scans.truth, scans.geometry
        if truth is None:
            raise ValueError("the scans were sensed without their truth")
        every = max(-(-geometry.beam_count // MOST_BEAMS), 1)
        chosen = np.arange(0, geometry.beam_count, every)
        ranges_m = truth.ranges_m[number, chosen].astype(np.float64)
        surfaces = self._surfaces.of_beams(truth.triangles[number, chosen])
        begin_ns = int(scans.true_stamps_ns[number])
        seen = self._returns(ranges_m, truth.cos_incidence[number, chosen], surfaces)
        angles_rad = geometry.angles_rad()[chosen[seen]]
        rays = beam_rays(
            samples,
            begin_ns + geometry.offsets_ns()[chosen[seen]],
            np.stack([np.cos(angles_rad), np.sin(angles_rad)]),
            np.zeros(3),
        ).astype(np.float64)
        return KeyScan(
            row=self._rows + number,
            true_stamp_ns=begin_ns,
            pose=pose,
            way_m=way_m,
            T_map_laser=frame_at(samples, begin_ns + geometry.duration_ns // 2),
            ends_m=rays[:, :3] + ranges_m[seen, None] * rays[:, 3:],
            surfaces=surfaces[seen],
        )

    def _returns(self, ranges_m: FloatArray, cosines: FloatArray, surfaces: IntArray) -> IntArray:
        """Which beams a lidar without chance losses gets back from walls."""
        lidar = self._lidar
        least = np.cos(np.radians(lidar.max_incidence_deg))
        met = (ranges_m >= lidar.range_min_m) & (ranges_m <= lidar.range_max_m)
        met &= (cosines >= least) & (surfaces >= 0)
        met[met] &= self._surfaces.bodies[surfaces[met]] != _FLOOR
        return np.flatnonzero(met)


def frame_at(samples: PoseSamples, stamp_ns: int) -> FloatArray:
    """4 x 4 of the sensor in the map at one instant."""

    left = int(np.searchsorted(samples.stamps_ns, stamp_ns, side="right")) - 1
    left = min(max(left, 0), samples.stamps_ns.size - 2)
    begin_ns, end_ns = samples.stamps_ns[left : left + 2].tolist()
    later = (stamp_ns - begin_ns) / (end_ns - begin_ns)

    def at(values: FloatArray) -> FloatArray:
        return np.asarray((1.0 - later) * values[left] + later * values[left + 1])

    x_axis = at(samples.x_axis)
    x_axis /= np.linalg.norm(x_axis)
    z_axis = np.cross(x_axis, at(samples.y_axis))
    z_axis /= np.linalg.norm(z_axis)
    return se3_from_parts(
        np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis]), at(samples.origin_m)
    )
