"""Stretches of scans with their truth, as whatever learns from them takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slamsim.dataset.lazy_table import LazyTable
from slamsim.safe.errors import SlamsimError
from slamsim.types import IntArray

if TYPE_CHECKING:
    from slamsim.dataset.opened import Dataset

_BEAMS = "quality.beams"

Window = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """A sequence of dicts of arrays; k is the number of scans in each.

    ``ranges_m``: (k, beams) float32 as recorded, ``nan`` throughout where a fault lost the scan,
    and beyond the beams of a lidar that has fewer than the others chosen. ``angles_rad``: (beams,)
    as declared, likewise. ``recorded``: (k,) which are there. ``true_stamps_ns``: (k,) of beam 0.
    ``poses``: (k, 3) ``T_map_base`` then: x_m, y_m, yaw_rad. ``sequence``: (), its index.

    beams: the most that any of these lidars has. ends: (sequences,) how many windows there are up
    to the end of each sequence.
    """

    dataset: Dataset
    scans: int
    stride: int
    beams: int
    ends: IntArray

    def __len__(self) -> int:
        return int(self.ends[-1]) if self.ends.size else 0

    def __getitem__(self, which: int) -> Window:
        number = range(len(self))[which]
        place = int(np.searchsorted(self.ends, number, side="right"))
        before = int(self.ends[place - 1]) if place else 0
        return self._window(place, (number - before) * self.stride)

    def _window(self, place: int, first: int) -> Window:
        sequence, last = self.dataset[place], first + self.scans
        scans = LazyTable(sequence.place, f"{sequence.name}/parquet/scans.parquet")
        ranges_m, recorded = self._recorded(scans, first, last)
        truth = LazyTable(sequence.place, f"{sequence.name}/truth/scans.parquet")
        true_stamps_ns = truth.rows(first, last, ("true_stamp_ns",))["true_stamp_ns"]
        during = int(true_stamps_ns[0]), int(true_stamps_ns[-1]) + 1
        return {
            "ranges_m": ranges_m,
            "angles_rad": self._angles_rad(scans),
            "recorded": recorded,
            "true_stamps_ns": true_stamps_ns,
            "poses": replace(sequence.truth, span=during).poses_at(true_stamps_ns),
            "sequence": np.array(sequence.row["index"]),
        }

    def _recorded(
        self, table: LazyTable, first: int, last: int
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        samples = table.column("sample")
        rows = np.flatnonzero((samples >= first) & (samples < last))
        begin, end = (int(rows[0]), int(rows[-1]) + 1) if rows.size else (0, 1)
        ranges_m = table.rows(begin, end, ("ranges_m",))["ranges_m"]
        found = np.full((self.scans, self.beams), np.nan, dtype=np.float32)
        found[samples[rows] - first, : ranges_m.shape[1]] = ranges_m[rows - begin]
        recorded = np.zeros(self.scans, dtype=np.bool_)
        recorded[samples[rows] - first] = True
        return found, recorded

    def _angles_rad(self, table: LazyTable) -> NDArray[np.float64]:
        layout, found = table.facts["layouts"][0], np.full(self.beams, np.nan)
        beams = table.rows(0, 0, ("ranges_m",))["ranges_m"].shape[1]
        found[:beams] = layout["angle_min_rad"] + layout["angle_step_rad"] * np.arange(beams)
        return found


def windows_of(dataset: Dataset, scans: int, stride: int) -> Windows:
    """Raises ValueError for windows without scans, or that never move on.

    Raises SlamsimError for a data set that does not tell how many beams its lidars have.
    """
    if scans < 1 or stride < 1:
        raise ValueError(f"windows of {scans} scans, one every {stride}, are none")
    if _BEAMS not in dataset.manifest.column_names:
        raise SlamsimError(
            f"{dataset.place.address} was made by an earlier version, which did not note {_BEAMS}, "
            "the number of beams; windows need it: make the data set again with this version"
        )
    sensed = dataset.manifest["quality.scans"].to_numpy()
    counts = np.maximum((sensed - scans) // stride + 1, 0)
    beams = int(dataset.manifest[_BEAMS].to_numpy().max(initial=0))
    return Windows(dataset, scans, stride, beams, np.cumsum(counts, dtype=np.int64))
