"""One drive in memory, sensed as often as there are faults that only sensing can show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.logs.raw_memory import recording_from_readings, true_trajectory
from slamsim.logs.raw_writer import write_recording
from slamsim.progress import Progress, silent
from slamsim.recording import Recording
from slamsim.sensors.faults.apply import declared, faulty_sensors
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive_process import DriveProcess
from slamsim.sim.robot import build_robot
from slamsim.sim.route import plan_route
from slamsim.simulate import Simulation, log_header
from slamsim.types import Trajectory
from slamsim.world.build import build_world


def simulate_spoilt(
    config: RunConfig, faults: Sequence[Fault], log_folder: Path, progress: Progress = silent
) -> Simulation:
    """As ``simulate``, with faults in the recording; the whole drive is in memory for that."""
    driven = Driven(config, progress)
    write_recording(driven.recording(faults), log_folder, driven.truth())
    return driven.simulation


class Driven:
    """A drive in memory: its motion, and what was sensed of it without a fault.

    A clean recording and its faulty twin share world, motion and every random number, and differ
    by the fault alone.
    """

    def __init__(self, config: RunConfig, progress: Progress = silent) -> None:
        """Raises SlamsimError for a world, robot or route that cannot be."""
        self._config = config
        with DriveProcess() as process:
            world, robot = build_world(config.world, config.seed), build_robot(config.robot)
            route = plan_route(world, robot, config.drive)
            self._windows = list(process.drive(world, robot, route, config.drive, progress))
            self.simulation = Simulation(world, robot, process.outcome)
        self._clean: Recording | None = None

    def recording(self, faults: Sequence[Fault] = ()) -> Recording:
        """The recording with these faults. Raises CannotInject where there is nothing to spoil."""
        sensed = [fault for fault in faults if isinstance(fault, SensedFault)]
        if sensed:
            recording = self._sensed(sensed)
        elif self._clean is None:
            recording = self._clean = self._sensed(())
        else:
            recording = self._clean
        return declared(recording, faults, self._config.sensors, self._config.seed)

    def truth(self) -> Trajectory:
        """``T_map_base`` as a file would hold it."""
        return true_trajectory(self._windows, log_header(self.simulation.robot, self._config))

    def _sensed(self, faults: Sequence[Fault]) -> Recording:
        config, robot = self._config, self.simulation.robot
        sensors, course = faulty_sensors(faults, config.sensors)
        rig = SensorRig(self.simulation.world.mesh, robot, sensors, config.seed, course=course)
        readings = [rig.sense(window) for window in self._windows]
        header = log_header(robot, config)
        return recording_from_readings(config.world.name, readings, self._windows, header)
