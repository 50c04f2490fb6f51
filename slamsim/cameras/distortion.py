"""Distortion of lenses: from directions to the image plane at distance one, and back.

Brown-Conrady with a rational radial part (``plumb_bob``, ``rational_polynomial``) and
Kannala-Brandt (``equidistant``), with the coefficients in the order of sensor_msgs/CameraInfo,
which is OpenCV's. Points of the image plane are called distorted: multiplied by K they are pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from slamsim.core.types import BoolArray, FloatArray

_TABLE = 4096
"""Entries of the table from which Newton's method starts."""
_MOST_STEPS = 30
_WITHIN = 1e-15
"""Newton's method ends where a step changes nothing any more in double precision."""
_WIDEST = 1e4
"""Tangent of the widest angle to the axis for which a lens with an image plane is inverted."""

_LEAST_INVERSE = 1e-100
"""Of a root: a larger one is taken for none, so that its inverse is finite."""


class Distortion(Protocol):
    """How a lens maps directions to points of the image plane."""

    def distorted(self, points_m: FloatArray) -> FloatArray:
        """(n, 2) distorted points of (n, 3) points in the optical frame, of whatever length."""
        ...

    def is_seen(self, points_m: FloatArray) -> BoolArray:
        """(n,) which of (n, 3) points have an image: in view, and before the distortion folds."""
        ...

    def rays(self, distorted: FloatArray) -> FloatArray:
        """(n, 3) unit directions with z forward; nan where no direction has such an image."""
        ...


