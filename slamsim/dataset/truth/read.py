"""The truth of a sequence of a finished data set, read when it is asked for."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import Float32Array, FloatArray, Grid, IntArray, Trajectory
from slamsim.dataset.store.lazy_table import Cells, LazyTable
from slamsim.dataset.store.place import Location
from slamsim.dataset.truth.tables import drive_of
from slamsim.sensors.motion import Motion
from slamsim.world.map_server import read_map

Span = tuple[int, int]
"""From one instant to before another, ns of true time."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedBeamTruth:
    """What the beams of scans truly met, beam by beam: (n,) scans of ``beams`` beams.

    samples: (n,) number of each scan among all that were sensed. stamps_ns: on the lidar's clock
    before any fault, true_stamps_ns: of the same instants. ranges_m: (n, beams), ``inf`` where
    nothing is. incidence_rad: 0 head-on. surfaces: rows of ``SequenceTruth.surfaces``, 65535 none.
    """

    samples: IntArray
    stamps_ns: IntArray
    true_stamps_ns: IntArray
    ranges_m: Float32Array
    incidence_rad: Float32Array
    surfaces: NDArray[np.uint16]

    def __len__(self) -> int:
        return int(self.samples.size)


@dataclass(frozen=True, slots=True)
class SequenceTruth:
    """The truth of one sequence, or of a part of it. span: the part, nothing for all."""

    place: Location
    name: str
    span: Span | None = None

    @property
    def motion(self) -> Motion:
        """The motion at any instant of the part, as every sensor had it."""
        table = self._table("trajectory")
        first, last = 0, len(table)
        if self.span is not None:
            stamps_ns = table.column("stamp_ns")
            first = max(int(np.searchsorted(stamps_ns, self.span[0], side="right")) - 2, 0)
            last = min(int(np.searchsorted(stamps_ns, self.span[1], side="left")) + 1, last)
            first = max(min(first, last - 2), 0)
        return Motion(drive_of(table.rows(first, last)))

    @property
    def begin_ns(self) -> int:
        """True time of the start of the whole drive."""
        return int(self._table("trajectory").rows(0, 1, ("stamp_ns",))["stamp_ns"][0])

    def at(self, stamps_ns: IntArray) -> Trajectory:
        """``T_map_base`` at true instants; raises OutsideTimeRange beyond the part.

        stamps_ns: (n,).
        """
        motion = self.motion
        return Trajectory(
            stamps_ns, motion.positions_at(stamps_ns), motion.quats_xyzw_at(stamps_ns)
        )

    def poses_at(self, stamps_ns: IntArray) -> FloatArray:
        """(n, 3) the same in the plane: x_m, y_m, yaw_rad."""
        path = self.at(stamps_ns)
        return np.column_stack([path.positions_m[:, :2], yaw_from_xyzw(path.quats_xyzw)])

    @property
    def scans(self) -> RecordedBeamTruth:
        """Of every beam, lost ones included."""
        first, last = self.samples("scans")
        cells = self._table("scans").rows(first, last)
        return RecordedBeamTruth(
            np.arange(first, last),
            cells["stamp_ns"],
            cells["true_stamp_ns"],
            cells["true_ranges_m"],
            cells["incidence_rad"],
            cells["surfaces"],
        )

    @property
    def imu(self) -> Cells:
        """Columns: stamps, values without error, biases; row by row what was sensed."""
        return self._table("imu").rows(*self.samples("imu"))

    @property
    def encoders(self) -> Cells:
        """Columns: stamps, true angles of the wheels; row by row what was sensed."""
        return self._table("encoders").rows(*self.samples("encoders"))

    @property
    def pairs(self) -> Cells:
        """Columns: two scans each that see the same, with motion, overlap, ``closes_loop``.

        Of a part, those pairs of which both scans are in it.
        """
        table = self._table("pairs")
        cells = table.rows(0, len(table))
        if self.span is None:
            return cells
        begins, ends = cells["true_stamp_a_ns"], cells["true_stamp_b_ns"]
        inside = (begins >= self.span[0]) & (ends < self.span[1])
        return {name: values[inside] for name, values in cells.items()}

    @property
    def surfaces(self) -> Cells:
        """Columns: the flat surfaces that beams meet; row n describes surface n."""
        table = self._table("surfaces")
        return table.rows(0, len(table))

    @property
    def occupancy(self) -> Grid:
        """The true grid at the height of the lidar: 1 occupied, 0 free, ``nan`` out of reach.

        Raises NotFound where its file is missing.
        """
        with tempfile.TemporaryDirectory() as folder:
            for name in ("occupancy.yaml", "occupancy.png"):
                data = self.place.sealed(f"{self.name}/truth/{name}")
                (Path(folder) / name).write_bytes(data)
            return read_map(Path(folder) / "occupancy.yaml")

    def samples(self, table: str) -> Span:
        """Which samples of a sensor were taken in this part: first, and first beyond."""
        rows = self._table(table)
        if self.span is None:
            return 0, len(rows)
        find = partial(np.searchsorted, rows.column("true_stamp_ns"))
        return int(find(self.span[0])), int(find(self.span[1]))

    def _table(self, name: str) -> LazyTable:
        return LazyTable(self.place, f"{self.name}/truth/{name}.parquet")
