"""Streams of a camera: images as they are or packed, CameraInfo, and the truth of frames."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawStream
from slamsim.recording.schemas import Field, Schema

_FRAME = ("frame_ids", "header.frame_id")
_HEIGHT = Field("height", ("height",), is_constant=True, dtype="int64")
_WIDTH = Field("width", ("width",), is_constant=True, dtype="int64")
_DATA = Field("data", ("data",), is_list=True, dtype="uint8")


@dataclass(frozen=True, slots=True, eq=False)
class RawImages(RawStream):
    """Images of one size; data: (n, height * row_bytes) uint8, rows from above, little-endian."""

    schema = Schema(
        "sensor_msgs/msg/Image",
        (
            *(_HEIGHT, _WIDTH),
            Field("row_bytes", ("step",), is_constant=True, dtype="int64"),
            _DATA,
        ),
        frames=(_FRAME, ("encodings", "encoding")),
    )

    height: int
    width: int
    data: NDArray[np.uint8]
    encodings: tuple[str, ...] = ("16UC1",)

    @property
    def row_bytes(self) -> int:
        return int(self.data.shape[1]) // self.height


@dataclass(frozen=True, slots=True, eq=False)
class RawPackedImages(RawStream):
    """Images that are packed into the same number of bytes; data: (n, k) uint8."""

    schema = Schema(
        "sensor_msgs/msg/CompressedImage",
        (_DATA,),
        frames=(_FRAME, ("formats", "format")),
    )

    data: NDArray[np.uint8]
    formats: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RawCameraInfos(RawStream):
    """The same intrinsics with every image.

    K: (3, 3) pixels; the middle of the first pixel is at (0, 0). coefficients: of the distortion.
    right_of_m: how far to the right of the left one of a pair, 0 for none.
    """

    schema = Schema(
        "sensor_msgs/msg/CameraInfo",
        (
            *(_HEIGHT, _WIDTH),
            Field("coefficients", ("d",), is_list=True, is_constant=True),
            *(Field(name, (name,), is_constant=True) for name in ("k", "r", "p")),
        ),
        frames=(_FRAME, ("distortion_models", "distortion_model")),
    )

    height: int
    width: int
    K: FloatArray
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    distortion_models: tuple[str, ...] = ("plumb_bob",)
    right_of_m: float = 0.0

    @property
    def k(self) -> FloatArray:
        """(9,) the camera matrix by rows."""
        return self.K.ravel()

    @property
    def r(self) -> FloatArray:
        """(9,) no rectification."""
        return np.eye(3).ravel()

    @property
    def p(self) -> FloatArray:
        """(12,) the projection of the rectified image, with -fx times ``right_of_m``."""
        beside = np.array([[-self.K[0, 0] * self.right_of_m], [0.0], [0.0]])
        return np.hstack([self.K, beside]).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class RawFrameTruths(RawStream):
    """True instants, exposures and poses of images.

    instants_ns: (n,) the middle of the exposure of the first row. exposures_s, gains: (n,).
    row_instants_ns (n, r), positions_m (n, 3 r), quats_xyzw (n, 4 r): ``T_map_optical`` of each
    row, of a global shutter one for all.
    """

    schema = Schema(
        "slamsim_msgs/msg/FrameTruth",
        (
            Field("instants_ns", ("instant_ns",), dtype="int64"),
            Field("exposures_s", ("exposure_s",)),
            Field("gains", ("gain",)),
            Field("row_instants_ns", ("row_instants_ns",), is_list=True, dtype="int64"),
            Field("positions_m", ("positions_m",), is_list=True),
            Field("quats_xyzw", ("quats_xyzw",), is_list=True),
        ),
    )

    instants_ns: IntArray
    exposures_s: FloatArray
    gains: FloatArray
    row_instants_ns: IntArray
    positions_m: FloatArray
    quats_xyzw: FloatArray
