"""The loop of a live robot: window after window of physics and sensing, in step with the clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from slamsim.config.run import RunConfig
from slamsim.core.types import FloatArray
from slamsim.live.controls import Calls, LiveOptions, Mode, Status
from slamsim.live.delivery import Delivery, Pace
from slamsim.live.drivers import ManualDriver
from slamsim.live.hub import Hub
from slamsim.live.live_map import LiveMap
from slamsim.live.mapping import Begin, MappingProcess
from slamsim.live.published import SLAM_TOPICS
from slamsim.live.recording import DriveRecording
from slamsim.live.robot import LiveRobot, Window
from slamsim.live.steering import Steering
from slamsim.sim.drive.pilot import STANDING
from slamsim.sim.drive.record import START_NS
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.simulation.header import LogHeader, log_header
from slamsim.simulation.log_writer import recorded_topics
from slamsim.world.build import build_world
from slamsim.world.model import World

READ = ("/scan", "/imu/data", "/encoder_ticks", "/odom")
"""The topics of a simulated robot that its SLAM reads, as it reads them of a recording."""
ROUTE_TICKS = 2
"""Control ticks in a window while the robot follows a route: nothing waits for the next window, and
two ticks cost little more than one. Driven by twists it is one, for these do wait."""
BELIEF_TICKS = 8
"""At most in a window while the robot drives by where SLAM believes it is, which is asked once a
window: a tenth of a second."""
UNPACED_TICKS = 32
"""In a window while nothing is waited for, 0.4 s: sixty seconds take 12 s of processor time by
windows of 8 ticks, 6.4 s by 16, 4.2 s by 32, 4.4 s by 80. Also the most that is made up at once."""
MOST_BEHIND = 40
"""Unpaced, the simulation waits for SLAM when it is so many scans behind."""
WARM_S = 0.5
"""Simulated before the clock begins, so that kernels are loaded and all sensors have measured."""
_PAUSED_S = 0.02
"""How often a paused loop looks for requests."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveSetup:
    """What a live robot begins with. folder: for recordings and maps."""

    config: RunConfig
    world: World
    robot: RobotModel
    header: LogHeader
    folder: Path
    options: LiveOptions

    @classmethod
    def built(cls, config: RunConfig, folder: Path, options: LiveOptions) -> Self:
        """With the world and the robot of a configuration."""
        world, robot = build_world(config.world, config.seed), build_robot(config.robot)
        return cls(config, world, robot, log_header(robot, config), folder, options)


