"""Open-loop commands on a ground: the robot executes them and everything is recorded."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

import numpy as np

from slamsim.config.drive import PhysicsConfig
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import Drive, EncoderStream, FloatArray, IntArray, Trajectory
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_number
from slamsim.sim.bullet import pybullet
from slamsim.sim.drive.drive_loop import BasePose, DriveLoop
from slamsim.sim.drive.follow import Twist
from slamsim.sim.engine import set_gravity, standing_robot
from slamsim.sim.ground import Floor, Ground, add_blocks
from slamsim.sim.robot.chassis import Engine, set_wheel_friction
from slamsim.sim.robot.model import RobotModel

CONTROL_HZ = 40
"""Commands per second, as in a drive along a route, or the nearest that the physics allows."""
LEAST_UP = math.cos(math.radians(60.0))
"""A robot that leans further than this does not come back."""
FARTHEST_M = 1e4
HAND_N_M, HAND_N_S_M = 5000.0, 150.0
"""A firm hand: it gives way by a centimetre at 50 N."""
LONGEST_S = 100_000.0
NORMAL_FORCE = 9
"""Place of the normal force in PyBullet's contact points."""
FINEST_TICKS = 1_000_000


@dataclass(frozen=True, slots=True)
class Command:
    """A twist that is commanded for a while."""

    duration_s: float
    speed_m_s: float
    yaw_rate_rad_s: float = 0.0

    def __post_init__(self) -> None:
        require_number("the speed of a command in m/s", self.speed_m_s)
        require_number("the yaw rate of a command in rad/s", self.yaw_rate_rad_s)
        require_number("the seconds of a command", self.duration_s, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """What the robot felt at each physics step, as it acted in the step before.

    wheel_load_n: (n, 2) normal force of the floor on the left and right drive wheel.
    support_load_n: (n, 2) on the front and the rear support wheel. body_load_n: (n,) of blocks and
    floor on the body. motor_torque_n_m: (n, 2) at the left and right wheel.
    """

    wheel_load_n: FloatArray
    support_load_n: FloatArray
    body_load_n: FloatArray
    motor_torque_n_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ScriptedRun:
    """What became of the commands.

    drive: the true motion at the physics rate in the frame of the slope; wall_contact tells of
    any block, at the control rate. blocks: how each moved; a fixed one has a single pose.
    forces: None unless asked for. ended: why it was over early ("tipped over", "left the floor",
    "not a number"), else empty.
    """

    drive: Drive
    blocks: tuple[Trajectory, ...]
    forces: Forces | None
    ended: str


def scripted_run(
    robot: RobotModel,
    ground: Ground,
    commands: Sequence[Command],
    physics: PhysicsConfig,
    *,
    start_pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    forces: bool = False,
) -> ScriptedRun:
    """The robot plays the commands, one after the other, from rest at (x_m, y_m, yaw_rad).

    It settles on the level ground; the ground tilts as the first command begins. forces: whether
    each step's contact forces are read, which takes about as long as the step. Raises SlamsimError
    for commands that last for no time or too long, and if the physics fails before the first one.
    """
    down = -ground.gravity_m_s2[2]
    furnish = partial(add_blocks, blocks=ground.blocks)
    with standing_robot(
        robot, physics, np.array(start_pose, dtype=np.float64), ground.friction, furnish, down
    ) as engine:
        play = _Play(engine, robot, ground, commands, physics)
        return play.run(forces)


class _Play:
    """One running script."""

    def __init__(
        self,
        engine: Engine,
        robot: RobotModel,
        ground: Ground,
        commands: Sequence[Command],
        physics: PhysicsConfig,
    ) -> None:
        steps_per_tick = max(round(physics.rate_hz / CONTROL_HZ), 1)
        self._engine, self._ground, self._commands = engine, ground, tuple(commands)
        self._tick_s = steps_per_tick / physics.rate_hz
        self._ends_s = list(accumulate(command.duration_s for command in commands))
        if not (self._ends_s and self._tick_s <= self._ends_s[-1] <= LONGEST_S):
            raise SlamsimError(
                f"the commands of a script last for {self._tick_s:g} to {LONGEST_S:g} s in all"
            )
        self._ride = DriveLoop(engine, robot, physics.rate_hz, steps_per_tick)
        self._floor = Floor(engine, ground.friction, ground.patches)
        if ground.under_wheels is not None:
            set_wheel_friction(engine, *ground.under_wheels)
        self._watch = _Watch(engine, ground)
        self._tick, self._ended = 0, ""

    def run(self, forces: bool) -> ScriptedRun:
        set_gravity(self._engine.client, self._ground.gravity_m_s2)
        watch = self._watch.all if forces else self._watch.hand_and_blocks
        while not self._ended and self._tick < round(self._ends_s[-1] / self._tick_s):
            self._ride.control_tick(self._decide, watch)
            self._tick += 1
        drive = self._ride.take_window()
        if len(drive) == 0:
            raise SlamsimError(
                "the physics failed while the robot came to rest: its pose is not a number"
            )
        return ScriptedRun(
            drive,
            self._watch.trajectories(drive.stamps_ns),
            self._watch.felt(len(drive)) if forces else None,
            self._ended,
        )

    def _decide(self, pose: BasePose) -> Twist:
        self._ended = _trouble(pose)
        if not self._ended:
            self._floor.update(pose.x_m, pose.y_m, pose.yaw_rad)
        now_s = (self._tick + 1e-6) * self._tick_s
        command = self._commands[bisect_right(self._ends_s, now_s)]
        return command.speed_m_s, command.yaw_rate_rad_s


def _trouble(pose: BasePose) -> str:
    if not math.isfinite(sum(pose)):
        return "not a number"
    if max(abs(pose.x_m), abs(pose.y_m), abs(pose.z_m)) > FARTHEST_M:
        return "left the floor"
    return "tipped over" if pose.up < LEAST_UP else ""


class _Hand:
    """A spring with a damper between a point of the robot and where that was at first."""

    def __init__(self, engine: Engine, height_m: float) -> None:
        self._engine = engine
        T_com_base = np.linalg.inv(engine.T_base_com)
        self._point_com_m = (T_com_base @ np.array([0.0, 0.0, height_m, 1.0]))[:3]
        self._held_m = self._point()[0]

    def _point(self) -> tuple[FloatArray, FloatArray]:
        """Its position and its velocity, (3,) each."""
        body, client = self._engine.body, self._engine.client
        position, quaternion = pybullet.getBasePositionAndOrientation(body, client)
        linear, angular = pybullet.getBaseVelocity(body, client)
        arm = matrix_from_xyzw(np.array(quaternion)) @ self._point_com_m
        return np.array(position) + arm, np.array(linear) + np.cross(angular, arm)

    def hold(self) -> None:
        """Push during the next step."""
        point_m, velocity_m_s = self._point()
        force_n = HAND_N_M * (self._held_m - point_m) - HAND_N_S_M * velocity_m_s
        pybullet.applyExternalForce(
            self._engine.body,
            -1,
            (*force_n[:2], 0.0),
            point_m,
            pybullet.WORLD_FRAME,
            self._engine.client,
        )


class _Watch:
    """What is read at each step beside the robot's own motion."""

    def __init__(self, engine: Engine, ground: Ground) -> None:
        self._engine = engine
        self._free = [
            body for body, b in zip(engine.walls, ground.blocks, strict=True) if b.mass_kg > 0.0
        ]
        self._poses, self._felt = array("d"), array("d")
        height_m = ground.hand_height_m
        self._hand = None if height_m is None else _Hand(engine, height_m)
        links = [*engine.wheels, *(f.link for f in engine.feet if f.link not in engine.wheels)]
        self._column = {link: column for column, link in enumerate(links[:4])}

    def hand_and_blocks(self) -> None:
        if self._hand is not None:
            self._hand.hold()
        for body in self._free:
            position, quaternion = pybullet.getBasePositionAndOrientation(body, self._engine.client)
            self._poses.extend((*position, *quaternion))

    def all(self) -> None:
        self.hand_and_blocks()
        engine, loads = self._engine, [0.0] * 5
        points = pybullet.getContactPoints(bodyA=engine.body, physicsClientId=engine.client)
        for point in points:
            loads[self._column.get(point[3], 4)] += point[NORMAL_FORCE]
        left, right = pybullet.getJointStates(engine.body, engine.wheels, engine.client)
        self._felt.extend((*loads, left[3], right[3]))

    def felt(self, count: int) -> Forces:
        rows = np.array(self._felt).reshape(-1, 7)[:count]
        return Forces(rows[:, :2], rows[:, 2:4], rows[:, 4], rows[:, 5:])

    def trajectories(self, stamps_ns: IntArray) -> tuple[Trajectory, ...]:
        poses = iter(np.array(self._poses).reshape(-1, max(len(self._free), 1), 7).swapaxes(0, 1))
        made = []
        for body in self._engine.walls:
            if body in self._free:
                rows, stamps = next(poses)[: len(stamps_ns)], stamps_ns
            else:
                pose = pybullet.getBasePositionAndOrientation(body, self._engine.client)
                rows, stamps = np.array([[*pose[0], *pose[1]]]), stamps_ns[:1]
            made.append(Trajectory(stamps, rows[:, :3], rows[:, 3:]))
        return tuple(made)


def read_encoders(
    drive: Drive, robot: RobotModel, ticks_per_revolution: int = FINEST_TICKS, every: int = 1
) -> EncoderStream:
    """What perfect counters on the wheels read at every so many physics steps.

    It carries the radius and track that the robot's driver believes in.
    """
    turns = drive.wheel_angles_rad[::every] / (2.0 * np.pi)
    ticks = np.floor(turns * ticks_per_revolution).astype(np.int64)
    stamps_ns = drive.stamps_ns[::every]
    return EncoderStream(
        stamps_ns, ticks, ticks_per_revolution, robot.wheel_radius_m, robot.track_m
    )
