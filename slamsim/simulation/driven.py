"""Keeps one drive in memory and senses it again for each fault that needs it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.config.run import RunConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive, Trajectory
from slamsim.guard.errors import SlamsimError
from slamsim.io.cameras.survey import with_cameras
from slamsim.io.copy.rewrite import rewrite_recording
from slamsim.recording import Recording
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import declared, faulty_sensors
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import LogHeader, log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.recorder import DriveRecorder, true_trajectory
from slamsim.simulation.simulate import Simulation, appearance_of
from slamsim.world.build import build_world


def simulate_with_faults(
    config: RunConfig, faults: Sequence[Fault], log_folder: Path, progress: Progress = silent
) -> Simulation:
    """As ``simulate``, with faults in the recording; the whole drive is in memory for that, but for
    images.

    Raises SlamsimError where there are sinks: what they would get has no faults yet.
    """
    if config.sinks:
        raise SlamsimError("sinks cannot be used with faults, which are injected after the drive")
    driven = Driven(config, progress)
    driven.write(faults, log_folder)
    return driven.simulation


@dataclass(frozen=True, slots=True)
class PlainLog:
    """The recording of a drive before faults are in it: all that ``simulate`` would write.

    path: of the log. readings, windows: of the drive, without what additional sensors measured,
    which alone the log holds: images of minutes are no matter of memory.
    """

    path: Path
    readings: Sequence[Readings]
    windows: Sequence[Drive]

    def with_images(self, sensed: Recording, faults: Sequence[Fault]) -> Recording:
        """The recording made of the readings, with a look at its images where a fault is of
        them."""
        of_cameras = any(isinstance(fault, CameraFault) for fault in faults)
        return with_cameras(sensed, self.path) if of_cameras else sensed


@contextmanager
def plain_log(
    folder: Path | None, moments: Iterable[tuple[Readings, Drive]], header: LogHeader
) -> Iterator[PlainLog]:
    """Written beside a folder, moment by moment, and gone in the end; in the system's folder for
    temporary files where there is none. ``rewrite_recording`` makes of it the one with faults."""
    where = None if folder is None else folder.parent
    with TemporaryDirectory(dir=where, prefix=".sensed.") as beside:
        path, kept, windows = Path(beside) / "log", list[Readings](), list[Drive]()
        with LogWriter(path, header) as log:
            for readings, window in moments:
                log.write(readings, window)
                kept.append(replace(readings, additional=()))
                windows.append(window)
        yield PlainLog(path, kept, windows)


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
            recording = self._recorded(list(self._sensed(faults)))
        elif self._clean is None:
            recording = self._clean = self._recorded(list(self._sensed(())))
        else:
            recording = self._clean
        return declared(recording, faults, self._config.sensors, self._config.seed)

    def write(self, faults: Sequence[Fault], folder: Path) -> None:
        """The same, written into a new folder with all that ``simulate`` writes."""
        moments = zip(self._sensed(faults), self._windows, strict=True)
        with plain_log(folder, moments, self._header) as log:
            sensed = log.with_images(self._recorded(log.readings), faults)
            corrupted = declared(sensed, faults, self._config.sensors, self._config.seed)
            rewrite_recording(log.path, sensed, corrupted, folder)

    def truth(self) -> Trajectory:
        """``T_map_base`` as a file would hold it."""
        return true_trajectory(self._windows, self._header)

    def _sensed(self, faults: Sequence[Fault]) -> Iterator[Readings]:
        """What sensors with these faults measure, window by window."""
        config, simulation = self._config, self.simulation
        sensors, override = faulty_sensors(faults, config.sensors)
        mesh, robot = simulation.world.mesh, simulation.robot
        looks = appearance_of(simulation.world, config.world.looks)
        rig = SensorRig(mesh, robot, sensors, config.seed, override=override, appearance=looks)
        return map(rig.sense, self._windows)

    def _recorded(self, readings: Sequence[Readings]) -> Recording:
        name = self._config.world.name
        return DriveRecorder(name, self._header).take(readings, self._windows).recording
