"""A robot whose true motion is known in closed form, and what its sensors make of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.integrated import integrated_gyro, integrated_wheels
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawImu, RawTicks

BEGIN_NS = 5_000_000_000
FINE_S = 0.0005
RADIUS_M, TRACK_M, TICKS = 0.035, 0.23, 4096
SIGMAS = np.array([5e-4, 5e-4, 1.2e-4])
T_BASE_LASER = np.array([0.08, -0.02, 0.3])


@dataclass(frozen=True)
class Robot:
    """A drive of so many seconds, and how its sensors are off.

    Delays: stamp less true time. gyro_scale: read over true. radius, track: believed over true.
    """

    seconds: float = 40.0
    seed: int = 0
    lidar_late_s: float = 0.0
    gyro_late_s: float = 0.0
    wheels_late_s: float = 0.0
    lidar_drift: float = 0.0
    gyro_scale: float = 1.0
    gyro_bias: float = 0.002
    radius: float = 1.0
    track: float = 1.0
    T_base_laser: FloatArray = field(default_factory=T_BASE_LASER.copy)
    noise: float = 1.0
    turning: float = 1.0

    def times_s(self) -> FloatArray:
        return np.arange(0.0, self.seconds, FINE_S)

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forward, m/s, and turn, rad/s."""
        rng = np.random.default_rng(self.seed)
        phase = rng.uniform(0.0, 2.0 * np.pi, 6)
        pace = rng.uniform(0.8, 1.2, 6)
        forward = 0.5 + 0.2 * np.sin(0.7 * pace[0] * t + phase[0])
        turn = sum(
            0.5 * np.sin(pace[k] * frequency * t + phase[k])
            for k, frequency in ((1, 0.5), (2, 1.1), (3, 2.3), (4, 4.1))
        )
        return forward, self.turning * np.asarray(turn)

    def totals(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Path (n,), heading (n,) and poses (n, 3) at ``times_s``."""
        forward, turn = self.rates(self.times_s())
        path = np.concatenate([[0.0], np.cumsum(forward[:-1]) * FINE_S])
        heading = np.concatenate([[0.0], np.cumsum(turn[:-1]) * FINE_S])
        x = np.concatenate([[0.0], np.cumsum(forward[:-1] * np.cos(heading[:-1])) * FINE_S])
        y = np.concatenate([[0.0], np.cumsum(forward[:-1] * np.sin(heading[:-1])) * FINE_S])
        return path, heading, np.column_stack([x, y, heading])

    def imu(self) -> RawImu:
        edges = np.arange(0.01, self.seconds - 0.01, 0.005)
        heading = np.interp(edges, self.times_s(), self.totals()[1])
        rng = np.random.default_rng(self.seed + 1)
        rate = self.gyro_scale * np.diff(heading) / 0.005 + self.gyro_bias
        rate = rate + self.noise * 0.002 * rng.standard_normal(rate.size)
        rates = np.column_stack([np.zeros((rate.size, 2)), rate])
        stamps = _ns(0.5 * (edges[1:] + edges[:-1]) + self.gyro_late_s)
        return RawImu("/imu", ("imu_link",), stamps, None, rates, np.zeros((rate.size, 3)))

    def ticks(self) -> RawTicks:
        t = np.arange(0.0, self.seconds - FINE_S, 0.02)
        path, heading, _ = self.totals()
        along, turned = (np.interp(t, self.times_s(), values) for values in (path, heading))
        rolled = along[:, None] + 0.5 * TRACK_M * turned[:, None] * np.array([-1.0, 1.0])
        counts = np.floor(rolled / (2.0 * np.pi * RADIUS_M) * TICKS).astype(np.int64)
        sizes = (TICKS, RADIUS_M * self.radius, TRACK_M * self.track)
        return RawTicks("/ticks", ("base_link",), _ns(t + self.wheels_late_s), None, counts, *sizes)

    def steps(self) -> LaserSteps:
        """From scan to scan at 20 Hz, in windows of four seconds."""
        t = np.arange(0.05, self.seconds - 0.05, 0.05)
        poses = self.totals()[2]
        at = np.column_stack([np.interp(t, self.times_s(), poses[:, k]) for k in range(3)])
        rng = np.random.default_rng(self.seed + 2)
        seen = compose(compose(at, self.T_base_laser), rng.standard_normal(at.shape) * SIGMAS)
        moved = between(seen[:-1], seen[1:])
        moved = compose(moved, 0.3 * rng.standard_normal(moved.shape) * SIGMAS)
        count, scans = len(moved), np.arange(len(t))
        information = np.tile(np.diag(1.0 / (2.09 * SIGMAS**2)), (count, 1, 1))
        stamps = _ns(t * (1.0 + self.lidar_drift) + self.lidar_late_s)
        window = (t[:-1] // 4.0).astype(np.int64)
        ends = (scans[:-1], scans[1:], stamps[:-1], stamps[1:])
        return LaserSteps("/scan", *ends, moved, information, window, 0.04)

    def inputs(self) -> Inputs:
        gyro = integrated_gyro(self.imu(), np.array([0.0, 0.0, 1.0]))
        wheels = integrated_wheels(self.ticks())
        return Inputs(self.steps(), gyro, wheels, "base_link", "laser_link", T_BASE_LASER)

    def calibrated(self) -> Calibration:
        found = calibrate_inputs(self.inputs())
        assert found is not None
        return found


def without(inputs: Inputs, name: str) -> Inputs:
    """The same robot without its ``steps``, ``gyro`` or ``wheels``."""
    if name == "steps":
        return replace(inputs, steps=inputs.steps.select(np.zeros(len(inputs.steps), dtype=bool)))
    return replace(inputs, gyro=None) if name == "gyro" else replace(inputs, wheels=None)


def _ns(seconds: FloatArray) -> IntArray:
    return np.asarray(BEGIN_NS + np.rint(seconds * 1e9).astype(np.int64))
