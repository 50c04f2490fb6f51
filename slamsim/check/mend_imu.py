"""Mends of the inertial unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.frame_graph import FrameGraph
from slamsim.check.mend_subjects import number, with_topic
from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, Recording


def scale_acceleration(recording: Recording, mend: Mend) -> Recording:
    """Multiply accelerations by factor."""
    factor = number(mend, "factor")

    def scaled(imu: RawImu) -> RawImu:
        return replace(imu, linear_acceleration_m_s2=imu.linear_acceleration_m_s2 * factor)

    return with_topic(recording, RawImu, mend, scaled)


def scale_gyro(recording: Recording, mend: Mend) -> Recording:
    """Multiply rates of turn by factor."""
    factor = number(mend, "factor")

    def scaled(imu: RawImu) -> RawImu:
        return replace(imu, angular_velocity_rad_s=imu.angular_velocity_rad_s * factor)

    return with_topic(recording, RawImu, mend, scaled)


def subtract_gyro_bias(recording: Recording, mend: Mend) -> Recording:
    """Take bias_rad_s off the rate of turn about the base's vertical."""
    bias_rad_s = number(mend, "bias_rad_s")

    def freed(imu: RawImu) -> RawImu:
        up = base_rotation(recording, imu).T @ np.array([0.0, 0.0, 1.0])
        rates = imu.angular_velocity_rad_s - bias_rad_s * up
        return replace(imu, angular_velocity_rad_s=rates)

    return with_topic(recording, RawImu, mend, freed)


def rotate_imu(recording: Recording, mend: Mend) -> Recording:
    """Turn the readings, on the shortest way, until gravity stands upright in the base.

    up_x, up_y, up_z: where it stands in the base as declared.
    """
    up = np.array([number(mend, name) for name in ("up_x", "up_y", "up_z")])

    def turned(imu: RawImu) -> RawImu:
        R_base_imu = base_rotation(recording, imu)
        R = R_base_imu.T @ _upright(up) @ R_base_imu
        return replace(
            imu,
            angular_velocity_rad_s=imu.angular_velocity_rad_s @ R.T,
            linear_acceleration_m_s2=imu.linear_acceleration_m_s2 @ R.T,
        )

    return with_topic(recording, RawImu, mend, turned)


def base_rotation(recording: Recording, imu: RawImu) -> FloatArray:
    """(3, 3) from the unit's frame to the base, none where nobody declares it."""
    graph = FrameGraph(recording.transforms)
    children = recording.odometries[0].child_frame_ids if recording.odometries else ()
    T_base_imu = graph.between(graph.base(children), imu.frame_ids[0]) if imu.frame_ids else None
    return np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]


def _upright(up: FloatArray) -> FloatArray:
    """(3, 3) the least rotation that takes up to z (Rodrigues); half a turn about x if opposite."""
    up = up / np.linalg.norm(up)
    axis, cosine = np.cross(up, [0.0, 0.0, 1.0]), float(up[2])
    if cosine < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))
