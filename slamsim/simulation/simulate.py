"""World, robot, drive, sensors, recording: a whole simulated log from one configuration; what
cameras need of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np

from slamsim.cameras.appearance import Appearance
from slamsim.config.layout import LooksConfig
from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveOutcome
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.simulation.header import log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.world.build import build_world
from slamsim.world.looks.build import build_looks
from slamsim.world.model import World


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """What a simulated log came from."""

    world: World
    robot: RobotModel
    outcome: DriveOutcome


def simulate(config: RunConfig, log_folder: Path, progress: Progress = silent) -> Simulation:
    """Drive through the configured world and record what the sensors measure, window by window.

    log_folder: becomes a rosbag2 folder; the caller discards it if this raises. progress counts
    simulated seconds. Raises SlamsimError for a world, robot or route that cannot be; a drive
    that ends early is told in ``outcome``, and what was driven is recorded.
    """
    with DriveProcess() as process:
        world = build_world(config.world, config.seed)
        robot = build_robot(config.robot)
        route = plan_route(world, robot, config.drive)
        windows = process.drive(world, robot, route, config.drive, progress)
        appearance = appearance_of(world, config.world.looks)
        threads = casting_threads(config.sensors)
        rig = SensorRig(
            world.mesh, robot, config.sensors, config.seed, threads, appearance=appearance
        )
        with LogWriter(log_folder, log_header(robot, config), sinks=config.sinks) as log:
            for window in windows:
                for piece in in_pieces(window, config.sensors):
                    log.write(rig.sense(piece), piece)
        return Simulation(world, robot, process.outcome)


_PIECE_STEPS = 120
"""Half a second of the default physics: of images of the truth no more are held in memory."""


def appearance_of(world: World, config: LooksConfig) -> Callable[[], Appearance]:
    """What gives the looks of a world, which are made when the first camera asks."""

    @cache
    def made() -> Appearance:
        return build_looks(world, config)

    return made


def casting_threads(sensors: SensorsConfig) -> int:
    """All cores where there are cameras, whose rays are many; what is sensed is the same."""
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    return (os.cpu_count() or 1) if has_cameras else 1


def in_pieces(window: Drive, sensors: SensorsConfig) -> Iterator[Drive]:
    """A window as it is, or in short pieces where there are cameras, whose images fill memory.

    What is sensed does not depend on it.
    """
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    if not has_cameras or len(window) <= 2 * _PIECE_STEPS:
        yield window
        return
    starts = np.arange(0, len(window) - _PIECE_STEPS, _PIECE_STEPS)
    for start, end in zip(starts, [*starts[1:], len(window)], strict=True):
        yield Drive(**{f.name: getattr(window, f.name)[start:end] for f in fields(Drive)})
