"""Where wheels and gyroscope say the robot went, and how far to believe them."""

from __future__ import annotations

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.geometry import between, wrap_angle
from slamsim.safe.errors import SlamsimError
from slamsim.types import BoolArray, FloatArray, ImuStream, IntArray, Log, PlanarTrajectory
from slamsim.wheels import wheel_odometry

STANDSTILL_SPEED_M_S = 2e-3
STANDSTILL_TURN_RAD_S = 4e-3
STANDSTILL_MIN_S = 0.5
STANDSTILL_MARGIN_S = 0.1
GYRO_GAP_S = 0.1
STRAIGHT_TURN_RAD_S = 0.05


class NoMotion(SlamsimError):
    """A log that says nothing about how the robot moved."""


def predict_motion(log: Log) -> PlanarTrajectory:
    """``T_odom_base``: the path of the wheels, with the gyroscope's heading when there is one.

    Encoders are preferred to odometry that somebody derived from them. The gyroscope's bias is
    taken at every standstill and interpolated between them. The result has a pose at every wheel
    and IMU stamp that the wheels cover. Raises NoMotion for a log with neither odometry nor
    encoders.
    """
    wheels = wheel_odometry(log.encoders) if log.encoders is not None else log.odometry
    if wheels is None or len(wheels) < 2:
        raise NoMotion(f"{log.name}: neither odometry nor wheel encoders in the log")
    if log.imu is None or len(log.imu.stamps_ns) < 2:
        return wheels
    rotation = np.eye(3) if log.T_base_imu is None else log.T_base_imu[:3, :3]
    return fuse_gyro(wheels, log.imu, rotation)


def fuse_gyro(
    wheels: PlanarTrajectory, imu: ImuStream, rotation_base_imu: FloatArray
) -> PlanarTrajectory:
    """Wheel path with the heading of the gyroscope; wheel heading where the IMU has gaps.

    Within a wheel interval the body's velocity is constant (an arc), so that each piece of it is
    turned by the heading of its own middle. rotation_base_imu: (3, 3).
    """
    turn_rate = imu.angular_velocity_rad_s @ rotation_base_imu[2]
    turn_rate = turn_rate - gyro_bias(wheels, imu.stamps_ns, turn_rate)
    gyro_yaw = _integrate(imu.stamps_ns, turn_rate)

    stamps_ns = np.union1d(wheels.stamps_ns, imu.stamps_ns)
    inside = (stamps_ns >= wheels.stamps_ns[0]) & (stamps_ns <= wheels.stamps_ns[-1])
    stamps_ns = stamps_ns[inside]
    interval = np.searchsorted(wheels.stamps_ns, stamps_ns[:-1], side="right") - 1
    velocity = _body_velocity(wheels)[interval]
    seconds = np.diff(stamps_ns) * 1e-9

    origin_ns = imu.stamps_ns[0]
    yaw_at = np.interp((stamps_ns - origin_ns) * 1e-9, (imu.stamps_ns - origin_ns) * 1e-9, gyro_yaw)
    turned = np.where(
        _gyro_covers(imu.stamps_ns, stamps_ns), np.diff(yaw_at), velocity[:, 2] * seconds
    )
    yaw = wheels.poses[0, 2] + np.concatenate([[0.0], np.cumsum(turned)])
    mid = yaw[:-1] + 0.5 * turned
    step_x = (velocity[:, 0] * np.cos(mid) - velocity[:, 1] * np.sin(mid)) * seconds
    step_y = (velocity[:, 0] * np.sin(mid) + velocity[:, 1] * np.cos(mid)) * seconds
    x = wheels.poses[0, 0] + np.concatenate([[0.0], np.cumsum(step_x)])
    y = wheels.poses[0, 1] + np.concatenate([[0.0], np.cumsum(step_y)])
    return PlanarTrajectory(stamps_ns, np.column_stack([x, y, wrap_angle(yaw)]))


