"""Inertial unit: readings of gyroscopes and accelerometers at one point of the robot.

A sample is the mean over one period centred on its instant, as a sensor with an anti-aliasing
filter gives it without delay. The gyroscope's is the rotation over that period divided by its
length, the accelerometer's the change of the unit's own velocity (lever arm included) less what
gravity gives, seen in the orientation midway. Integrating the noiseless samples therefore gives
the true rotation and velocity back to rounding, at any rate (compare the preintegration of
Forster et al. 2017).

The error model is the usual one (IEEE 952; Kalibr's IMU model): white noise of a density n
has standard deviation n sqrt(rate) in a sample, a bias diffusing with r gains r / sqrt(rate)
from each sample to the next.
"""

from __future__ import annotations

import numpy as np

from slamsim.config.sensors import ImuConfig, InertialAxesConfig
from slamsim.core.geometry import matrix_from_xyzw, parts_xyzw, xyzw_from_matrix
from slamsim.core.randomness import random_stream
from slamsim.core.types import GRAVITY_M_S2, FloatArray, ImuStream, IntArray
from slamsim.guard.numbers import require_rigid
from slamsim.sensors.clock import StreamClock
from slamsim.sensors.motion import Motion
from slamsim.sensors.readings import ImuBatch, ImuTruth


class Imu:
    """An inertial unit mounted at ``T_base_imu`` (4 x 4)."""

    def __init__(self, config: ImuConfig, T_base_imu: FloatArray, seed: int, start_ns: int) -> None:
        require_rigid("T_base_imu", T_base_imu)
        self._config = config
        self._lever_base_m = T_base_imu[:3, 3]
        self._quat_base_imu = xyzw_from_matrix(T_base_imu[:3, :3])
        self._clock = StreamClock(config, start_ns, seed, "imu")
        self._gyro = _Triad(config.gyro, config.rate_hz, seed, "gyro")
        self._accelerometer = _Triad(config.accelerometer, config.rate_hz, seed, "accelerometer")
        # A mean cannot reach back before the drive: the first samples may have to wait.
        self._next = 0
        while self._clock.instants_ns(np.array([self._next - 0.5]))[0] < start_ns:
            self._next += 1

    @property
    def needed_ns(self) -> int:
        """The earliest instant that later samples look at."""
        return self._clock.needed_ns(self._next - 0.5)

    def sense(self, motion: Motion) -> ImuBatch:
        """All samples that the motion covers and that were not given yet."""
        samples = self._clock.samples_until(self._next, motion.covered_ns)
        ends_ns = self._clock.instants_ns(samples + 0.5)
        samples = samples[ends_ns <= motion.covered_ns]
        edges_ns = self._clock.instants_ns(np.append(samples, self._next + samples.size) - 0.5)
        self._next += samples.size
        rates, forces = _means(motion, edges_ns, self._quat_base_imu, self._lever_base_m)
        true_ns = self._clock.instants_ns(samples)
        stamps_ns = self._clock.stamps_ns(true_ns)
        arrival_ns = self._clock.arrivals_ns(edges_ns[1:])
        there = self._clock.arrived(true_ns.size)
        turning, gyro_biases = self._gyro.measure(rates)
        pulling, accelerometer_biases = self._accelerometer.measure(forces)
        stream = ImuStream(stamps_ns, turning, pulling)
        truth = ImuTruth(rates, forces, gyro_biases, accelerometer_biases)
        return ImuBatch(stream, true_ns, arrival_ns, truth).select(there)


class _Triad:
    """The errors of three orthogonal sensors: from true to measured values."""

    def __init__(self, config: InertialAxesConfig, rate_hz: float, seed: int, name: str) -> None:
        self._config = config
        self._sigma = config.noise_density * np.sqrt(rate_hz)
        self._walk_sigma = config.bias_random_walk / np.sqrt(rate_hz)
        self._noise = random_stream(seed, "imu", name, "noise")
        self._walk = random_stream(seed, "imu", name, "bias walk")
        turn_on = random_stream(seed, "imu", name, "turn-on bias")
        self._bias = config.turn_on_bias * turn_on.standard_normal(3)

    def measure(self, true: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) readings of (n, 3) true values and their biases, which walk on by n steps."""
        biases = self._biases(len(true))
        measured = true * (1.0 + np.array(self._config.scale_error)) + biases
        if self._sigma > 0.0:
            measured += self._sigma * self._noise.standard_normal(true.shape)
        measured = np.clip(measured, -self._config.saturation, self._config.saturation)
        if self._config.resolution > 0.0:
            measured = np.rint(measured / self._config.resolution) * self._config.resolution
        return np.asarray(measured), biases

    def _biases(self, count: int) -> FloatArray:
        steps = np.zeros((count + 1, 3))
        steps[0] = self._bias
        if self._walk_sigma > 0.0:
            steps[1:] = self._walk_sigma * self._walk.standard_normal((count, 3))
        walked = np.cumsum(steps, axis=0)
        self._bias = walked[-1]
        return np.asarray(walked[:-1])


def _means(
    motion: Motion, edges_ns: IntArray, quat_base_imu: FloatArray, lever_base_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean angular rate, rad/s, and specific force, m/s^2, between n + 1 edges: (n, 3) each."""
    if edges_ns.size < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    dt_s = np.diff(edges_ns)[:, None] * 1e-9
    quats_base = motion.quats_xyzw_at(edges_ns)
    lever_m = _rotated(quats_base, np.broadcast_to(lever_base_m, (edges_ns.size, 3)))
    linear, angular = motion.velocities_at(edges_ns)
    velocity = linear + np.cross(angular, lever_m)

    quats = _multiplied(quats_base, quat_base_imu)
    turn = _rotation_vector(_multiplied(_conjugated(quats[:-1]), quats[1:]))
    midway = _multiplied(quats[:-1], _from_rotation_vector(0.5 * turn))
    gravity = np.array([0.0, 0.0, -GRAVITY_M_S2])
    force_map = np.diff(velocity, axis=0) / dt_s - gravity
    return turn / dt_s, _rotated(_conjugated(midway), force_map)


def _conjugated(quats: FloatArray) -> FloatArray:
    return np.asarray(quats * np.array([-1.0, -1.0, -1.0, 1.0]))


def _multiplied(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton product of quaternions in x, y, z, w order."""
    ax, ay, az, aw = parts_xyzw(a)
    bx, by, bz, bw = parts_xyzw(b)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def _rotated(quats: FloatArray, vectors: FloatArray) -> FloatArray:
    rotations = matrix_from_xyzw(quats)
    return np.asarray(np.sum(rotations * vectors[:, None, :], axis=-1))


def _rotation_vector(quats: FloatArray) -> FloatArray:
    """(n, 3) axis times angle of unit quaternions, the short way round."""
    quats = np.where(quats[:, 3:] < 0.0, -quats, quats)
    sin_half = np.sqrt(np.sum(quats[:, :3] ** 2, axis=-1, keepdims=True))
    angle = 2.0 * np.arctan2(sin_half, quats[:, 3:])
    small = sin_half < 1e-12
    return np.asarray(quats[:, :3] * np.where(small, 2.0, angle / np.where(small, 1.0, sin_half)))


def _from_rotation_vector(vectors: FloatArray) -> FloatArray:
    """(n, 4) unit quaternions of axis times angle."""
    angle = np.sqrt(np.sum(vectors**2, axis=-1, keepdims=True))
    return np.concatenate(
        [0.5 * vectors * np.sinc(angle / (2.0 * np.pi)), np.cos(0.5 * angle)], axis=-1
    )
