"""Faults that drivers, restarts and merged recordings are known for."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np

from independent.drives import random_drive
from independent.fault import Fault, Made, fault, of_all, of_lidar, of_wheels
from independent.odometry import integrated_anew, odometry_in, publish, steps_in
from independent.recorded import Messages, yaw_of, yaw_quaternion
from independent.robots import Robot
from independent.sensors import BEGIN_NS, imu_of, odometry_of


def _unpadded(made: Made) -> None:
    """Seconds and nanoseconds printed with a point between them, without leading zeros: 3 s and
    5 ms are read as 3.5 s."""
    for stream in of_lidar(made.bag):
        whole, rest = np.divmod(stream.stamps_ns, 1_000_000_000)
        read = [int(str(each).ljust(9, "0")) for each in rest.tolist()]
        stream.stamps_ns = np.asarray(1_000_000_000 * whole + np.array(read, np.int64))


def _single_precision(made: Made) -> None:
    """Seconds since 1970 held in four bytes: steps of 128 s."""
    for stream in of_lidar(made.bag):
        seconds = (1e-9 * stream.stamps_ns).astype(np.float32)
        stream.stamps_ns = seconds.astype(np.int64) * 1_000_000_000


def _never_stamped(made: Made) -> None:
    made.bag.imu[0].stamps_ns = np.zeros_like(made.bag.imu[0].stamps_ns)


def _hour_put_forward(made: Made) -> None:
    """The computer's clock is set half-way: all stamps and all times of receipt."""
    for stream in of_all(made.bag):
        later = np.where(stream.received_ns > BEGIN_NS + 30_000_000_000, 3_600_000_000_000, 0)
        stream.stamps_ns = stream.stamps_ns + later
        stream.received_ns = stream.received_ns + later


def _counted_at_nominal_rate(made: Made) -> None:
    """The motor turns 1.5 % slower than its data sheet says, by which scans are stamped."""
    for stream in of_lidar(made.bag):
        lasts_ns = float(np.ptp(stream.stamps_ns)) / 1.015
        counted_ns = np.linspace(0.0, lasts_ns, len(stream.stamps_ns)).astype(np.int64)
        stream.stamps_ns = stream.stamps_ns[0] + counted_ns


def _again(stream: Messages, begin_s: float, end_s: float, later_ns: int) -> None:
    """What was received within a while is received once more."""
    at_s = 1e-9 * (stream.received_ns - BEGIN_NS)
    inside = np.flatnonzero((at_s >= begin_s) & (at_s < end_s))
    count = len(stream.stamps_ns)
    stream.take(np.concatenate([np.arange(count), inside]))
    stream.received_ns = stream.received_ns + np.where(
        np.arange(count + len(inside)) >= count, later_ns, 0
    )
    stream.take(np.argsort(stream.received_ns, kind="stable"))


def _merged(made: Made) -> None:
    """Two parts of a recording that overlap by 5 s are put together."""
    for stream in of_all(made.bag):
        _again(stream, 20.0, 25.0, 0)


def _played_in_a_loop(made: Made) -> None:
    """Recorded from a player that began again at the end, for 10 s."""
    for stream in of_all(made.bag):
        _again(stream, 0.0, 10.0, 60_500_000_000)


def _restarted(made: Made) -> None:
    """The driver of the wheels begins at zero again."""
    forward, turned = steps_in(made)
    half = len(forward) // 2
    first, second = (_walked(forward[at], turned[at]) for at in (slice(half), slice(half, None)))
    xy_m, yaw = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    publish(made, xy_m, yaw)


