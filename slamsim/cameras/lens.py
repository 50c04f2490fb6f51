"""The model of a camera: size, camera matrix and distortion, as in sensor_msgs/CameraInfo.

The optical frame is z forward, x right, y down (REP 103). The middle of the first pixel is at
(0, 0), that of the last at (width - 1, height - 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slamsim.cameras.distortion import BrownConrady, Distortion, KannalaBrandt
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.errors import did_you_mean, shown
from slamsim.guard.numbers import BadNumbers, require_finite, require_number, require_whole

COEFFICIENTS: Mapping[str, int] = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Distortion models of sensor_msgs/CameraInfo, and how many coefficients each has."""

LARGEST_SIDE_PX = 65_535
"""No image has more rows or columns: JPEG has no more."""
_LEAST_FOCAL_PX = 1e-3
_MOST_FOCAL_PX = 1e7
_GRID = 33
"""Rows and columns of pixels at which folding is looked for inside the image."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A camera without skew.

    K: (3, 3) pixels. distortion_model: a key of ``COEFFICIENTS``. coefficients: (k,) as
    CameraInfo's ``d``; those left out are zero. Raises BadNumbers for a size that is no image's, a
    camera matrix that is singular or not of the form [fx 0 cx; 0 fy cy; 0 0 1], an unknown model.
    """

    width: int
    height: int
    K: FloatArray
    distortion_model: str = "plumb_bob"
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        require_whole("the width of an image", self.width, 1, LARGEST_SIDE_PX)
        require_whole("the height of an image", self.height, 1, LARGEST_SIDE_PX)
        _require_camera_matrix(self.K)
        most = _coefficient_count(self.distortion_model)
        require_finite("the coefficients of distortion", self.coefficients, (None,))
        if len(self.coefficients) > most:
            raise BadNumbers(
                f"the distortion model {self.distortion_model!r} has {most} coefficients, "
                f"not {len(self.coefficients)}"
            )

    @property
    def focal_px(self) -> FloatArray:
        """(2,) focal lengths along x and y."""
        return self.K[[0, 1], [0, 1]]

    @property
    def centre_px(self) -> FloatArray:
        """(2,) the principal point."""
        return self.K[:2, 2]

    def project(self, points_m: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(n, 2) pixels of (n, 3) points in the optical frame, and (n,) which have an image.

        A point has an image if it is in view and lies before the distortion folds; the image may
        be outside of the picture (``contains``). The pixels of other points mean nothing.
        """
        return self.pixels(points_m), self._distortion.is_seen(points_m)

    def pixels(self, points_m: FloatArray) -> FloatArray:
        """(n, 2) pixels of (n, 3) points, as ``project``, which tells those that have an image."""
        return np.asarray(self._distortion.distorted(points_m) * self.focal_px + self.centre_px)

    def contains(self, pixels: FloatArray) -> BoolArray:
        """(n,) which of (n, 2) pixels lie inside the picture, its outer half pixels included."""
        edges = np.array([self.width, self.height]) - 0.5
        return np.asarray(((pixels >= -0.5) & (pixels < edges)).all(axis=1))

    def rays_at(self, pixels: FloatArray) -> FloatArray:
        """(n, 3) unit directions in the optical frame of (n, 2) pixels; nan where there is none.

        Exact: projected again they are off by less than 1e-9 pixels.
        """
        return self._distortion.rays((pixels - self.centre_px) / self.focal_px)

    def rays(self) -> FloatArray:
        """(height * width, 3) unit directions in the optical frame, row by row from above.

        Raises BadNumbers for a distortion that folds inside the image.
        """
        rays = self.rays_at(
            self._pixels(np.arange(float(self.width)), np.arange(float(self.height)))
        )
        if np.isnan(rays).any() or self.folds():
            raise BadNumbers(f"{self._name()} folds inside the image")
        return rays

    def folds(self) -> bool:
        """Whether the distortion folds inside the image: pixels there belong to no direction.

        Looked for along the outer edges of the image and at some thousand pixels inside.
        """
        columns, rows = self._steps(self.width, self.width + 1), self._steps(self.height, _GRID)
        inside = self._pixels(self._steps(self.width, _GRID), rows)
        top_and_bottom = self._pixels(columns, self._steps(self.height, 2))
        sides = self._pixels(self._steps(self.width, 2), self._steps(self.height, self.height + 1))
        looked_at = np.vstack([inside, top_and_bottom, sides])
        rays = self.rays_at(looked_at)
        if np.isnan(rays).any():
            return True
        again, seen = self.project(rays)
        return not (seen.all() and float(np.abs(again - looked_at).max()) < 1e-6)

    @staticmethod
    def _steps(side_px: int, count: int) -> FloatArray:
        return np.linspace(-0.5, side_px - 0.5, count)

    @staticmethod
    def _pixels(columns: FloatArray, rows: FloatArray) -> FloatArray:
        """(r * c, 2) pixels row by row."""
        x, y = np.meshgrid(columns, rows)
        return np.column_stack([x.ravel(), y.ravel()])

    def _name(self) -> str:
        told = ", ".join(f"{value:g}" for value in self.coefficients)
        return f"the distortion {self.distortion_model} [{told}]"

    @cached_property
    def _distortion(self) -> Distortion:
        values = np.zeros(8)
        values[: len(self.coefficients)] = self.coefficients
        if self.distortion_model == "equidistant":
            return KannalaBrandt(values[:4])
        return BrownConrady(values[[0, 1, 4, 5, 6, 7]], values[2:4])


def pinhole(
    width: int,
    height: int,
    horizontal_fov_deg: float,
    distortion_model: str = "plumb_bob",
    coefficients: FloatArray | None = None,
) -> CameraModel:
    """A camera with square pixels and its centre in the middle.

    horizontal_fov_deg: between the outer edges of the left and the right column without distortion;
    for ``equidistant`` with the focal length times the angle as radius. coefficients: (k,) of the
    model, none for an ideal lens.
    """
    half_rad = np.radians(0.5 * horizontal_fov_deg)
    half = half_rad if distortion_model == "equidistant" else float(np.tan(half_rad))
    focal_px = 0.5 * width / half
    K = np.array([[focal_px, 0, 0.5 * (width - 1)], [0, focal_px, 0.5 * (height - 1)], [0, 0, 1]])
    given = np.zeros(0) if coefficients is None else coefficients
    return CameraModel(width, height, K, distortion_model, given)


def camera_matrix(text: str) -> FloatArray:
    """(3, 3) of "fx,fy,cx,cy" in pixels. Raises BadNumbers."""
    try:
        fx, fy, cx, cy = (float(word) for word in text.split(","))
    except ValueError:
        raise BadNumbers(
            f"a camera matrix is fx,fy,cx,cy in pixels, as 525,525,319.5,239.5, not {shown(text)}"
        ) from None
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    _require_camera_matrix(K)
    return K


def _coefficient_count(model: str) -> int:
    if model not in COEFFICIENTS:
        known = ", ".join(COEFFICIENTS)
        meant = did_you_mean(model, COEFFICIENTS)
        raise BadNumbers(f"the distortion model {shown(model)} is not one of {known}{meant}")
    return COEFFICIENTS[model]


def _require_camera_matrix(K: object) -> None:
    require_finite("a camera matrix", K, (3, 3))
    assert isinstance(K, np.ndarray)
    if K[0, 0] == 0.0 or K[1, 1] == 0.0 or np.linalg.matrix_rank(K) < 3:
        raise BadNumbers(f"the camera matrix {K.ravel().tolist()} is singular")
    for axis in range(2):
        name = f"the focal length along {'xy'[axis]} in pixels"
        require_number(name, K[axis, axis], _LEAST_FOCAL_PX, _MOST_FOCAL_PX)
    others = K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
    if not np.array_equal(others, [0.0, 0.0, 0.0, 0.0, 1.0]):
        raise BadNumbers(
            f"the camera matrix {K.ravel().tolist()} is not of the form fx 0 cx 0 fy cy 0 0 1"
        )
