"""Frames of cameras as they cross a stage: encoded as recorded, decoded, and what is claimed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.lens import COEFFICIENTS, CameraModel
from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.errors import InputRefused, limit_of
from slamsim.guard.numbers import BadNumbers

_MOST_MM_OF_METRES = 65
"""16-bit depths of which none is larger are metres: no depth camera sees nearer than 70 mm
(RealSense D405), and none farther than 65 m."""
_LEAST_M_OF_MM = 100.0
"""Depths of which none is smaller, in metres, are millimetres."""
_USUAL_NAMES = {"fisheye": "equidistant"}
"""ROS's names of distortion models that are told otherwise: OpenCV calls Kannala-Brandt's so, and
drivers and calibrators of fisheye cameras write it into CameraInfo."""
_FEW = 0.01
"""Share of an image's pixels that must have a depth before its unit is doubted."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """One decoded image.

    stamp_ns: as its header says, when the exposure began or was in its middle. received_ns: when
    the recorder had it, the stamp where the format does not say. pixels: of kind ``colour`` (h, w,
    3) uint8 RGB, ``grey`` (h, w) uint8, ``depth`` (h, w) float32 metres along the optical axis, nan
    where there is none.
    """

    topic: str
    kind: Kind
    stamp_ns: int
    received_ns: int
    frame_id: str
    pixels: NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """One image as it was recorded; ``decoded`` makes a frame of it when that is wanted.

    path: the file it is in. number: among those of its topic, from 0. encoding: as the message
    tells it. size: (width, height) that it must have, None for any. unit_m: metres in a unit of
    integer depths. read: gives kind and pixels, raises ValueError for what cannot be decoded.
    packed: gives the whole JPEG or PNG file, nothing where it is none. content: gives the bytes
    of pixels as they are stored, packed or not.
    """

    path: Path
    topic: str
    number: int
    stamp_ns: int
    received_ns: int
    frame_id: str
    encoding: str
    read: Callable[[], tuple[Kind, NDArray[Any]]]
    packed: Callable[[], bytes] = bytes
    content: Callable[[], bytes | memoryview] = bytes
    size: tuple[int, int] | None = None
    unit_m: float = 1e-3

    def stored(self) -> tuple[Kind, NDArray[Any]]:
        """Kind and pixels, depths as they are stored: uint16 in unit_m, or float32 metres.

        Raises InputRefused, naming topic and number, for what cannot be decoded, and for an image
        of another size than its topic's.
        """
        with self._refusing():
            kind, pixels = self.read()
            height, width = pixels.shape[:2]
            if self.size not in (None, (width, height)):
                told = "{} x {}".format(*self.size or ())
                raise ValueError(f"is {width} x {height}, while its topic began with {told}")
            return kind, pixels

    def decoded(self) -> CameraFrame:
        """Raises InputRefused as ``stored`` does, and for depths of another unit."""
        kind, pixels = self.stored()
        if kind == "depth":
            with self._refusing():
                pixels = metres(pixels, self.unit_m)
        return CameraFrame(self.topic, kind, self.stamp_ns, self.received_ns, self.frame_id, pixels)

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            where = f"topic {self.topic}, image {self.number + 1}"
            raise InputRefused(self.path, str(error), where, limit=limit_of(error)) from None


def metres(pixels: NDArray[Any], unit_m: float) -> Float32Array:
    """Depths in metres, nan for none: of integers 0, of floats what is not above 0 and finite.

    Raises ValueError for depths that cannot be of their unit: metres in an integer image of
    millimetres, or millimetres in one of metres. pixels: (h, w) uint16 in unit_m, or float metres;
    as many come back.
    """
    is_integer = pixels.dtype.kind == "u"
    there = pixels > 0 if is_integer else (pixels > 0.0) & np.isfinite(pixels)
    found = pixels[there]
    if found.size > _FEW * pixels.size:
        low, high = float(found.min()), float(found.max())
        if is_integer and unit_m == 1e-3 and high <= _MOST_MM_OF_METRES:
            raise ValueError(
                f"its depths reach to {high:.0f}, which is no millimetres but metres: 16UC1 holds "
                "millimetres, 32FC1 metres (REP 118)"
            )
        if not is_integer and low >= _LEAST_M_OF_MM:
            raise ValueError(
                f"its depths begin at {low:.0f}, which is no metres but millimetres: 32FC1 holds "
                "metres, 16UC1 millimetres (REP 118)"
            )
    # In double precision first: 1500 mm are then exactly 1.5 m.
    in_metres = (pixels * (unit_m if is_integer else 1.0)).astype(np.float32)
    return np.where(there, in_metres, np.float32(np.nan))


def readout_key(raw_topic: str) -> str:
    """Under which custom data of a recording say how many seconds pass from the exposure of the
    first row to that of the last, which no message of ROS does. raw_topic: of images, without
    transport."""
    return f"readout_s:{raw_topic}"


@dataclass(frozen=True, slots=True, eq=False)
class CameraClaim:
    """What a recording says of a camera, right or wrong.

    source: the topic or file that says it. K: (3, 3), R: (3, 3), P: (3, 4) as in
    sensor_msgs/CameraInfo. coefficients: (k,) its D. binning: (x, y). roi_px: (left, top, width,
    height), 0 for the whole. T_body_camera: (4, 4) where the layout has it (EuRoC). readout_s: from
    the first row to the last, None where nothing tells the shutter.
    """

    source: str
    frame_id: str
    width: int
    height: int
    distortion_model: str
    coefficients: FloatArray
    K: FloatArray
    R: FloatArray = field(default_factory=lambda: np.eye(3))
    P: FloatArray = field(default_factory=lambda: np.zeros((3, 4)))
    binning: tuple[int, int] = (1, 1)
    roi_px: tuple[int, int, int, int] = (0, 0, 0, 0)
    T_body_camera: FloatArray | None = None
    readout_s: float | None = None

    def __post_init__(self) -> None:
        usual = _USUAL_NAMES.get(self.distortion_model, self.distortion_model)
        object.__setattr__(self, "distortion_model", usual)

    @property
    def image_size(self) -> tuple[int, int]:
        """(width, height) of the images: of the part that is read out, binned."""
        width, height = (self.roi_px[2] or self.width), (self.roi_px[3] or self.height)
        return width // self.binning[0], height // self.binning[1]

    def model(self) -> CameraModel:
        """The camera that makes such images. Raises BadNumbers as ``CameraModel`` does, and for a
        distortion that folds inside the image."""
        K, (left, top, _, _) = self.K.copy(), self.roi_px
        K[:2, 2] -= (left, top)
        # Of binned pixels the middle of the first is that of b pixels: (x + 0.5) / b - 0.5.
        K[:2, 2] = (K[:2, 2] + 0.5) / self.binning - 0.5
        K[[0, 1], [0, 1]] /= self.binning
        name = self.distortion_model or "plumb_bob"
        most = COEFFICIENTS.get(name, len(self.coefficients))
        used = self.coefficients[:most] if not self.coefficients[most:].any() else self.coefficients
        found = CameraModel(*self.image_size, K, name, used)
        if found.folds():
            told = ", ".join(f"{value:g}" for value in used)
            raise BadNumbers(f"the distortion {name} [{told}] folds inside the image")
        return found
