"""What is looked at of images, so that a recording can be judged without holding them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import FloatArray, IntArray

if TYPE_CHECKING:
    from slamsim.cameras.frames import CameraClaim


@dataclass(frozen=True, slots=True, eq=False)
class CameraSurvey:
    """Images of one topic. size: (width, height) of the first.

    stamps_ns, received_ns, digests: (n,) of all; equal digests are equal bytes. sampled: (m,)
    numbers of the images that were decoded, evenly spread runs of three; of each brightness (m,)
    from 0 to 255 (nan of depth), thumbnails (m, h, w) grey (none of depth), and depths_m (m, 3):
    the 1, 50 and 99 % quantiles of the depths as their encoding means them (nan of others, and
    where few pixels have any). damaged: how many of the sampled could not be decoded.
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
    damaged: int = 0

    def __len__(self) -> int:
        return int(self.stamps_ns.size)