class LiveLoop:
    """Lives in ``run``; what other threads ask of it is done between two windows.

    process: SLAM beside it, None without. hub: of all that it publishes.
    """

    def __init__(self, setup: LiveSetup, process: MappingProcess | None = None) -> None:
        self.setup, self.known = setup, LiveMap(process)
        self.hub = Hub([*recorded_topics(setup.header), *SLAM_TOPICS])
        self.steering = Steering(setup.config, setup.world, setup.robot, self.known)
        self.pace = Pace(setup.options.rate, START_NS)
        self._delivery = Delivery(self.hub, self.pace)
        self._tick_ns = 1e9 / setup.config.drive.follow.control_rate_hz
        self.calls, self._stopping = Calls(), False
        """What other threads ask for."""
        self._step_ticks = 0
        self._robot: LiveRobot | None = None
        self._recording: DriveRecording | None = None
        self.begun_ns = START_NS
        """True time at which the drive began."""
        self.recordings: list[Path] = []
        """Folders of the recordings, the last perhaps not whole yet."""
        self.true_pose: FloatArray = setup.world.start_pose
        """(3,) T_map_base at the end of the last window."""
        self.status = self._described()
        """As of the last window."""

    def run(self) -> None:
        """Until ``stop``, or the end that the setup asks for. A recording is whole then.

        Raises SlamsimError where the robot, SLAM or the disk fails.
        """
        try:
            self._warm_up()
            self._begin(self.setup.options.mode, self.setup.options.record)
            while not self._stopping:
                self._turn()
            self.end_recording()
        finally:
            self._close()

    def stop(self) -> None:
        """End ``run`` after the window at hand; from any thread."""
        self._stopping = True
        self.calls.wake.set()

    # What may be asked for

    def reset(self) -> None:
        """Begin anew; a recording is ended and another one begun."""
        was_recording = self._recording is not None
        self.end_recording()
        self._end_robot()
        self._delivery.clear()
        self._begin(self.steering.mode, was_recording)

    def set_pace(self, rate: float | None, paused: bool) -> None:
        """From now on."""
        self._step_ticks = 0
        self.pace.set(self._now_ns, rate=rate, paused=paused)

    def step(self, seconds: float) -> None:
        """Pause, but for so much simulated time."""
        self.pace.set(self._now_ns, rate=self.pace.rate, paused=True)
        self._step_ticks += max(round(seconds * 1e9 / self._tick_ns), 1)

    def begin_recording(self) -> Path:
        """The folder that is being written."""
        if self._recording is None:
            setup = self.setup
            assert self._robot is not None
            folder = setup.folder / f"drive_{len(self.recordings) + 1}"
            setup.folder.mkdir(parents=True, exist_ok=True)
            self._recording = DriveRecording(
                folder, self._robot, setup.config, setup.world, setup.header
            )
            self.recordings.append(folder)
        return self._recording.folder

    def end_recording(self) -> Path | None:
        """The folder that is whole now, None if there was none."""
        recording, self._recording = self._recording, None
        return None if recording is None else recording.finish()

    # The loop

    def _begin(self, mode: Mode, record: bool) -> None:
        self.known.begin(self._map_begin())
        self.known.await_ready()
        self._robot = self._new_robot()
        self.true_pose = self.setup.world.start_pose
        self.steering.begin(mode)
        if record:
            self.begin_recording()
        self.set_pace(self.pace.rate, self.pace.paused)

    def _new_robot(self) -> LiveRobot:
        setup = self.setup
        return LiveRobot(setup.config, setup.world, setup.robot, setup.header)

    def _map_begin(self) -> Begin:
        config, robot = self.setup.config, self.setup.robot
        imu = robot.T_base_imu if config.sensors.imu.enabled else None
        start = self.setup.world.start_pose
        return Begin(config.slam, config.mapping, robot.T_base_laser, imu, start=start)

    def _warm_up(self) -> None:
        """Drive for a moment before time begins, for what compiles or loads at its first use."""
        robot = self._new_robot()
        try:
            ticks = math.ceil(WARM_S * 1e9 / self._tick_ns)
            for stream in robot.advance(ticks, ManualDriver()).messages:
                stream.rows(slice(None))
        finally:
            robot.close()

    def _turn(self) -> None:
        """Wait until the next window is due, and compute it."""
        self.calls.heed()
        if self.pace.paused and not self._step_ticks:
            self.calls.wake.wait(_PAUSED_S)
            self.calls.wake.clear()
            self.known.heed(self._now_ns, self._delivery.post)
            self._delivery.up_to(self._now_ns)
            self.status = self._described()
            return
        if not self._step_ticks and self.pace.rate is not None:
            self._delivery.wait(self.pace.due_s(self._now_ns))
        robot = self._robot
        assert robot is not None
        ticks = self._window_ticks()
        window = robot.advance(ticks, self.steering.driver)
        self._step_ticks = max(self._step_ticks - ticks, 0)
        self._hand_on(window)
        self.steering.update(bool(window.drive.wall_contact.any()))
        self.status = self._described()
        self.known.diagnose(self.status, self._values(), self._delivery.post)
        is_done = self.setup.options.until_done and bool(self.steering.ended or robot.ended)
        self._stopping |= is_done or robot.time_s >= self.setup.options.duration_s

    def _window_ticks(self) -> int:
        """Long windows cost less for each tick, so a loop that is late by whole ticks takes them
        into one."""
        steering, rate = self.steering, self.pace.rate
        most = BELIEF_TICKS if steering.is_driven_by_belief else UNPACED_TICKS
        if self._step_ticks:
            return min(self._step_ticks, most)
        if rate is None:
            return most
        usual = max(round(rate), 1)
        if not steering.is_driven_by_twists:
            usual = max(usual, min(ROUTE_TICKS * usual, most))
        late = int(self.pace.behind_s * rate * 1e9 / self._tick_ns)
        return max(usual, min(usual + late, most))

    def _hand_on(self, window: Window) -> None:
        """To SLAM, the recording and the clients."""
        if len(window.drive):
            self.true_pose = window.drive.trajectory().planar().poses[-1]
        self.known.take([s for s in window.part.recording.streams if s.topic in READ])
        if self._recording is not None:
            self._recording.write(window)
        self._delivery.add(window)
        self.known.heed(window.end_ns, self._delivery.post)
        self.pace.computed(window.end_ns)
        if self.pace.paused or self.pace.rate is None:
            self._delivery.up_to(window.end_ns)
        while self.pace.rate is None and self.known.behind > MOST_BEHIND:
            self.known.wait()
            self.known.heed(window.end_ns, self._delivery.post)

    def _close(self) -> None:
        """End everything; a recording that was not ended is left out."""
        self.steering.close()
        if self._recording is not None:
            self._recording.discard()
        self._end_robot()
        self.calls.close()

    def _end_robot(self) -> None:
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()

    def _values(self) -> dict[str, str]:
        """What is diagnosed of the simulation."""
        status = self.status
        return {
            "real-time factor": f"{status.realtime_factor:.3f}",
            "late windows": f"{status.late_windows} of {status.windows}",
            "driven by": status.mode,
            "goal": status.goal,
        }

    @property
    def _now_ns(self) -> int:
        """Where the next window begins."""
        ticks = 0 if self._robot is None else self._robot.ticks
        return START_NS + round(ticks * self._tick_ns)

    def _described(self) -> Status:
        pace, steering, known, robot = self.pace, self.steering, self.known, self._robot
        command, ended = (STANDING, "") if robot is None else (robot.command, robot.ended)
        keyframes, closures = known.counts
        # A robot that tipped over asks its driver no more.
        goal = "not reached" if ended and steering.goal == "driving" else steering.goal
        return Status(
            stamp_ns=self._now_ns,
            rate=pace.rate,
            realtime_factor=pace.realtime_factor,
            paused=pace.paused,
            mode=steering.mode,
            windows=pace.windows,
            late_windows=pace.late,
            speed_m_s=command[0],
            yaw_rate_rad_s=command[1],
            recording=None if self._recording is None else self._recording.folder,
            tracking=known.tracking,
            keyframes=keyframes,
            closures=closures,
            ended=steering.ended or ended,
            goal=goal,
        )
