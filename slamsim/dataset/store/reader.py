"""Reads a finished data set: sequences are loaded lazily, as far as needed.

Everything here can be pickled and sent to other processes, and nothing keeps a file open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from slamsim.config.run import RunConfig
from slamsim.core.types import BoolArray, IntArray, Log
from slamsim.dataset.catalogue.statistics import read_manifest
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.recipe.sequence import SPLITS, Cell
from slamsim.dataset.store.images import Frames, ImageTable, frames_of, nearest_images
from slamsim.dataset.store.lazy_table import LazyTable
from slamsim.dataset.store.place import Location
from slamsim.dataset.truth.read import SequenceTruth, Span
from slamsim.guard.errors import SlamsimError, shown
from slamsim.guard.files import own_file
from slamsim.guard.yaml import parse_yaml
from slamsim.io import LOG, TABLES
from slamsim.io.parquet.reader import stream_of
from slamsim.recording import RawImu, RawOdometry, RawScans, RawStream, RawTicks
from slamsim.simulation.own_files import CONFIG

_Raw = TypeVar("_Raw", bound=RawStream)
_BEAMS = "quality.beams"

Window = dict[str, NDArray[Any]]
"""One of ``Windows``."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """One sequence, or a part of it in time.

    row: what the manifest has of it. truth: what is true of it.

    ``scans``, ``imu``, ``odometry`` and ``encoders`` are the recording as it was written, faults
    and all, of a data set that has the format parquet; ``samples`` of each numbers the rows of
    its truth. Of a part they are what was sensed in that time, whatever their stamps say.
    """

    place: Location
    name: str
    row: Mapping[str, Cell] = field(repr=False)
    truth: SequenceTruth = field(repr=False)

    def between(self, start_s: float, end_s: float) -> Sequence:
        """What was sensed from one instant to before another, in true time since the start.

        Raises ValueError for an empty span.
        """
        if not 0.0 <= start_s < end_s:
            raise ValueError(f"no time lies from {start_s:g} s to {end_s:g} s")
        begin_ns = self.truth.begin_ns
        span = begin_ns + round(start_s * 1e9), begin_ns + round(end_s * 1e9)
        return replace(self, truth=replace(self.truth, span=span))

    @property
    def scans(self) -> RawScans:
        """``ranges_m``: (n, beams)."""
        return self._recorded(RawScans)

    @property
    def imu(self) -> RawImu:
        """Rates of turn and specific forces, (n, 3) each."""
        return self._recorded(RawImu)

    @property
    def encoders(self) -> RawTicks:
        """``ticks``: (n, 2) left, right."""
        return self._recorded(RawTicks)

    @property
    def odometry(self) -> RawOdometry:
        """Poses as the robot's driver published them; of a part by their stamps."""
        return self._recorded(RawOdometry)

    def images(self, name: str) -> ImageTable:
        """Those of a table, such as ``front_color``, or ``truth/front_color_depth``."""
        return ImageTable(self.place, self.name, name)

    @property
    def log(self) -> Log:
        """The whole sequence as SLAM reads it. Raises SlamsimError where it is not a folder."""
        from slamsim.io.open import read_log

        if "://" in self.place.address:
            raise SlamsimError(f"{self.name} is at {self.place.address}: copy it to a folder first")
        folder = own_file(Path(self.place.address), self.name)
        return read_log(own_file(folder, LOG if (folder / LOG).is_dir() else TABLES))

    @property
    def config(self) -> RunConfig:
        """Every setting that it was made with. Raises NotFound where its file is missing."""
        path = f"{self.name}/{CONFIG}"
        text = self.place.sealed(path).decode()
        return RunConfig.model_validate(parse_yaml(text, Path(path)).data)

    def _recorded(self, kind: type[_Raw]) -> _Raw:
        name = kind.schema.table
        table = LazyTable(self.place, f"{self.name}/parquet/{name}.parquet")
        if self.truth.span is None:
            return stream_of(kind, table.facts, table.rows(0, len(table)))
        rows = np.flatnonzero(self._inside(table, name, self.truth.span))
        first, last = (int(rows[0]), int(rows[-1]) + 1) if rows.size else (0, 0)
        cells = table.rows(first, last)
        some = {key: values[rows - first] for key, values in cells.items()}
        return stream_of(kind, table.facts, some)

    def _inside(self, table: LazyTable, name: str, span: Span) -> BoolArray:
        """Which rows of a table are in the part."""
        if name == "odometry":
            values, (first, last) = table.column("stamp_ns"), span
        else:
            values, (first, last) = table.column("sample"), self.truth.samples(name)
        return np.asarray((values >= first) & (values < last))


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """Sequences, as many as the manifest has rows: those that were made, or some of them."""

    place: Location
    manifest: pa.Table = field(repr=False)

    def __len__(self) -> int:
        return int(self.manifest.num_rows)

    @overload
    def __getitem__(self, which: int | str) -> Sequence: ...

    @overload
    def __getitem__(self, which: slice) -> Dataset: ...

    def __getitem__(self, which: int | str | slice) -> Sequence | Dataset:
        """By place in this selection, by name (``train/000012``), or several of them."""
        if isinstance(which, slice):
            return replace(self, manifest=self.manifest.take(list(range(len(self))[which])))
        if isinstance(which, str):
            place = pc.index(self.manifest["name"], which).as_py()
            if place < 0:
                raise KeyError(f"there is no sequence {shown(which)}")
        else:
            place = range(len(self))[which]
        row = self.manifest.slice(place, 1).to_pylist()[0]
        name = str(row["name"])
        return Sequence(self.place, name, row, SequenceTruth(self.place, name))

    def __iter__(self) -> Iterator[Sequence]:
        return (self[place] for place in range(len(self)))

    def split(self, name: str) -> Dataset:
        """Those of train, val or test. Raises SlamsimError for another name."""
        if name not in SPLITS:
            raise SlamsimError(f"there is no split {shown(name)}, but {', '.join(SPLITS)}")
        return self.filter(pc.field("split") == name)

    def filter(self, condition: pc.Expression) -> Dataset:
        """Those for whose row it holds: ``pc.field("quality.path_length_m") > 20``.

        ``pc`` is pyarrow.compute; ``dataset.manifest.column_names`` are the fields.
        """
        return replace(self, manifest=self.manifest.filter(condition))

    def windows(self, scans: int = 8, stride: int = 4, images: tuple[str, ...] = ()) -> Windows:
        """Stretches of so many scans, one begun every ``stride``, as dicts of arrays to learn from.

        images: tables of which each scan gets the image with the nearest stamp, such as
        ``front_color`` and ``truth/front_color_depth``. What it gives has a length and items, so
        that a PyTorch DataLoader takes it as it is.
        """
        return windows_of(self, scans, stride, images)

    def frames(
        self, name: str, beside: tuple[str, ...] = (), count: int = 1, stride: int = 1
    ) -> Frames:
        """Stretches of ``count`` images of a table, such as ``front_color``, likewise.

        beside: tables of which each image gets the one with the nearest stamp.
        """
        return frames_of(self.place, self.manifest, name, beside, count, stride)


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """A sequence of dicts of arrays; k is the number of scans in each.

    ``ranges_m``: (k, beams) float32 as recorded, ``nan`` throughout where a fault lost the scan,
    and beyond the beams of a lidar that has fewer than the others chosen. ``angles_rad``: (beams,)
    as declared, likewise. ``recorded``: (k,) which are there. ``true_stamps_ns``: (k,) of beam 0.
    ``poses``: (k, 3) ``T_map_base`` then: x_m, y_m, yaw_rad. ``sequence``: (), its index. Under the
    name of each table of images: (k, h, w) or (k, h, w, channels), as ``ImageTable.at`` has them.

    beams: the most that any of these lidars has. ends: (sequences,) how many windows there are up
    to the end of each sequence.
    """

    dataset: Dataset
    scans: int
    stride: int
    beams: int
    ends: IntArray
    images: tuple[str, ...] = ()

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
            **nearest_images(sequence.place, sequence.name, self.images, true_stamps_ns),
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


def windows_of(dataset: Dataset, scans: int, stride: int, images: tuple[str, ...] = ()) -> Windows:
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
    return Windows(dataset, scans, stride, beams, np.cumsum(counts, dtype=np.int64), images)


def open_dataset(address: str | Path) -> Dataset:
    """The data set in a folder or behind a URL.

    Raises NotFound where there is none, DataDamaged or InputRefused if its manifest is damaged.
    """
    text = str(address)
    place = Location(text if "://" in text else str(Path(text).resolve()))  # wherever it is sent
    manifest: Any = read_manifest(place)
    return Dataset(place, manifest.filter(pc.field("status") == MADE))
