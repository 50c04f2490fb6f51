"""One drive of a simulated robot: physics, sensors and the streams of its recording."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Protocol

from slamsim.config.run import RunConfig
from slamsim.core.types import Drive
from slamsim.io.ros.encoding import Outgoing, outgoing, stream_messages
from slamsim.recording import RawStream, Recording
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.drive_loop import BasePose, DriveLoop
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.pilot import STANDING, limited, upset
from slamsim.sim.engine import running_engine
from slamsim.sim.ground import Floor
from slamsim.sim.robot.model import RobotModel
from slamsim.simulation.header import LogHeader
from slamsim.simulation.log_writer import said_once_left_out
from slamsim.simulation.recorder import DriveRecorder, Part
from slamsim.simulation.simulate import appearance_of
from slamsim.world.model import World


class Driver(Protocol):
    """Decides where the robot drives. ended: why it has nothing more to do, empty before."""

    @property
    def ended(self) -> str: ...

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """The twist for the next control tick, before the limits of acceleration and speed.

        time_s: since the drive began. pose: the true one, which a driver may well not look at.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """What one window of the drive brought. messages: to be published as they arrive; part: the
    same as streams, of which ``part.recording`` is what SLAM may see."""

    drive: Drive
    readings: Readings
    part: Part
    messages: Sequence[Outgoing]

    @property
    def end_ns(self) -> int:
        return int(self.drive.stamps_ns[-1])


class LiveRobot:
    """From its start pose on, until it is closed.

    Its windows are those of a ``simulate`` whose pilot commands the same twists: the same bytes,
    however long each window is.
    """

    def __init__(
        self, config: RunConfig, world: World, robot: RobotModel, header: LogHeader
    ) -> None:
        physics, follow = config.drive.physics, config.drive.follow
        self._config, self.tick_s = config, 1.0 / follow.control_rate_hz
        self._open = ExitStack()
        engine = self._open.enter_context(running_engine(world, robot, physics))
        steps_per_tick = physics.rate_hz // follow.control_rate_hz
        self._loop = DriveLoop(engine, robot, physics.rate_hz, steps_per_tick)
        self._floor = Floor(engine, world.floor_friction, world.floor_patches)
        looks = appearance_of(world, config.world.looks)
        self._rig = SensorRig(world.mesh, robot, config.sensors, config.seed, appearance=looks)
        self._recorder = DriveRecorder(world.name, header)
        self._first: Recording | None = None
        self.ticks = 0
        """Control ticks since the drive began."""
        self.command: Twist = STANDING
        self.commands: list[tuple[int, Twist]] = []
        """Each change of the command: (control tick from which on, twist)."""
        self.ended = ""
        """Why the robot cannot drive on: it tipped over, or left the floor."""

    def close(self) -> None:
        """End the physics."""
        self._open.close()

    @property
    def time_s(self) -> float:
        """Since the drive began."""
        return self.ticks * self.tick_s

    def advance(self, ticks: int, driver: Driver) -> Window:
        """Drive on for so many control ticks, or until the driver has nothing more to do."""

        def decide(pose: BasePose) -> Twist:
            self._command(driver, pose)
            self._floor.update(pose.x_m, pose.y_m, pose.yaw_rad)
            return self.command

        for _ in range(ticks):
            self._loop.control_tick(decide)
            self.ticks += 1
            if driver.ended:
                break
        return self._sensed(self._loop.take_window())

    def said_once(self) -> list[Outgoing]:
        """The messages that were only said at the beginning, for who comes later."""
        assert self._first is not None, "nothing was said yet"
        fixed = tuple(edge for edge in self._first.transforms if edge.is_static)
        return outgoing(replace(self._first, streams=(), transforms=fixed, clock_ns=None))

    def rest(self) -> tuple[RawStream, ...]:
        """What is recorded because the drive is over."""
        return self._recorder.rest()

    def _command(self, driver: Driver, pose: BasePose) -> None:
        follow, limits = self._config.drive.follow, self._config.drive.limits
        self.ended = upset(follow, pose.x_m, pose.y_m, pose.z_m, pose.up)
        wanted = STANDING if self.ended else driver.wanted(self.time_s, pose)
        command = limited(self.command, wanted, limits, self.tick_s)
        if command != self.command or not self.commands:
            self.commands.append((self.ticks, command))
        self.command = command

    def _sensed(self, drive: Drive) -> Window:
        readings = self._rig.sense(drive)
        part = self._recorder.take([readings], [drive])
        said = part.recording
        if self._first is None:
            self._first = part.recording
        else:
            said = said_once_left_out(said)
        messages = [
            *outgoing(said, self._recorder.constants),
            *map(stream_messages, part.beside),
        ]
        return Window(drive, readings, part, messages)
