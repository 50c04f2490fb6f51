"""The formats of a sequence besides rosbag2, fed alike by clean and by spoilt recordings."""

from __future__ import annotations

from pathlib import Path

from slamsim.core.types import Drive, IntArray
from slamsim.dataset.make.deskewed import DeskewedScans
from slamsim.dataset.make.tum_paths import TumPaths
from slamsim.dataset.recipe.sequence import SequenceSpec
from slamsim.io.carmen.writer import CarmenFile
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.staged_writer import StagedWriter
from slamsim.io.text.kitti import KittiFolder
from slamsim.recording import Recording

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
