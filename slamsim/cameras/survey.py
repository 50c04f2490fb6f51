"""What is looked at of images, so that a recording can be judged without holding them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.changes import CutShort, PixelChange
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray

if TYPE_CHECKING:
    from slamsim.cameras.frames import CameraClaim


@dataclass(frozen=True, slots=True, eq=False)
class CameraSurvey:
    """Images of one topic. size: (width, height) of the first.

    stamps_ns, received_ns, digests: (n,) of all; equal digests are equal bytes. sampled: (m,)
    numbers of the images that were decoded, evenly spread runs of three; of each brightness (m,)
    from 0 to 255 (nan of depth), thumbnails (m, h, w) grey (none of depth), and depths_m (m, 3):
    the 1, 50 and 99 % quantiles of the depths as their encoding means them (nan of others, and
    where few pixels have any). damaged: (k,) numbers of those that cannot be decoded, as far as
    their bytes or a look told, or that are of another kind than the first (grey among colour).

    grids_m: (m, h, w) depths of every ``grid_px``-th pixel along rows and columns, from pixel
    ``grid_px // 2`` on, nan for none (none of images). colours: (m, h, w, 3) means of RGB over a
    few patches (of colour images alone). is_metric: whether depths are stored as float metres.

    numbers: (n,) of the messages, on the topic ``read_topic``, that the images were read from.
    changes: what is changed in each, one after the other, when a copy is written.
    """

    topic: str
    kind: Literal["colour", "grey", "depth"]
    frame_id: str
    size: tuple[int, int]
    claim: CameraClaim | None
    stamps_ns: IntArray
    received_ns: IntArray
    digests: NDArray[np.uint32]
    sampled: IntArray
    brightness: FloatArray
    depths_m: FloatArray
    thumbnails: NDArray[np.uint8]
    damaged: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    grids_m: Float32Array = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))
    grid_px: int = 1
    colours: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0, 3)))
    is_metric: bool = False
    read_topic: str = ""
    numbers: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    changes: tuple[PixelChange | CutShort, ...] = ()

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    @property
    def is_new(self) -> BoolArray:
        """(m,) which of the sampled images are not the one before again."""
        again = np.concatenate([[False], np.diff(self.digests.astype(np.int64)) == 0])
        return np.asarray(~again[self.sampled])

    def selected(self, rows: IntArray) -> CameraSurvey:
        """Images with these numbers (k,), in this order, some perhaps again."""
        look_of = np.full(len(self), -1)
        look_of[self.sampled] = np.arange(self.sampled.size)
        looks = look_of[rows]
        seen = np.flatnonzero(looks >= 0)
        per_image = ("stamps_ns", "received_ns", "digests", "numbers")
        kept = {name: getattr(self, name)[rows] for name in per_image}
        damaged = np.flatnonzero(np.isin(rows, self.damaged))
        return replace(self, sampled=seen, damaged=damaged, **kept, **self._of_looks(looks[seen]))

    def repainted(self, change: PixelChange) -> CameraSurvey:
        """With a change of all pixels, as it shows in what is held of them."""
        changed = replace(self, changes=(*self.changes, change))
        if self.kind == "depth":
            depths_m, grids_m = (change.of_values(each) for each in (self.depths_m, self.grids_m))
            return replace(changed, depths_m=depths_m, grids_m=grids_m)
        return replace(changed, colours=change.of_values(self.colours))

    def cut_short(self, rows: IntArray, kept: float) -> CameraSurvey:
        """With this share of the bytes of images (k,), which cannot be decoded any more."""
        cut = CutShort(frozenset(self.numbers[rows].tolist()), kept)
        shown = np.flatnonzero(~np.isin(self.sampled, rows))
        return replace(
            self,
            sampled=self.sampled[shown],
            damaged=np.union1d(self.damaged, rows),
            changes=(*self.changes, cut),
            **self._of_looks(shown),
        )

    def _of_looks(self, looks: IntArray) -> dict[str, Any]:
        """What is held of decoded images, of these (k,) of them."""
        names = ("brightness", "depths_m", "thumbnails", "grids_m", "colours")
        held = {name: getattr(self, name) for name in names}
        return {name: each[looks] if len(each) else each for name, each in held.items()}
