"""``slamsim live``: a robot in real time, its servers, and what is left of it at the end; ``slamsim
replay``: drives the commands of a live recording again, as it was configured."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from slamsim.config.loading import load_simulated_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.progress import Progress
from slamsim.core.types import PlanarTrajectory
from slamsim.guard.errors import NotFound, SlamsimError
from slamsim.guard.files import own_file
from slamsim.live.controls import LiveOptions
from slamsim.live.drivers import PlayedDriver
from slamsim.live.loop import UNPACED_TICKS, LiveLoop, LiveSetup
from slamsim.live.loop_controls import LoopControls
from slamsim.live.mapping import Finished, MappingProcess
from slamsim.live.recording import COMMANDS, DRIVE, DriveRecording, read_drive
from slamsim.live.robot import LiveRobot
from slamsim.run.live.serving import Ports, run_until_signal, servers, write_map
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header
from slamsim.simulation.own_files import CONFIG
from slamsim.world.build import build_world

CONTROL_HZ = 80
"""Commands take effect with the next control tick, so that at 80 Hz a twist reaches the wheels
within 12.5 ms."""


def live_config(config: RunConfig) -> RunConfig:
    """With control ticks short enough for a person. Raises SlamsimError for what live cannot do."""
    if config.faults:
        raise SlamsimError(
            "live injects no faults: record the drive, then inject them with slamsim fault"
        )
    physics_hz, follow = config.drive.physics.rate_hz, config.drive.follow
    divisors = [hz for hz in range(1, CONTROL_HZ + 1) if physics_hz % hz == 0]
    fast = follow.model_copy(update={"control_rate_hz": max(*divisors, follow.control_rate_hz)})
    return config.model_copy(update={"drive": config.drive.model_copy(update={"follow": fast})})


def live_world(
    config: RunConfig, folder: Path, options: LiveOptions, ports: Ports, reporter: Reporter
) -> dict[str, object]:
    """Until the drive is over or a signal comes; numbers of it.

    Recordings and maps are folders of their own below ``folder``, each whole as soon as it is
    there. Raises SlamsimError where the robot, SLAM, a server or the disk fails.
    """
    config = live_config(config)
    with ExitStack() as opened:
        process = opened.enter_context(MappingProcess()) if options.slam else None
        loop = LiveLoop(LiveSetup.built(config, folder, options), process)
        for server in servers(loop.hub, LoopControls(loop), ports):
            opened.enter_context(server)
            reporter.note(server.address)
        with reporter.stage("live", "× real time") as progress:
            told = _Told(loop, reporter, progress)
            stopped = run_until_signal(loop, told.tell)
        finished = None
        if process is not None and not stopped and loop.status.keyframes:
            reporter.note("Solving the whole map")
            finished = process.finish()
            write_map(folder / "map", finished)
    return _numbers(loop, finished)


class _Told:
    """What a person at the terminal is told while the robot lives."""

    def __init__(self, loop: LiveLoop, reporter: Reporter, progress: Progress) -> None:
        self._loop, self._reporter, self._progress = loop, reporter, progress
        self._ended, self._slipped_s = "", 0.0

    def _lived(self) -> tuple[float, float]:
        """Simulated seconds, and of how many."""
        lived_s = (self._loop.status.stamp_ns - self._loop.begun_ns) * 1e-9
        return lived_s, self._loop.setup.options.duration_s

    def tell(self) -> None:
        """What is new."""
        loop, reporter = self._loop, self._reporter
        self._progress(*self._lived())
        while loop.known.events:
            reporter.warn(loop.known.events.popleft())
        if loop.status.ended != self._ended:
            self._ended = loop.status.ended
            if self._ended:
                reporter.note(self._ended[:1].upper() + self._ended[1:])
        if loop.pace.slipped_s > self._slipped_s + 1.0:
            lost_s = loop.pace.slipped_s - self._slipped_s
            self._slipped_s = loop.pace.slipped_s
            reporter.warn(
                f"the simulation fell {lost_s:.1f} s behind real time and goes on from there; "
                "a lower --rate, fewer beams or --no-slam would keep up"
            )


def _numbers(loop: LiveLoop, finished: Finished | None) -> dict[str, object]:
    status, setup = loop.status, loop.setup
    trajectory: PlanarTrajectory | None = None if finished is None else finished.trajectory
    return {
        "name": setup.config.world.name,
        "duration_s": (status.stamp_ns - loop.begun_ns) * 1e-9,
        "windows": status.windows,
        "late_windows": status.late_windows,
        "ended": status.ended,
        "keyframes": status.keyframes if finished is None else finished.keyframes,
        "closures": status.closures if finished is None else finished.closures,
        "scans_mapped": None if trajectory is None else len(trajectory),
        "recordings": [str(folder) for folder in loop.recordings],
    }


def replay_drive(
    source: Path, folder: Path, reporter: Reporter, *, overwrite: bool = False
) -> dict[str, object]:
    """Into another folder; numbers of the drive.

    source: a folder that a live robot recorded. With this version's physics on this machine the
    folder is the same, byte for byte. Raises SlamsimError for what is none or cannot be driven.
    """
    config = _config(source)
    drive = read_drive(source)
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    header = log_header(robot, config)
    live = LiveRobot(config, world, robot, header)
    driver = PlayedDriver(drive.commands, drive.end_tick)
    recording = None
    try:
        with reporter.stage("replay", "× real time") as progress:
            while not driver.ended and not live.ended:
                if recording is None and live.ticks == drive.first_tick:
                    recording = DriveRecording(folder, live, config, world, header, overwrite)
                end = drive.first_tick if recording is None else drive.end_tick
                window = live.advance(min(end - live.ticks, UNPACED_TICKS), driver)
                if recording is not None:
                    recording.write(window)
                progress(live.time_s, drive.end_tick * live.tick_s)
        duration_s = live.time_s
        if recording is not None:
            recording.finish()
            recording = None
    finally:
        if recording is not None:
            recording.discard()
        live.close()
    return {"name": config.world.name, "duration_s": duration_s, "ended": live.ended}


def _config(source: Path) -> RunConfig:
    for name in (CONFIG, DRIVE, COMMANDS):
        if not (source / name).is_file():
            raise NotFound(
                f"{source} has no {name}: replay takes a folder that slamsim live has recorded, "
                "such as outputs/labyrinth_live/drive_1"
            )
    return load_simulated_config(own_file(source, CONFIG))
