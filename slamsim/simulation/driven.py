"""Keeps one drive in memory and senses it again for each fault that needs it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.config.run import RunConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive, Trajectory
from slamsim.guard.errors import SlamsimError
from slamsim.io.copy.rewrite import rewrite_recording
from slamsim.recording import Recording
from slamsim.sensors.faults.apply import declared, faulty_sensors
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.appearance import appearance_of
from slamsim.simulation.header import LogHeader, log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.recorder import DriveRecorder, true_trajectory
from slamsim.simulation.simulate import Simulation
from slamsim.world.build import build_world


def simulate_with_faults(
    config: RunConfig, faults: Sequence[Fault], log_folder: Path, progress: Progress = silent
) -> Simulation:
    """As ``simulate``, with faults in the recording; the whole drive is in memory for that.

    Raises SlamsimError where there are sinks: what they would get has no faults yet.
    """
    if config.sinks:
        raise SlamsimError("sinks cannot be used with faults, which are injected after the drive")
    driven = Driven(config, progress)
    driven.write(faults, log_folder)
    return driven.simulation


def write_corrupted(
    folder: Path,
    moments: Sequence[tuple[Readings, Drive]],
    header: LogHeader,
    sensed: Recording,
    corrupted: Recording,
) -> None:
    """Write the recording of a drive with faults into a new folder.

    It is the recording that ``simulate`` would write of these moments, with what differs between
    ``sensed``, made of them, and ``corrupted``: truth, commands and covariances are all there.
    """
    with TemporaryDirectory(dir=folder.parent, prefix=".sensed.") as beside:
        plain = Path(beside) / "log"
        with LogWriter(plain, header) as log:
            for readings, window in moments:
                log.write(readings, window)
        rewrite_recording(plain, sensed, corrupted, folder)


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
        self._header = log_header(robot, config)
        self._clean: Recording | None = None

    def recording(self, faults: Sequence[Fault] = ()) -> Recording:
        """The recording with these faults. Raises CannotEdit where there is nothing to change."""
        if any(isinstance(fault, SensedFault) for fault in faults):
            recording = self._recorded(self._sensed(faults))
        elif self._clean is None:
            recording = self._clean = self._recorded(self._sensed(()))
        else:
            recording = self._clean
        return declared(recording, faults, self._config.sensors, self._config.seed)

    def write(self, faults: Sequence[Fault], folder: Path) -> None:
        """The same, written into a new folder with all that ``simulate`` writes."""
        readings = self._sensed(faults)
        sensed = self._recorded(readings)
        corrupted = declared(sensed, faults, self._config.sensors, self._config.seed)
        moments = list(zip(readings, self._windows, strict=True))
        write_corrupted(folder, moments, self._header, sensed, corrupted)

    def truth(self) -> Trajectory:
        """``T_map_base`` as a file would hold it."""
        return true_trajectory(self._windows, self._header)

    def _sensed(self, faults: Sequence[Fault]) -> list[Readings]:
        """What sensors with these faults measure, window by window."""
        config, simulation = self._config, self.simulation
        sensors, override = faulty_sensors(faults, config.sensors)
        mesh, robot = simulation.world.mesh, simulation.robot
        looks = appearance_of(simulation.world, config.world.looks)
        rig = SensorRig(mesh, robot, sensors, config.seed, override=override, appearance=looks)
        return [rig.sense(window) for window in self._windows]

    def _recorded(self, readings: Sequence[Readings]) -> Recording:
        name = self._config.world.name
        return DriveRecorder(name, self._header).take(readings, self._windows).recording
