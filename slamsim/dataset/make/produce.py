"""Makes one sequence from its specification: one process, one core, constant memory."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from pathlib import Path
from typing import Self

import numpy as np

from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.config.world import WorldConfig
from slamsim.core.types import Drive, IntArray
from slamsim.dataset.make.formats import IMAGE_FOLDERS, Formats, write_image_folders
from slamsim.dataset.make.pictures import write_pictures
from slamsim.dataset.recipe.sequence import FileFact, SequenceFacts, SequenceSpec
from slamsim.dataset.truth.write import Truth
from slamsim.io import LOG
from slamsim.io.copy.rewrite import rewrite_recording
from slamsim.recording import RawStream, Recording
from slamsim.recording.edits.messages import with_sequence_numbers
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import chosen_fault, declared, faulty_sensors
from slamsim.sensors.motion import PoseOverride, joined
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.simulation.driven import plain_log
from slamsim.simulation.header import log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.own_files import write_config, write_world
from slamsim.simulation.recorder import DriveRecorder
from slamsim.simulation.simulate import appearance_of, in_pieces
from slamsim.world.build import build_world
from slamsim.world.model import World

TRUTH = "truth"
_PASSING = ".log"
"""A recording that is made only for the layouts of images that are made of it."""

Moments = Iterator[tuple[Readings, Drive]]
"""What was sensed during each window of a drive, and the window."""


def produce(spec: SequenceSpec, folder: Path) -> SequenceFacts:
    """Drive, sense and write one sequence into a folder that is new or empty.

    The caller discards the folder after an exception, and gives it its name when it is whole.
    Everything but ``sequence.json`` is written: log, tables, truth, configuration. The same bytes
    come of the same specification in any process. Raises SlamsimError for a world, robot or route
    that cannot be, and CannotEdit for a fault that finds nothing to change.
    """
    planned = _PlannedRun.planned(spec.config)
    write_config(folder, spec.config)
    write_world(folder, spec.config, planned.world)
    write = _write_with_faults if planned.faults else _write_clean
    log = folder / LOG if "mcap" in spec.formats else None
    if log is None and any(name in spec.formats for name in IMAGE_FOLDERS):
        log = folder / _PASSING
    with (
        Truth(folder / TRUTH, planned.world, planned.robot, spec, planned.override) as truth,
        Formats(spec, folder) as formats,
    ):
        write(spec, planned, log, truth, formats)
    if log is not None:
        write_image_folders(spec, log, folder)
        shutil.rmtree(folder / _PASSING, ignore_errors=True)
    write_pictures(folder, tuple(formats.images))
    outcome = planned.run.outcome
    quality = {"duration_s": outcome.duration_s, "finished": outcome.finished, **truth.quality()}
    quality |= {f"images.{name}": count for name, count in formats.images.items()}
    return SequenceFacts(quality, tuple(files_of(folder)))


@dataclass(frozen=True, slots=True, eq=False)
class _PlannedRun:
    """All that is known before the robot starts.

    sensors, override: what is sensed with and how the laser looks, as faults would have it.
    """

    config: RunConfig
    faults: tuple[Fault, ...]
    sensors: SensorsConfig
    override: PoseOverride
    world: World
    robot: RobotModel
    run: DriveRun

    @classmethod
    def planned(cls, config: RunConfig) -> Self:
        faults = tuple(map(chosen_fault, config.faults))
        sensors, override = faulty_sensors(faults, config.sensors)
        seed = config.seed if config.world.seed is None else config.world.seed
        world, robot = _built_world(config.world, seed), _built_robot(config.robot)
        route = plan_route(world, robot, config.drive)
        run = DriveRun(world, robot, route, config.drive)
        return cls(config, faults, sensors, override, world, robot, run)

    def moments(self) -> Moments:
        """The drive, sensed with its truth as it goes."""
        rig = SensorRig(
            self.world.mesh,
            self.robot,
            self.sensors,
            self.config.seed,
            override=self.override,
            with_truth=True,
            appearance=appearance_of(self.world, self.config.world.looks),
        )
        for window in self.run:
            for piece in in_pieces(window, self.sensors):
                yield rig.sense(piece), piece


@lru_cache(maxsize=1)
def _built_world(config: WorldConfig, seed: int) -> World:
    """Kept for the next sequence, which is often in the same world."""
    return build_world(config, seed)


@lru_cache(maxsize=4)
def _built_robot(config: RobotConfig) -> RobotModel:
    return build_robot(config)


def _write_clean(
    spec: SequenceSpec, planned: _PlannedRun, log: Path | None, truth: Truth, formats: Formats
) -> None:
    """Window by window: nothing is kept longer than it must."""
    header = log_header(planned.robot, spec.config)
    recorder, bag = DriveRecorder(spec.name, header), None
    with ExitStack() as stack:
        if log is not None:
            bag = stack.enter_context(LogWriter(log, header, spec.name))
        for readings, window in planned.moments():
            truth.write(readings, window)
            formats.write_images(_further(readings))
            if bag is not None:
                part = bag.write(readings, window)
            else:
                part = recorder.take([readings], [window]).recording
            formats.write(part, readings.scans.true_stamps_ns, window)


def _write_with_faults(
    spec: SequenceSpec, planned: _PlannedRun, log: Path | None, truth: Truth, formats: Formats
) -> None:
    """Faults look at the whole recording, so it is in memory."""
    config, header = spec.config, log_header(planned.robot, spec.config)

    def moments() -> Iterator[tuple[Readings, Drive]]:
        for sensed, window in planned.moments():
            truth.write(sensed, window)
            formats.write_images(_further(sensed))
            yield replace(sensed, scans=replace(sensed.scans, truth=None)), window

    with plain_log(log, moments(), header) as plain:
        recorder = DriveRecorder(spec.name, header)
        clean = with_sequence_numbers(recorder.take(plain.readings, plain.windows).recording)
        clean = plain.with_images(clean, planned.faults)
        recording = declared(clean, planned.faults, config.sensors, config.seed)
        if log is not None:
            rewrite_recording(plain.path, clean, recording, log)
    true_ns = np.concatenate([part.scans.true_stamps_ns for part in plain.readings])
    whole = reduce(joined, plain.windows[1:], joined(None, plain.windows[0]))
    formats.write(recording, _still_there(recording, true_ns), whole.drive)


def _further(readings: Readings) -> Iterator[RawStream]:
    """What the additional sensors measured."""
    return (stream for batch in readings.additional for stream in batch.streams())


def _still_there(recording: Recording, true_ns: IntArray) -> IntArray:
    """True stamps of the scans that a recording holds of all that were sensed."""
    if not recording.scans or recording.scans[0].samples is None:
        return true_ns[:0]
    return true_ns[recording.scans[0].samples]


def files_of(folder: Path) -> Iterator[FileFact]:
    """Every file of a sequence, sorted by path; hidden ones are not part of it."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if not path.name.startswith("."):
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            yield FileFact(path.relative_to(folder).as_posix(), path.stat().st_size, digest)
