"""Mends of numbers that are no measurement: dropped, or made what they were meant to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.mend_subjects import with_topic
from slamsim.check.published import sound_poses
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.recording.edits import kept


def normalise_rotations(recording: Recording, mend: Mend) -> Recording:
    """Bring an odometry's quaternions to unit length."""

    def normalised(odometry: RawOdometry) -> RawOdometry:
        length = np.linalg.norm(odometry.quats_xyzw, axis=1, keepdims=True)
        return replace(odometry, quats_xyzw=odometry.quats_xyzw / length)

    return with_topic(recording, RawOdometry, mend, normalised)


def drop_broken_poses(recording: Recording, mend: Mend) -> Recording:
    """Leave out the messages of an odometry that hold no pose."""

    def sound(odometry: RawOdometry) -> RawOdometry:
        return kept(odometry, sound_poses(odometry))

    return with_topic(recording, RawOdometry, mend, sound)


def drop_broken_readings(recording: Recording, mend: Mend) -> Recording:
    """Leave out the messages of an inertial unit that are not finite."""

    def finite(imu: RawImu) -> RawImu:
        numbers = (imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2)
        return kept(imu, is_sound(np.concatenate(numbers, axis=1)))

    return with_topic(recording, RawImu, mend, finite)


def drop_orientation(recording: Recording, mend: Mend) -> Recording:
    """Say that an inertial unit estimates no orientation."""

    def without(imu: RawImu) -> RawImu:
        return replace(imu, orientation_xyzw=None)

    return with_topic(recording, RawImu, mend, without)
