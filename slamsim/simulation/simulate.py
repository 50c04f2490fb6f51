"""World, robot, drive, sensors, recording: a whole simulated log from one configuration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.core.progress import Progress, silent
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveOutcome
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.simulation.appearance import appearance_of, casting_threads, in_pieces
from slamsim.simulation.header import log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.world.build import build_world
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
