"""Camera images of a finished data set, and stretches of them to learn from; decoded when asked
for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.dataset.store.lazy_table import LazyTable
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, NotFound, limit_of, shown
from slamsim.io.parquet.images import pixels_of

TRUTH = "truth/"
IMAGES_OF = "quality.images."
"""The manifest's columns of how many images each table has."""


@dataclass(frozen=True, slots=True)
class ImageTable:
    """Images of one topic of a sequence; it can be pickled.

    sequence: its name. name: of the table, as ``front_color``, or ``truth/front_color_depth``. All
    raise NotFound for one that is not there, DataDamaged or InputRefused for one that is damaged.
    """

    place: Location
    sequence: str
    name: str

    @property
    def table(self) -> LazyTable:
        """Its rows as they are stored."""
        folder = "" if self.name.startswith(TRUTH) else "images/"
        return LazyTable(self.place, f"{self.sequence}/{folder}{self.name}.parquet")

    @property
    def stamps_ns(self) -> IntArray:
        """(n,) as recorded."""
        return self.table.column("stamp_ns")

    @property
    def K(self) -> FloatArray:  # noqa: N802
        """(3, 3) camera matrix: as claimed, of a truth as it is."""
        return np.array(self.table.facts["camera"]["K"])

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        camera = self.table.facts["camera"]
        return int(camera["width"]), int(camera["height"])

    def at(self, row: int) -> NDArray[Any]:
        """One image: colour (h, w, 3) uint8 RGB, grey (h, w) uint8, depth (h, w) float32 metres
        with nan for none, other truth as it is."""
        cells = self.table.rows(row, row + 1, ("encoding", "data"))
        try:
            return pixels_of(str(cells["encoding"][0]), bytes(cells["data"][0]), self.size)
        except ValueError as error:
            where, path = f"row {row}", f"{self.place.address}/{self.table.path}"
            raise InputRefused(path, str(error), where, limit=limit_of(error)) from None

    def nearest(self, stamps_ns: IntArray) -> IntArray:
        """(n,) rows whose stamps are nearest to these."""
        ours = self.stamps_ns
        return np.array([int(np.abs(ours - stamp).argmin()) for stamp in stamps_ns.tolist()])

    def stacked(self, rows: IntArray) -> NDArray[Any]:
        """(n, h, w) or (n, h, w, channels) images."""
        return np.stack([self.at(int(row)) for row in rows])

    def T_map_optical(self, rows: IntArray) -> FloatArray:  # noqa: N802
        """(n, 4, 4) true poses of the optical frame for the first rows of images."""
        name = f"{self.sequence}/truth/{self.name}_frame.parquet"
        every = partial(LazyTable(self.place, name).rows, columns=("positions_m", "quats_xyzw"))
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        for pose, row in zip(poses, rows.tolist(), strict=True):
            cells = every(row, row + 1)
            pose[:3, 3] = cells["positions_m"][0, :3]
            pose[:3, :3] = matrix_from_xyzw(cells["quats_xyzw"][:, :4])[0]
        return poses


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """A sequence of dicts of arrays, which a PyTorch DataLoader takes; k images in each.

    Under the name of each table its images, (k, h, w) or (k, h, w, channels), as ``ImageTable.at``
    gives them: those of ``name``, and of ``beside`` the ones whose stamps are nearest.
    ``stamps_ns``: (k,) of ``name``. ``T_map_optical``: (k, 4, 4) its true poses. ``K``: (3, 3) its
    camera matrix. ``sequence``: (), its index.

    sequences: (name, index) of those that have such images; ends: (sequences,) how many windows
    there are up to the end of each.
    """

    place: Location
    sequences: tuple[tuple[str, int], ...]
    name: str
    beside: tuple[str, ...]
    count: int
    stride: int
    ends: IntArray

    def __len__(self) -> int:
        return int(self.ends[-1]) if self.ends.size else 0

    def __getitem__(self, which: int) -> dict[str, NDArray[Any]]:
        number = range(len(self))[which]
        place = int(np.searchsorted(self.ends, number, side="right"))
        first = (number - (int(self.ends[place - 1]) if place else 0)) * self.stride
        sequence, index = self.sequences[place]
        images = ImageTable(self.place, sequence, self.name)
        rows = np.arange(first, first + self.count)
        stamps_ns = images.stamps_ns[rows]
        return {
            self.name: images.stacked(rows),
            **nearest_images(self.place, sequence, self.beside, stamps_ns),
            "stamps_ns": stamps_ns,
            "T_map_optical": images.T_map_optical(rows),
            "K": images.K,
            "sequence": np.array(index),
        }


def nearest_images(
    place: Location, sequence: str, names: tuple[str, ...], stamps_ns: IntArray
) -> dict[str, NDArray[Any]]:
    """By table, of each stamp the image of the nearest one.

    stamps_ns: (n,). Each array is (n, h, w), of colours (n, h, w, 3).
    """
    tables = (ImageTable(place, sequence, name) for name in names)
    return {table.name: table.stacked(table.nearest(stamps_ns)) for table in tables}


def frames_of(
    place: Location, manifest: pa.Table, name: str, beside: tuple[str, ...], count: int, stride: int
) -> Frames:
    """manifest: rows that were made. Raises ValueError for stretches without images, or that never
    move on, NotFound for images that no sequence has."""
    if count < 1 or stride < 1:
        raise ValueError(f"stretches of {count} images, one every {stride}, are none")
    if f"{IMAGES_OF}{name}" not in manifest.column_names:
        there = (each.removeprefix(IMAGES_OF) for each in manifest.column_names)
        known = sorted(n for n in there if f"{IMAGES_OF}{n}" in manifest.column_names)
        told = ", ".join(known) or "none (its format parquet holds them)"
        raise NotFound(f"{place.address} has no images {shown(name)}; there are {told}")
    rows = manifest.select(["name", "index", f"{IMAGES_OF}{name}"]).to_pylist()
    some = [row for row in rows if row[f"{IMAGES_OF}{name}"]]
    numbers = np.array([row[f"{IMAGES_OF}{name}"] for row in some], dtype=np.int64)
    ends = np.cumsum(np.maximum((numbers - count) // stride + 1, 0), dtype=np.int64)
    sequences = tuple((str(row["name"]), int(row["index"])) for row in some)
    return Frames(place, sequences, name, beside, count, stride, ends)
