"""``slamsim replay``: drives the commands of a live recording again, as it was configured."""

from __future__ import annotations

from pathlib import Path

from slamsim.config.loading import load_simulated_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import NotFound
from slamsim.guard.files import own_file
from slamsim.live.drivers import PlayedDriver
from slamsim.live.loop import UNPACED_TICKS
from slamsim.live.recording import COMMANDS, DRIVE, DriveRecording, read_drive
from slamsim.live.robot import LiveRobot
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header
from slamsim.simulation.own_files import CONFIG
from slamsim.world.build import build_world


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
