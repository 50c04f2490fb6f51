"""What the robot's sensors say on a drive: scans, odometry of wheels, an inertial unit, tf."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np

from independent.drives import Drive
from independent.rays import Floats, Scene, cast, to_posts
from independent.recorded import (
    Bag,
    Edge,
    Imu,
    Odometry,
    Scans,
    Stamps,
    rpy_matrix,
    rpy_quaternion,
    yaw_quaternion,
)
from independent.robots import Robot

BEGIN_NS = 1_717_000_000_000_000_000
GRAVITY_M_S2 = 9.80665
LASER_Z_M = 0.18


@dataclass
class Conditions:
    """A drive in a room. people: legs (p, 6), each walking between two points x, y, x, y, with a
    period in s and a radius in m. clock_s: to which stamps are rounded. bursts: messages that wait
    and arrive together. slips: the wheels' slip, times that of a good floor."""

    scene: Scene
    drive: Drive
    seed: int
    people: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    clock_s: float = 0.0
    bursts: bool = False
    slips: float = 1.0

    def stream(self, name: str) -> np.random.Generator:
        """Random numbers of one effect, the same whatever else is changed."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])


def bag_with(robot: Robot, conditions: Conditions, scans: Scans) -> Bag:
    """Scans, and beside them what the other sensors say."""
    odometry = odometry_of(robot, conditions)
    base = odometry.child
    edges = [_moving_edge(odometry), *_fixed_edges(robot, base)]
    return Bag([scans], [odometry], [imu_of(robot, conditions)], edges)


class Scanner:
    """Measures where each beam goes, at its own instant."""

    def __init__(self, robot: Robot, conditions: Conditions) -> None:
        self.robot, self.conditions, self.lidar = robot, conditions, robot.lidar
        rng = conditions.stream("lidar rate")
        count = int((conditions.drive.seconds - 0.3) * self.lidar.rate_hz)
        wobble = 1.0 + 0.001 * np.sin(np.arange(count) * rng.uniform(0.01, 0.05))
        self.begins_s = 0.1 + np.cumsum(wobble * (1.0 + rng.normal(0.0, 2e-5))) / self.lidar.rate_hz

    def scans(self) -> Scans:
        """The stream."""
        return self.declared(self.measured(self.true_ranges()))

    def true_ranges(self) -> Floats:
        """Without noise (n, beams), in metres."""
        lidar, flaws = self.lidar, self.robot.flaws
        number = np.arange(lidar.beams)
        times = (self.begins_s[:, None] + lidar.beam_s * number).ravel()
        poses = self.conditions.drive.at(times)
        knocked = (times > flaws.knock_at * self.conditions.drive.seconds).astype(float)
        mount_x, mount_y, yaw = self.robot.laser
        x, y = mount_x + knocked * flaws.knock_x, mount_y + knocked * flaws.knock_y
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        origins = poses[:, :2] + np.column_stack([cos * x - sin * y, sin * x + cos * y])
        beams = np.tile(lidar.first_rad + lidar.step_rad * number, len(self.begins_s))
        angles = poses[:, 2] + yaw + knocked * flaws.knock_yaw + beams
        found = cast(self.conditions.scene, origins, angles)
        return self._with_people(found, times, origins, angles).reshape(-1, lidar.beams)

    def _with_people(self, found: Floats, times: Floats, origins: Floats, angles: Floats) -> Floats:
        people = self.conditions.people
        for leg in people:
            share = 0.5 - 0.5 * np.cos(2.0 * np.pi * times / leg[4])
            place = leg[:2] + share[:, None] * (leg[2:4] - leg[:2])
            posts = np.column_stack([place, np.full(len(times), leg[5])])[:, None]
            along = np.column_stack([np.cos(angles), np.sin(angles)])
            found = np.minimum(found, to_posts(posts, origins, along))
        return found

    def measured(self, true_m: Floats) -> Floats:
        """With noise, scale and offset, lost beams and rounding; inf for no return."""
        lidar, flaws = self.lidar, self.robot.flaws
        rng = self.conditions.stream("ranges")
        noise = rng.standard_normal(true_m.shape) * (lidar.noise_m + lidar.noise_share * true_m)
        with np.errstate(invalid="ignore"):
            ranges = true_m * (1.0 + flaws.range_scale) + flaws.range_offset + noise
        ranges = np.round(ranges / lidar.quantum_m) * lidar.quantum_m
        gone = ~(true_m < lidar.range_max_m) | (rng.random(true_m.shape) < lidar.lost)
        return np.where(gone | (ranges > lidar.range_max_m) | (ranges < 0.05), np.inf, ranges)

    def declared(self, ranges_m: Floats) -> Scans:
        """As the driver publishes them, with its stamps."""
        lidar, flaws = self.lidar, self.robot.flaws
        rng = self.conditions.stream("lidar stamps")
        step = lidar.step_rad * (1.0 + flaws.angle_step)
        sweep_s = abs(lidar.beam_s) * lidar.beams
        stamps_ns = stamped(self.begins_s, flaws.lidar_late_s, flaws.lidar_drift)
        stamps_ns += (1e9 * self.robot.jitter_s * rng.standard_normal(len(stamps_ns))).astype(int)
        middle = lidar.first_rad + lidar.step_rad * (lidar.beams - 1) / 2.0
        return Scans(
            topic="/scan",
            frame="laser",
            stamps_ns=rounded(stamps_ns, self.conditions),
            received_ns=received(
                self.conditions, self.begins_s + max(sweep_s, flaws.lidar_late_s), rng
            ),
            ranges_m=ranges_m.astype(np.float32),
            angle_min=middle - step * (lidar.beams - 1) / 2.0,
            angle_increment=step,
            time_increment=lidar.beam_s * (1.0 + flaws.sweep),
            scan_time=1.0 / lidar.rate_hz,
            range_min=0.05,
            range_max=lidar.range_max_m,
            intensities=np.zeros((len(stamps_ns), 0), np.float32),
        )


def stamped(at_s: Floats, late_s: float, drift: float) -> Stamps:
    """Stamps of what was measured at these instants."""
    return BEGIN_NS + np.round(1e9 * (at_s * (1.0 + drift) + late_s)).astype(np.int64)


def rounded(stamps_ns: Stamps, conditions: Conditions) -> Stamps:
    """By a coarse clock."""
    if not conditions.clock_s:
        return stamps_ns
    quantum_ns = int(1e9 * conditions.clock_s)
    return (stamps_ns // quantum_ns) * quantum_ns


def received(conditions: Conditions, ready_s: Floats, rng: np.random.Generator) -> Stamps:
    """When messages that were ready at these instants arrive, one after the other."""
    at_s = ready_s + 0.0015 + rng.exponential(0.0008, len(ready_s))
    if conditions.bursts:
        busy_s = np.arange(3.0, ready_s[-1], 7.0)
        for begin_s in busy_s:
            at_s = np.where((at_s > begin_s) & (at_s < begin_s + 0.18), begin_s + 0.18, at_s)
    return BEGIN_NS + np.round(1e9 * np.maximum.accumulate(at_s)).astype(np.int64)


def _beat(conditions: Conditions, rate_hz: float, name: str) -> tuple[Floats, np.random.Generator]:
    """Instants of measurement of a stream, and its random numbers."""
    rng = conditions.stream(name)
    begin_s = rng.uniform(0.0, 1.0 / rate_hz)
    count = int((conditions.drive.seconds - begin_s) * rate_hz)
    return begin_s + np.arange(count) / rate_hz * (1.0 + rng.normal(0.0, 1e-6)), rng


def odometry_of(robot: Robot, conditions: Conditions) -> Odometry:
    """Poses and twists from counters of both wheels, by arcs."""
    flaws = robot.flaws
    at_s, rng = _beat(conditions, robot.odometry_hz, "odometry")
    rolled_m = _wheel_paths(robot, conditions, at_s)
    jitter_ns = 1e9 * 0.5 * robot.jitter_s * rng.standard_normal(len(at_s))
    stamps_ns = stamped(at_s, flaws.wheels_late_s, flaws.wheels_drift)
    counted_m = np.round(rolled_m * robot.ticks_per_m) / robot.ticks_per_m
    side = np.array([1.0 + 0.5 * flaws.unequal, 1.0 - 0.5 * flaws.unequal])
    steps = np.diff(counted_m, axis=0, prepend=counted_m[:1]) * side * (1.0 + flaws.radius)
    forward = steps.mean(axis=1)
    turned = (steps[:, 1] - steps[:, 0]) / (robot.track_m * (1.0 + flaws.track))
    yaw = np.cumsum(turned)
    chord = forward * np.sinc(turned / (2.0 * np.pi))
    middle = yaw - 0.5 * turned
    xy_m = np.cumsum(np.column_stack([chord * np.cos(middle), chord * np.sin(middle)]), axis=0)
    rates = np.column_stack([forward, turned]) * robot.odometry_hz
    none = np.zeros(len(at_s))
    return Odometry(
        topic="/odom",
        frame="odom",
        stamps_ns=rounded(stamps_ns + jitter_ns.astype(np.int64), conditions),
        received_ns=received(conditions, at_s + max(0.0, flaws.wheels_late_s), rng),
        child="base_footprint" if robot.footprint else "base_link",
        xy_m=xy_m,
        quaternion=yaw_quaternion(yaw),
        linear=np.column_stack([rates[:, 0], none, none]),
        angular=np.column_stack([none, none, rates[:, 1]]),
    )


def _wheel_paths(robot: Robot, conditions: Conditions, at_s: Floats) -> Floats:
    """What left and right wheel rolled (n, 2), in metres; slip is a random walk of the path."""
    fine_s = np.arange(0.0, conditions.drive.seconds, 0.002)
    rates = conditions.drive.rates_at(fine_s)
    half = 0.5 * robot.track_m * rates[:, 1]
    steps = np.column_stack([rates[:, 0] - half, rates[:, 0] + half]) * 0.002
    rng = conditions.stream("slip")
    slip = robot.slip * conditions.slips * rng.standard_normal(steps.shape)
    rolled = np.cumsum(steps + slip * np.sqrt(np.abs(steps)), axis=0)
    return np.column_stack([np.interp(at_s, fine_s + 0.001, rolled[:, side]) for side in (0, 1)])


def imu_of(robot: Robot, conditions: Conditions) -> Imu:
    """Turn rates and accelerations in the unit's own frame."""
    flaws, (rx, ry) = robot.flaws, robot.imu_xy
    at_s, rng = _beat(conditions, robot.imu_hz, "imu")
    n, dt = len(at_s), 1.0 / robot.imu_hz
    (v, w), (dv, dw) = conditions.drive.rates_at(at_s).T, _growth(conditions.drive, at_s)
    roll, pitch, yaw = robot.imu_rpy
    turn = rpy_matrix(roll - flaws.imu_roll, pitch - flaws.imu_pitch, yaw - flaws.imu_yaw)
    walk = np.cumsum(rng.standard_normal((n, 3)), axis=0) * 5e-6 * np.sqrt(dt)
    shaken = 0.02 + 0.25 * np.abs(v)[:, None]
    felt = np.column_stack(
        [dv - w**2 * rx - dw * ry, v * w + dw * rx - w**2 * ry, np.full(n, GRAVITY_M_S2)]
    ) + shaken * rng.standard_normal((n, 3))
    turning = np.column_stack([np.zeros(n), np.zeros(n), w * (1.0 + flaws.gyro_scale)])
    turning += 0.004 * np.abs(v)[:, None] * rng.standard_normal((n, 3)) * [1.0, 1.0, 0.2]
    bias = np.array([*rng.normal(0.0, 0.001, 2), flaws.gyro_bias])
    noise = 0.0015 * rng.standard_normal((n, 3))
    jitter_ns = 1e9 * 0.5 * robot.jitter_s * rng.standard_normal(n)
    stamps_ns = stamped(at_s, flaws.imu_late_s, flaws.imu_drift)
    heading = conditions.drive.at(at_s)[:, 2] + np.cumsum(walk[:, 2] + flaws.gyro_bias * 0.1) * dt
    return Imu(
        topic="/imu",
        frame="imu_link",
        stamps_ns=rounded(stamps_ns + jitter_ns.astype(np.int64), conditions),
        received_ns=received(conditions, at_s + max(0.0, flaws.imu_late_s), rng),
        gyro=turning @ turn + bias + walk + noise,
        acceleration=felt @ turn + rng.normal(0.0, 0.03, 3),
        quaternion=yaw_quaternion(heading + yaw) if robot.orientation else None,
    )


