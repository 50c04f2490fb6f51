"""From the specification of a sequence to its folder: one process, one core, flat memory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, Self

from slamsim.config.run import RunConfig
from slamsim.dataset.sequence import FileFact, SequenceFacts, SequenceSpec
from slamsim.dataset.truth_surfaces import Surfaces, surfaces_of
from slamsim.dataset.truth_tables import TruthTables
from slamsim.logs.parquet_log import ParquetLog
from slamsim.logs.raw_memory import recording_from_readings, true_trajectory
from slamsim.logs.raw_writer import write_recording
from slamsim.logs.recorded import OdometryTail
from slamsim.logs.writer import LogWriter
from slamsim.recording import Recording
from slamsim.run.folder import LOG, write_config, write_world
from slamsim.sensors.faults.apply import declared, faulty_sensors
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import chosen_fault
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive import DriveRun, drive
from slamsim.sim.robot import RobotModel, build_robot
from slamsim.sim.route import plan_route
from slamsim.simulate import log_header
from slamsim.types import Drive
from slamsim.world.build import build_world
from slamsim.world.model import World

PARQUET, TRUTH = "parquet", "truth"

Moments = Iterator[tuple[Readings, Drive]]
"""What was sensed during each window of a drive, and the window."""


class SensedTaker(Protocol):
    """Takes what was sensed, window by window: a log, the truth."""

    def write(self, readings: Readings, window: Drive) -> None: ...


class RecordedTaker(Protocol):
    """Takes a recording part by part, or as a whole: the tables of one format."""

    def write(self, part: Recording) -> None: ...


def produce(spec: SequenceSpec, folder: Path) -> SequenceFacts:
    """Drive, sense and write one sequence into a folder that is new or empty.

    The caller discards the folder after an exception, and gives it its name when it is whole.
    Everything but ``sequence.json`` is written: log, tables, truth, configuration. The same bytes
    come of the same specification in any process. Raises SlamsimError for a world, robot or route
    that cannot be, and CannotInject for a fault that finds nothing to spoil.
    """
    ride = _Ride.planned(spec.config)
    write_config(folder, spec.config)
    write_world(folder, spec.config, ride.world)
    with TruthTables(folder / TRUTH, ride.surfaces(), ride.wheels()) as truth:
        if ride.faults:
            _write_spoilt(spec, ride, folder, truth)
        else:
            _write_clean(spec, ride, folder, truth)
    outcome = ride.run.outcome
    quality = {"duration_s": outcome.duration_s, "path_length_m": outcome.path_length_m}
    return SequenceFacts(quality, tuple(files_of(folder)))


@dataclass(frozen=True, slots=True, eq=False)
class _Ride:
    """All that is known before the robot starts."""

    config: RunConfig
    faults: tuple[Fault, ...]
    world: World
    robot: RobotModel
    run: DriveRun

    @classmethod
    def planned(cls, config: RunConfig) -> Self:
        faults = tuple(map(chosen_fault, config.faults))
        world, robot = build_world(config.world, config.seed), build_robot(config.robot)
        route = plan_route(world, robot, config.drive)
        return cls(config, faults, world, robot, drive(world, robot, route, config.drive))

    def surfaces(self) -> Surfaces:
        """What the lidar may meet."""
        return surfaces_of(self.world.mesh, self.config.sensors.lidar.range_max_m)

    def wheels(self) -> tuple[float, float]:
        """True radius and track, m."""
        return self.robot.wheel_radius_m, self.robot.track_m

    def moments(self) -> Moments:
        """The drive, sensed with its truth as it goes."""
        sensors, course = faulty_sensors(self.faults, self.config.sensors)
        rig = SensorRig(
            self.world.mesh,
            self.robot,
            sensors,
            self.config.seed,
            course=course,
            with_truth=True,
        )
        for window in self.run:
            yield rig.sense(window), window


def _write_clean(spec: SequenceSpec, ride: _Ride, folder: Path, truth: TruthTables) -> None:
    """Window by window: nothing is kept longer than it must."""
    header, odometry = log_header(ride.robot, spec.config), OdometryTail()
    with ExitStack() as stack:
        sensed: list[SensedTaker] = [truth]
        if "mcap" in spec.formats:
            sensed.append(stack.enter_context(LogWriter(folder / LOG, header)))
        recorded = _recorded_takers(spec, folder, stack)
        for readings, window in ride.moments():
            for taker in sensed:
                taker.write(readings, window)
            part = recording_from_readings(spec.name, [readings], [window], header, odometry)
            for table in recorded:
                table.write(part)


def _write_spoilt(spec: SequenceSpec, ride: _Ride, folder: Path, truth: TruthTables) -> None:
    """Faults look at the whole recording, so it is in memory."""
    config, header = spec.config, log_header(ride.robot, spec.config)
    windows, readings = list[Drive](), list[Readings]()
    for sensed, window in ride.moments():
        truth.write(sensed, window)
        readings.append(replace(sensed, scans=replace(sensed.scans, truth=None)))
        windows.append(window)
    clean = recording_from_readings(spec.name, readings, windows, header)
    recording = declared(clean, ride.faults, config.sensors, config.seed)
    if "mcap" in spec.formats:
        write_recording(recording, folder / LOG, true_trajectory(windows, header))
    with ExitStack() as stack:
        for table in _recorded_takers(spec, folder, stack):
            table.write(recording)


def _recorded_takers(spec: SequenceSpec, folder: Path, stack: ExitStack) -> Sequence[RecordedTaker]:
    takers: list[RecordedTaker] = []
    if "parquet" in spec.formats:
        takers.append(stack.enter_context(ParquetLog(folder / PARQUET)))
    return takers


def files_of(folder: Path) -> Iterator[FileFact]:
    """Every file of a sequence, sorted by path; hidden ones are not part of it."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if not path.name.startswith("."):
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            yield FileFact(path.relative_to(folder).as_posix(), path.stat().st_size, digest)
