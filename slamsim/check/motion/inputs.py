"""The streams of a recording that the joint fit compares, integrated and in one frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.check.motion.integrated import (
    IntegratedMotion,
    integrated_gyro,
    integrated_odometry,
    integrated_wheels,
)
from slamsim.check.motion.laser_steps import LaserSteps, laser_steps, middle_sigma_s
from slamsim.core.geometry import se2_from_se3
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu, RawOdometry, RawScans, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.slam.laser.scan_motion import ScanMotions

EVEN, EVEN_SHARE = 0.05, 0.98
ORDER_LOST = 0.1
"""Of the time between clouds. Azimuths of a rosette that a dog carries tilted by 60 degrees are
seen at instants that scatter by a third of it, and some eight of them tell a turn. There the lidar
came out 3.5 ms late, of 100."""
SIDEWAYS_SHARE = 0.2
"""A gyroscope that turns less about the vertical, against another axis, is mounted otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """The streams to compare; None, or no steps, for those that are missing.

    steps: as seen from above. T_base_laser: (3,) x, y, yaw as declared, None if nothing does;
    upside_down: whether it is declared so. even_stamps: whether the scans' stamps keep a constant
    rate. together: whether odometry comes in the scans' messages. instant_sigma_s: how unsure it is
    when a scan was seen of which the order of the beams is lost, or the sweep is wrong.
    """

    steps: LaserSteps
    gyro: IntegratedMotion | None
    wheels: IntegratedMotion | None
    base_frame: str
    laser_frame: str
    T_base_laser: FloatArray | None
    upside_down: bool = False
    even_stamps: bool = True
    together: bool = False
    instant_sigma_s: float = 0.0


def gather_inputs(recording: Recording, motions: ScanMotions | None) -> Inputs:
    """The first lidar, inertial unit and wheels (counters, else odometry, else its transform) with
    enough samples.

    motions: of the recording's lidar by its scans alone, None without any.
    """
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.base_frames)
    alone = motions is None or not _stamped_together(recording, motions.topic)
    steps = laser_steps(motions, alone) if motions is not None else _no_steps()
    frames = {scans.topic: scans.frame_ids for scans in recording.scans}
    laser_frame = next(iter(frames.get(steps.topic, ())), "")
    T_base_laser = graph.between(base, laser_frame)
    upside_down = T_base_laser is not None and bool(T_base_laser[2, 2] < 0.0)
    compared = [scans for scans in recording.scans if scans.topic == steps.topic]
    return Inputs(
        steps=from_above(steps) if upside_down else steps,
        gyro=_first([_gyro(imu, graph, base) for imu in recording.imus]),
        wheels=_first(
            [integrated_wheels(ticks) for ticks in recording.ticks]
            + [integrated_odometry(odometry) for odometry in recording.odometries]
            + [integrated_odometry(as_odometry(edge)) for edge in _odometry_edges(recording, base)]
        ),
        base_frame=base,
        laser_frame=laser_frame,
        T_base_laser=None if T_base_laser is None else se2_from_se3(T_base_laser),
        upside_down=upside_down,
        even_stamps=all(_even(scans.stamps_ns) for scans in compared),
        together=not alone,
        instant_sigma_s=max(
            *map(_instant_sigma_s, compared),
            0.0 if motions is None else middle_sigma_s(motions),
            0.0,
        ),
    )


def _odometry_edges(recording: Recording, base: str) -> list[TransformEdge]:
    """Transforms that move the base, but for those of a localiser, which corrects itself."""
    return [
        edge for edge in recording.moving if edge.child == base and not edge.parent.endswith("map")
    ]


def as_odometry(edge: TransformEdge) -> RawOdometry:
    """The same poses as messages without twists."""
    none = np.full_like(edge.positions_m, np.nan)
    return RawOdometry(
        topic=f"{edge.topic} {edge.name}",
        frame_ids=(edge.parent,),
        stamps_ns=edge.stamps_ns,
        received_ns=edge.received_ns,
        child_frame_ids=(edge.child,),
        positions_m=edge.positions_m,
        quats_xyzw=edge.quats_xyzw,
        linear_m_s=none,
        angular_rad_s=none,
    )


def _stamped_together(recording: Recording, topic: str) -> bool:
    """Whether scans and odometry come in one message, as CARMEN has them."""
    return any(
        np.array_equal(scans.stamps_ns, odometry.stamps_ns)
        for scans in recording.scans
        for odometry in recording.odometries
        if scans.topic == topic
    )


def _even(stamps_ns: IntArray) -> bool:
    """Whether nearly all steps between stamps are one period."""
    steps = np.diff(stamps_ns)
    period = float(np.median(steps)) if steps.size else 0.0
    return bool(steps.size and np.mean(np.abs(steps - period) < EVEN * period) > EVEN_SHARE)


def _instant_sigma_s(scans: RawScans) -> float:
    period_s = float(np.median(np.diff(scans.stamps_ns))) * 1e-9 if len(scans) > 1 else 0.0
    return 0.0 if scans.in_order else ORDER_LOST * abs(period_s)


def _gyro(imu: RawImu, graph: FrameGraph, base: str) -> IntegratedMotion | None:
    T_base_imu = graph.between(base, imu.frame_ids[0]) if imu.frame_ids else None
    R_base_imu = np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]
    rates = imu.angular_velocity_rad_s @ R_base_imu.T
    finite = rates[is_sound(rates)]
    spread = finite.std(axis=0) if len(finite) else np.ones(3)
    axis = int(np.argmax(spread))
    if spread[2] > SIDEWAYS_SHARE * spread[axis]:
        axis = 2
    return integrated_gyro(imu, R_base_imu[axis], "xyz"[axis])


def _first(motions: list[IntegratedMotion | None]) -> IntegratedMotion | None:
    return next((motion for motion in motions if motion is not None), None)


def _no_steps() -> LaserSteps:
    none, places = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    return LaserSteps("", places, places, places, places, none, np.zeros((0, 3, 3)), places, 0.0)


def from_above(steps: LaserSteps) -> LaserSteps:
    """Steps of a laser that hangs upside down, mirrored as if it were upright."""
    turned = np.array([1.0, -1.0, -1.0])
    return replace(
        steps,
        T_first_second=steps.T_first_second * turned,
        information=steps.information * turned[:, None] * turned,
    )
