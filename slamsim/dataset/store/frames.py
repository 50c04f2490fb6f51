"""Stretches of camera images to learn from, decoded when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from slamsim.core.types import IntArray
from slamsim.dataset.store.images import IMAGES_OF, ImageTable
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import NotFound, shown


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
    """By table, of each stamp the image of the nearest one."""
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
