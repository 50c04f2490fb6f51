"""Camera images of a finished data set, decoded when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.dataset.store.lazy_table import LazyTable
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, limit_of
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
