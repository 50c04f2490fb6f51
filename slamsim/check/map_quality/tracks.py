"""Where the robot was, by each stream that tells it, with every number as it is recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.model import UNKNOWNS, rolled_poses
from slamsim.check.motion.integrated import (
    IntegratedMotion,
    integrated_gyro,
    integrated_odometry,
    integrated_wheels,
)
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.readings import base_rotation

LEAST_SAMPLES = 8
_AS_REPORTED = np.array([1.0 if name.endswith("_gain") else 0.0 for name in UNKNOWNS])
"""Gains of 1, all other errors 0: the wheels as their driver reports them."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """stamps_ns (n,) ascending, poses (n, 3) of a frame with yaw unwrapped."""

    stamps_ns: IntArray
    poses: FloatArray

    def meets(self, stamps_ns: IntArray) -> bool:
        """Whether some of (m,) stamps lie within those of the track."""
        begin_ns, end_ns = self.stamps_ns[[0, -1]]
        return bool(stamps_ns.max() >= begin_ns and stamps_ns.min() <= end_ns)

    def at(self, stamps_ns: IntArray) -> FloatArray:
        """(m, 3), constant beyond the ends."""
        return track_at(self.stamps_ns, self.poses, stamps_ns)


def recorded_tracks(recording: Recording, laser_frame: str) -> dict[str, tuple[Track, FloatArray]]:
    """Every stream that tells where the robot is, with T_frame_laser (4, 4) of the frame that it
    tells it of; a gyroscope gives the heading along the path of the first of the others."""
    graph = FrameGraph(recording.transforms)
    odometries = recording.odometries
    base = graph.base(odometries[0].child_frame_ids if odometries else ())
    wheels = {ticks.topic: integrated_wheels(ticks) for ticks in recording.ticks}
    rolled = {name: _rolled(one) for name, one in wheels.items() if one is not None}
    found = {
        **{one.topic: (_recorded(one), (*one.child_frame_ids, base)[0]) for one in odometries},
        **{name: (track, base) for name, track in rolled.items()},
        **{
            f"{edge.topic} {edge.name}": (_recorded(edge), edge.child)
            for edge in recording.moving
            if not edge.parent.endswith("map")
        },
    }
    path = next((one for one in wheels.values() if one is not None), None)
    path = path or next(filter(None, map(integrated_odometry, odometries)), None)
    for imu in recording.imus:
        gyro = integrated_gyro(imu, base_rotation(recording, imu)[2])
        if path is not None and gyro is not None:
            found[imu.topic] = _by_gyro(gyro, path), base
    joined = {
        name: (track, graph.between(frame, laser_frame))
        for name, (track, frame) in found.items()
        if track is not None
    }
    return {name: (track, T) for name, (track, T) in joined.items() if T is not None}


def _recorded(stream: RawOdometry | TransformEdge) -> Track | None:
    stamps_ns, poses = planar_track(stream.stamps_ns, stream.positions_m, stream.quats_xyzw)
    return Track(stamps_ns, poses) if stamps_ns.size >= LEAST_SAMPLES else None


def _rolled(wheels: IntegratedMotion) -> Track:
    return Track(wheels.stamps_ns, rolled_poses(wheels, _AS_REPORTED))


def _by_gyro(gyro: IntegratedMotion, wheels: IntegratedMotion) -> Track:
    """The heading of the one along the path of the other."""
    path_m = wheels.at(np.asarray(1e-9 * (gyro.stamps_ns - wheels.origin_ns)))[:, 0]
    totals = np.column_stack([path_m, gyro.totals[:, 0]])
    return _rolled(IntegratedMotion(gyro.topic, gyro.stamps_ns, totals, np.zeros(2)))