@dataclass(frozen=True, eq=False)
class BrownConrady:
    """radial: (6,) k1 to k6, those from k4 on in the denominator. tangential: (2,) p1, p2.

    The model of OpenCV's ``cv2.projectPoints`` (D. C. Brown, "Decentering distortion of lenses",
    1966; the rational form of D. Claus and A. Fitzgibbon, 2005).
    """

    radial: FloatArray
    tangential: FloatArray

    def distorted(self, points_m: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._moved(points_m[:, :2] / points_m[:, 2:])

    def is_seen(self, points_m: FloatArray) -> BoolArray:
        ahead = points_m[:, 2] > 0.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plane = np.where(ahead[:, None], points_m[:, :2] / points_m[:, 2:], np.inf)
            return np.asarray(ahead & self._is_unfolded(plane))

    def rays(self, distorted: FloatArray) -> FloatArray:
        plane = self._start(distorted)
        for _ in range(_MOST_STEPS):
            step = self._newton_step(plane, distorted)
            plane = plane - step
            if not np.nanmax(np.abs(step), initial=0.0) > _WITHIN:
                break
        with np.errstate(invalid="ignore", over="ignore"):
            plane = np.where(self._is_unfolded(plane)[:, None], plane, np.nan)
        rays = np.column_stack([plane, np.ones(len(plane))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _moved(self, plane: FloatArray) -> FloatArray:
        x, y = plane.T
        p1, p2 = self.tangential
        squares = x * x + y * y
        gain = self._gain(squares)[0]
        return np.column_stack(
            [
                x * gain + 2.0 * p1 * x * y + p2 * (squares + 2.0 * x * x),
                y * gain + p1 * (squares + 2.0 * y * y) + 2.0 * p2 * x * y,
            ]
        )

    def _gain(self, squares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What multiplies the radius, and its derivative by the squared radius."""
        above, below = self._polynomials()
        high, low = np.polyval(above, squares), np.polyval(below, squares)
        slope = np.polyval(np.polyder(above), squares) - high / low * np.polyval(
            np.polyder(below), squares
        )
        return np.asarray(high / low), np.asarray(slope / low)

    def _polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator of the gain, in the squared radius, highest power first."""
        k1, k2, k3, k4, k5, k6 = self.radial
        return np.array([k3, k2, k1, 1.0]), np.array([k6, k5, k4, 1.0])

    def _jacobian(self, plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The derivatives xx, xy and yy of ``_moved``, which are symmetric."""
        x, y = plane.T
        p1, p2 = self.tangential
        gain, slope = self._gain(x * x + y * y)
        across = 2.0 * (x * y * slope + p1 * x + p2 * y)
        return (
            gain + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            across,
            gain + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        )

    def _newton_step(self, plane: FloatArray, distorted: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            xx, xy, yy = self._jacobian(plane)
            off_x, off_y = (self._moved(plane) - distorted).T
            step = np.column_stack([yy * off_x - xy * off_y, xx * off_y - xy * off_x])
            return np.asarray(step / (xx * yy - xy * xy)[:, None])

    def _is_unfolded(self, plane: FloatArray) -> BoolArray:
        xx, xy, yy = self._jacobian(plane)
        radii = np.hypot(plane[:, 0], plane[:, 1])
        return np.asarray((radii < self._fold_radius) & (xx * yy - xy * xy > 0.0) & (xx + yy > 0))

    @cached_property
    def _fold_radius(self) -> float:
        """The least radius at which a larger one does not lie farther out any more, or inf."""
        above, below = self._polynomials()
        turns: FloatArray = np.polysub(
            np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below))
        )
        slope = np.polyadd(np.polymul(above, below), np.polymul([2.0, 0.0], turns))
        return float(np.sqrt(min(_least_root(slope), _least_root(below))))

    def _start(self, distorted: FloatArray) -> FloatArray:
        """(n, 2) the radial distortion alone taken back, by a table."""
        radii = np.hypot(distorted[:, 0], distorted[:, 1])
        fold = min(self._fold_radius, _WIDEST)
        farthest, needed = min(1.0, fold), float(radii.max(initial=0.0))
        while farthest < fold and farthest * self._gain(np.array(farthest**2))[0] < needed:
            farthest = min(2.0 * farthest, fold)
        table = np.linspace(0.0, farthest, _TABLE, endpoint=False)
        undone = np.interp(radii, table * self._gain(table * table)[0], table)
        return np.asarray(distorted * (undone / np.where(radii > 0.0, radii, 1.0))[:, None])


@dataclass(frozen=True, eq=False)
class KannalaBrandt:
    """coefficients: (4,) k1 to k4 of the angle to the axis. Sees beyond 90 degrees.

    The model of ``cv2.fisheye`` (J. Kannala and S. Brandt, "A generic camera model and
    calibration method for conventional, wide-angle, and fish-eye lenses", 2006).
    """

    coefficients: FloatArray

    def distorted(self, points_m: FloatArray) -> FloatArray:
        across = np.hypot(points_m[:, 0], points_m[:, 1])
        radii = np.polyval(self._polynomial(), np.arctan2(across, points_m[:, 2]))
        # On the axis, where 0 is divided by 0, the image is the middle whatever the quotient.
        return np.asarray(points_m[:, :2] * (radii / np.where(across > 0.0, across, 1.0))[:, None])

    def is_seen(self, points_m: FloatArray) -> BoolArray:
        across = np.hypot(points_m[:, 0], points_m[:, 1])
        somewhere = (across > 0.0) | (points_m[:, 2] > 0.0)
        return np.asarray(somewhere & (np.arctan2(across, points_m[:, 2]) < self._fold_rad))

    def rays(self, distorted: FloatArray) -> FloatArray:
        radii = np.hypot(distorted[:, 0], distorted[:, 1])
        angles_rad = self._angles_rad(radii)
        toward = distorted / np.where(radii > 0.0, radii, 1.0)[:, None]
        return np.column_stack([toward * np.sin(angles_rad)[:, None], np.cos(angles_rad)])

    def _angles_rad(self, radii: FloatArray) -> FloatArray:
        """(n,) angles to the axis whose images lie so far from the middle; nan for none."""
        polynomial, fold_rad = self._polynomial(), self._fold_rad
        table_rad = np.linspace(0.0, fold_rad, _TABLE)
        angles_rad = np.interp(radii, np.polyval(polynomial, table_rad), table_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            for _ in range(_MOST_STEPS):
                off = np.polyval(polynomial, angles_rad) - radii
                step = off / np.polyval(np.polyder(polynomial), angles_rad)
                angles_rad = angles_rad - step
                if not np.nanmax(np.abs(step), initial=0.0) > _WITHIN:
                    break
            inside = (radii < np.polyval(polynomial, fold_rad)) & (angles_rad >= 0.0)
        return np.where(inside, angles_rad, np.nan)

    def _polynomial(self) -> FloatArray:
        """The radius by the angle, highest power first."""
        k1, k2, k3, k4 = self.coefficients
        return np.array([k4, 0.0, k3, 0.0, k2, 0.0, k1, 0.0, 1.0, 0.0])

    @cached_property
    def _fold_rad(self) -> float:
        """The least angle beyond which a larger one does not lie farther out; at most pi."""
        k1, k2, k3, k4 = self.coefficients
        slope = np.array([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        return min(float(np.sqrt(_least_root(slope))), float(np.pi))


def _least_root(polynomial: FloatArray) -> float:
    """The least positive real root, or inf, of a polynomial whose constant term is one."""
    inverses = np.roots(polynomial[::-1])
    real = inverses.real[np.abs(inverses.imag) <= 1e-12 * np.abs(inverses)]
    largest = float(real.max(initial=0.0))
    return 1.0 / largest if largest > _LEAST_INVERSE else np.inf