def _growth(drive: Drive, at_s: Floats) -> Floats:
    """Of speed and turn rate (2, n), a second."""
    return np.asarray((drive.rates_at(at_s + 0.01) - drive.rates_at(at_s - 0.01)).T / 0.02)


def _moving_edge(odometry: Odometry) -> Edge:
    places = np.column_stack([odometry.xy_m, np.zeros(len(odometry.xy_m))])
    return Edge(
        "/tf",
        odometry.frame,
        odometry.stamps_ns.copy(),
        odometry.received_ns + 200_000,
        odometry.child,
        places,
        odometry.quaternion.copy(),
    )


def _fixed_edges(robot: Robot, base: str) -> list[Edge]:
    """base -> laser as declared, base -> imu_link; with a footprint base_link is between."""
    x, y, yaw = robot.laser
    flaws = robot.flaws
    laser = (x + flaws.laser_x, y + flaws.laser_y, LASER_Z_M)
    edges = [
        fixed_edge("base_link", "laser", laser, (0.0, 0.0, yaw + flaws.laser_yaw)),
        fixed_edge("base_link", "imu_link", (*robot.imu_xy, 0.1), robot.imu_rpy),
    ]
    if robot.footprint:
        edges.append(fixed_edge(base, "base_link", (0.0, 0.0, 0.05), (0.0, 0.0, 0.0)))
    return edges


def fixed_edge(
    parent: str, child: str, at_m: tuple[float, float, float], rpy: tuple[float, float, float]
) -> Edge:
    """A fixed transform, published once before all else."""
    begin = np.array([BEGIN_NS - 500_000_000])
    place, turn = np.array([at_m]), rpy_quaternion(*rpy)[None]
    return Edge("/tf_static", parent, begin, begin.copy(), child, place, turn, static=True)