def gyro_bias(
    wheels: PlanarTrajectory, stamps_ns: IntArray, turn_rate_rad_s: FloatArray
) -> FloatArray:
    """(n,) bias of the turn rate at each gyroscope stamp.

    The mean over each standstill of the wheels, interpolated between their middles and held
    beyond the first and last. Without a standstill: the median difference to the wheels' turn rate
    while driving straight, where a wrong track width does not matter.
    """
    origin_ns = stamps_ns[0]
    middles, means = [], []
    for start_ns, end_ns in _standstills(wheels):
        still = (stamps_ns >= start_ns) & (stamps_ns <= end_ns)
        if np.count_nonzero(still) >= 5:
            middles.append((0.5 * (start_ns - origin_ns) + 0.5 * (end_ns - origin_ns)) * 1e-9)
            means.append(float(turn_rate_rad_s[still].mean()))
    if middles:
        return np.asarray(np.interp((stamps_ns - origin_ns) * 1e-9, middles, means))
    interval = np.searchsorted(wheels.stamps_ns, stamps_ns, side="right") - 1
    covered = (interval >= 0) & (interval < len(wheels) - 1)
    wheel_rate = _body_velocity(wheels)[np.clip(interval, 0, len(wheels) - 2), 2]
    straight = covered & (np.abs(wheel_rate) < STRAIGHT_TURN_RAD_S)
    usable = straight if np.count_nonzero(straight) >= 100 else covered
    if not usable.any():
        return np.zeros(stamps_ns.size)
    bias = float(np.median((turn_rate_rad_s - wheel_rate)[usable]))
    return np.full(stamps_ns.size, bias)


def motion_covariance(
    delta: FloatArray, seconds: float, gyro: bool, config: MotionConfig
) -> FloatArray:
    """(3, 3) covariance of a predicted step, in the frame of the base at its end.

    delta: (3,) the step ``T_before_after``, short enough that its chord is its path. Sideways, the
    uncertainty of the heading on the way adds to that of the wheels.
    """
    path_m, turn_rad = float(np.hypot(delta[0], delta[1])), abs(float(delta[2]))
    if gyro:
        sigma_yaw = np.hypot(
            config.gyro_rad_per_rad * turn_rad + config.gyro_bias_rad_s * seconds,
            config.gyro_rad_per_sqrt_s * np.sqrt(seconds),
        )
    else:
        sigma_yaw = np.hypot(config.turn_rad_per_rad * turn_rad, config.turn_rad_per_m * path_m)
    sigma_m = np.hypot(config.slip_m_per_m * path_m, config.slip_m_per_rad * turn_rad)
    sideways_m = np.hypot(sigma_m, 0.5 * path_m * sigma_yaw)
    return np.diag(np.square([sigma_m, sideways_m, sigma_yaw]))


def _integrate(stamps_ns: IntArray, rate: FloatArray) -> FloatArray:
    """Trapezoids."""
    steps = 0.5 * (rate[:-1] + rate[1:]) * np.diff(stamps_ns) * 1e-9
    return np.concatenate([[0.0], np.cumsum(steps)])


def _body_velocity(wheels: PlanarTrajectory) -> FloatArray:
    """(n - 1, 3) constant velocity (m/s, m/s, rad/s) of the base that makes each step an arc."""
    step = between(wheels.poses[:-1], wheels.poses[1:])
    half = 0.5 * step[:, 2]
    # The inverse of the integral of a rotation: the chord turned back by half, and stretched.
    stretch = 1.0 / np.sinc(half / np.pi)
    cos, sin = np.cos(half), np.sin(half)
    along = (cos * step[:, 0] + sin * step[:, 1]) * stretch
    across = (-sin * step[:, 0] + cos * step[:, 1]) * stretch
    seconds = np.diff(wheels.stamps_ns)[:, None] * 1e-9
    return np.asarray(np.column_stack([along, across, step[:, 2]]) / seconds)


def _gyro_covers(imu_ns: IntArray, stamps_ns: IntArray) -> BoolArray:
    """(m - 1,) whether the gyroscope reported all through each interval of the stamps."""
    after = np.searchsorted(imu_ns, stamps_ns[1:], side="left")
    inside = (stamps_ns[:-1] >= imu_ns[0]) & (stamps_ns[1:] <= imu_ns[-1])
    after = np.clip(after, 1, imu_ns.size - 1)
    gap_s = (imu_ns[after] - imu_ns[after - 1]) * 1e-9
    return np.asarray(inside & (gap_s <= GYRO_GAP_S))


def _standstills(wheels: PlanarTrajectory) -> list[tuple[int, int]]:
    """Spans (start_ns, end_ns) in which the wheels rest, margins for spinning down left out."""
    velocity = _body_velocity(wheels)
    still = (np.hypot(velocity[:, 0], velocity[:, 1]) < STANDSTILL_SPEED_M_S) & (
        np.abs(velocity[:, 2]) < STANDSTILL_TURN_RAD_S
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    margin_ns, min_ns = round(STANDSTILL_MARGIN_S * 1e9), round(STANDSTILL_MIN_S * 1e9)
    spans = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        start_ns = int(wheels.stamps_ns[first]) + margin_ns
        end_ns = int(wheels.stamps_ns[last]) - margin_ns
        if end_ns - start_ns >= min_ns:
            spans.append((start_ns, end_ns))
    return spans