def _walked(forward: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    yaw = np.cumsum(turned)
    along = np.column_stack([np.cos(yaw), np.sin(yaw)]) * forward[:, None]
    return np.cumsum(along, axis=0), yaw


def _counter_overflows(made: Made) -> None:
    """The left wheel's counter of sixteen bits runs over once, and is taken for what it says."""
    forward, turned = steps_in(made)
    lost_m = 65536.0 / made.robot.ticks_per_m
    at = len(forward) // 3
    forward[at] -= 0.5 * lost_m
    turned[at] += lost_m / made.robot.track_m
    integrated_anew(made, forward, turned)


def _degrees_for_radians(made: Made) -> None:
    """The heading goes in degrees where the quaternion is made."""
    odometry = odometry_in(made)
    publish(made, odometry.xy_m, np.rad2deg(yaw_of(odometry.quaternion)))


def _handed(made: Made) -> None:
    """The heading counts clockwise, places do not."""
    odometry = odometry_in(made)
    publish(made, odometry.xy_m, -yaw_of(odometry.quaternion))


def _two_decimals(made: Made) -> None:
    """Poses come over a line of text, in centimetres and hundredths of a radian."""
    odometry = odometry_in(made)
    publish(made, np.round(odometry.xy_m, 2), np.round(yaw_of(odometry.quaternion), 2))


def _second_publisher(made: Made, of_tf: bool) -> None:
    """A filter publishes what the driver publishes as well; its paths are 3 % longer."""
    forward, turned = steps_in(made)
    xy_m, yaw = _walked(1.03 * forward, turned)
    stream = of_wheels(made.bag)[1 if of_tf else 0]
    other = deepcopy(stream)
    if of_tf:
        other.translation = np.column_stack([xy_m, np.zeros(len(xy_m))])  # type: ignore[attr-defined]
    else:
        other.xy_m = xy_m  # type: ignore[attr-defined]
    other.quaternion = yaw_quaternion(yaw)  # type: ignore[attr-defined]
    half_ns = round(0.5e9 / made.robot.odometry_hz)
    other.stamps_ns, other.received_ns = other.stamps_ns + half_ns, other.received_ns + half_ns
    (made.bag.edges if of_tf else made.bag.odometry).append(other)  # type: ignore[arg-type]


def _of_another_drive(made: Made, of_imu: bool) -> None:
    """A recording of another day in the same room was merged in."""
    conditions = made.conditions
    drive = random_drive(conditions.scene, made.rng, conditions.drive.seconds)
    other = replace(conditions, drive=drive, seed=conditions.seed + 1)
    if of_imu:
        made.bag.imu = [imu_of(made.robot, other)]
        return
    old = odometry_in(made)
    odometry = odometry_of(made.robot, other)
    count = len(old.stamps_ns)
    odometry.take(np.minimum(np.arange(count), len(odometry.stamps_ns) - 1))
    old.linear, old.angular = odometry.linear, odometry.angular
    publish(made, odometry.xy_m, yaw_of(odometry.quaternion))


def _thinned(made: Made, every: int) -> None:
    """To save bandwidth; angle and time between beams are left as they were."""
    scans = made.bag.scans[0]
    scans.ranges_m = scans.ranges_m[:, ::every]
    scans.angle_max = scans.angle_min + scans.angle_increment * (scans.ranges_m.shape[1] - 1)


def _wrapped_ranges(made: Made) -> None:
    """Twelve bits of millimetres: what is farther than 4.096 m seems near."""
    scans = made.bag.scans[0]
    seen = np.isfinite(scans.ranges_m)
    scans.ranges_m = scans.ranges_m.copy()
    scans.ranges_m[seen] %= np.float32(4.096)


def _other_side(made: Made) -> None:
    """The laser's place is declared with the wrong sign of x."""
    edge = made.bag.edge("laser")
    edge.translation = edge.translation * [-1.0, 1.0, 1.0]


def _declared_upside_down(made: Made) -> None:
    """The robot description was copied from one whose laser hangs: roll of 180 degrees."""
    edge = made.bag.edge("laser")
    x, y, z, w = edge.quaternion.T
    edge.quaternion = np.column_stack([w, z, -y, -x])


def _off_axle(robot: Robot) -> bool:
    """At least 5 cm."""
    return abs(robot.laser[0]) > 0.05


def _sees_far(robot: Robot) -> bool:
    return robot.lidar.range_max_m > 7.0


LATE = "stamps_late stamps_future tf_coverage"
"""What stamps of quite another time bring with them."""

OF_STAMPS = [
    fault(
        "stamps_unpadded",
        "driver_events",
        "stamps_backward stamps_jitter",
        f"scans_overlap stamps_repeated {LATE}",
        change=_unpadded,
    ),
    fault(
        "stamps_single_precision",
        "driver_stamps",
        "stamps_quantised stamps_repeated",
        f"epoch_mismatch {LATE}",
        change=_single_precision,
    ),
    fault(
        "imu_never_stamped",
        "driver_stamps",
        "epoch_mismatch stamps_repeated",
        f"epoch_mismatch stamps_repeated {LATE}",
        change=_never_stamped,
    ),
    fault(
        "clock_set_by_1h",
        "driver_events",
        "clock_step stream_gaps",
        "clock_step stream_gaps",
        change=_hour_put_forward,
    ),
    fault(
        "scans_at_nominal_rate",
        "driver_stamps",
        "clock_drift stamps_invented",
        "clock_drift stamps_invented stamps_late",
        change=_counted_at_nominal_rate,
    ),
    fault(
        "parts_overlap",
        "driver_events",
        "stamps_repeated stamps_backward",
        "stamps_repeated stamps_backward scan_stuck imu_stuck",
        change=_merged,
    ),
    fault(
        "played_in_a_loop",
        "driver_events",
        "stamps_backward",
        "stamps_late stamps_repeated clock_step odometry_jump",
        change=_played_in_a_loop,
    ),
]

OF_MOTION = [
    fault("odometry_restarts", "driver_odometry", "odometry_jump", change=_restarted),
    fault(
        "counter_overflows",
        "driver_odometry",
        "odometry_jump ticks_wrap",
        "odometry_jump ticks_wrap",
        change=_counter_overflows,
    ),
    fault(
        "heading_in_degrees",
        "driver_odometry",
        "odometry_heading",
        change=_degrees_for_radians,
    ),
    fault("heading_clockwise", "driver_odometry", "odometry_heading", change=_handed),
    fault("odometry_two_decimals", "driver_odometry", "odometry_coarse", change=_two_decimals),
    fault(
        "tf_published_twice",
        "two_publishers",
        "tf_contradicts_odometry topic_shared",
        "tf_contradicts_odometry topic_shared",
        change=lambda made: _second_publisher(made, of_tf=True),
    ),
    fault(
        "odometry_published_twice",
        "two_publishers",
        "topic_shared odometry_jump odometries_contradict",
        "topic_shared odometry_jump odometries_contradict tf_contradicts_odometry odometry_twist",
        change=lambda made: _second_publisher(made, of_tf=False),
    ),
]

MERGED = [
    fault(
        "odometry_of_another_drive",
        "other_drive",
        "does_not_fit",
        change=lambda made: _of_another_drive(made, of_imu=False),
    ),
    fault(
        "imu_of_another_drive",
        "other_drive",
        "does_not_fit",
        change=lambda made: _of_another_drive(made, of_imu=True),
    ),
]

OF_LASERS = [
    fault(
        "every_second_beam",
        "driver_laser",
        "laser_angle_step",
        change=lambda made: _thinned(made, 2),
    ),
    fault(
        "every_third_beam",
        "driver_laser",
        "laser_angle_step",
        change=lambda made: _thinned(made, 3),
    ),
    fault(
        "ranges_wrap_4m",
        "driver_laser",
        "ranges_wrapped",
        change=_wrapped_ranges,
        fits=_sees_far,
    ),
    fault(
        "laser_on_other_side",
        "driver_mount",
        "laser_position",
        change=_other_side,
        fits=_off_axle,
    ),
    fault(
        "declared_upside_down",
        "driver_mount",
        "laser_mirrored laser_upside_down",
        change=_declared_upside_down,
    ),
]

DRIVER_FAULTS: list[Fault] = [*OF_STAMPS, *OF_MOTION, *MERGED, *OF_LASERS]
