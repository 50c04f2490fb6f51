"""The formats of a sequence besides rosbag2, written alike of clean and of faulty recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.types import Drive, IntArray, Trajectory
from slamsim.dataset.make.deskewed import DeskewedScans
from slamsim.dataset.recipe.sequence import SequenceSpec
from slamsim.guard.numbers import UNIT_WITHIN, is_sound
from slamsim.io.carmen.writer import CarmenFile
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.staged_writer import StagedWriter
from slamsim.io.text.kitti import KittiFolder
from slamsim.io.text.tum import write_tum
from slamsim.recording import Recording
from slamsim.simulation.tails import TruthTail

TRUTH_RATE_HZ = 50.0
GROUND_TRUTH, ODOMETRY = "ground_truth.tum", "odometry.tum"


class TumPaths(StagedWriter):
    """``ground_truth.tum``, ``T_map_base`` in true time, and ``odometry.tum``, as was published,
    without what is no pose."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._tail = TruthTail(TRUTH_RATE_HZ)
        self._last_ns: int | None = None
        self._truth: list[Trajectory] = []
        self._odometry: list[Trajectory] = []

    def take_truth(self, window: Drive) -> None:
        """The next window of the drive."""
        self._truth.append(self._tail.take(window, self._last_ns).trajectory())
        self._last_ns = int(window.stamps_ns[-1])

    def write(self, part: Recording) -> None:
        """The next part of the recording."""
        for moved in part.odometries[:1]:
            length = np.linalg.norm(moved.quats_xyzw, axis=1)
            sound = is_sound(moved.positions_m) & (np.abs(length - 1.0) < UNIT_WITHIN)
            rows = moved.stamps_ns, moved.positions_m, moved.quats_xyzw
            self._odometry.append(Trajectory(*(column[sound] for column in rows)))

    def _finish(self) -> None:
        """A recording without odometry has no file of it."""
        rest = [] if self._tail.rest is None else [self._tail.rest.trajectory()]
        write_tum(self._folder / GROUND_TRUTH, _joined([*self._truth, *rest]))
        if self._odometry:
            write_tum(self._folder / ODOMETRY, _joined(self._odometry))


def _joined(parts: list[Trajectory]) -> Trajectory:
    return Trajectory(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.positions_m for part in parts]),
        np.concatenate([part.quats_xyzw for part in parts]),
    )


PARQUET, TUM, KITTI, CARMEN = "parquet", "tum", "kitti", "carmen"
CARMEN_NAME = "log.clf"


class Formats(StagedWriter):
    """What a specification asks for, in folders of their names; a context manager.

    All of them tell what the recording tells, faults included; trajectories called true are.
    """

    def __init__(self, spec: SequenceSpec, folder: Path) -> None:
        super().__init__()
        self._parquet: ParquetLog | None = None
        self._carmen: CarmenFile | None = None
        self._kitti: DeskewedScans | None = None
        self._tum: TumPaths | None = None
        opened = self._open.enter_context
        if "parquet" in spec.formats:
            self._parquet = opened(ParquetLog(folder / PARQUET, spec.index))
        if "carmen" in spec.formats:
            self._carmen = opened(CarmenFile(folder / CARMEN / CARMEN_NAME))
        if "kitti" in spec.formats:
            self._kitti = DeskewedScans(opened(KittiFolder(folder / KITTI)))
        if "tum" in spec.formats:
            self._tum = opened(TumPaths(folder / TUM))

    def write(self, part: Recording, true_scan_ns: IntArray, window: Drive) -> None:
        """The next part of the recording, the true stamps of its scans, the drive meanwhile."""
        for log in (self._parquet, self._carmen, self._tum):
            if log is not None:
                log.write(part)
        if self._tum is not None:
            self._tum.take_truth(window)
        if self._kitti is not None:
            self._kitti.write(part, true_scan_ns, window)
