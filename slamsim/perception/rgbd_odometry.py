"""Odometry of a depth camera: corners are followed from key frames, and give the motion since.

Each image is compared with all key frames whose corners are still seen, so that errors add up where
the last corner of one goes out of sight, not from image to image. Those that move as one rigid
scene (P3P in RANSAC) give the motion (``point_fit``). Rows of a rolling shutter are seen one after
the other; how long that takes is learnt from the turns of the camera (``readout``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.perception.corners import Keyframe, depths_at, late_of, rays_xy_at
from slamsim.perception.point_fit import FittedMotion, SeenPoints, fit_motion, misfit
from slamsim.perception.readout import Readout
from slamsim.perception.twist import (
    about_camera,
    exponential,
    logarithm,
    swept_points,
    turned_into,
)

RIGID_WITHIN_PX = 1.5
NEXT_KEYFRAME_SHARE = 0.8
"""A new key frame once fewer of the points that the last one began with are seen."""
MOST_ANCHORS = 6
"""Key frames with which an image is compared."""
LEAST_OF_ANCHOR = 8
LEAST_POINTS = 15
"""Fewer tell no motion: of twelve corners on posters, RANSAC made a motion by chance."""
LEAST_RIGID_SHARE, ENOUGH_RIGID = 0.4, 40
"""Of the points that were found again, so many must move as one: in noise alone some always do."""
WORST_SIGMA_M, WORST_SIGMA_RAD = 0.1, 0.1
"""A motion that is less sure between two key frames is refused."""

Status = Literal["started", "tracked", "lost"]


@dataclass(frozen=True, slots=True, eq=False)
class RgbdStep:
    """What one image told.

    T_odom_camera: (4, 4) from the optical frame now to that of the first image. keyframe: number
    of the last key frame before, and T_keyframe_camera (4, 4) the motion since, with covariance
    (6, 6) as ``FittedMotion``'s; None where it is lost. points: that tell it. starts: whether this
    image becomes the next key frame. Where lost, the camera is taken to move on as before, and
    nothing joins what follows to what was before.
    """

    stamp_ns: int
    T_odom_camera: FloatArray
    keyframe: int
    T_keyframe_camera: FloatArray
    covariance: FloatArray | None
    points: int
    status: Status
    starts: bool


class RgbdOdometry:
    """Image after image of one camera, depth aligned with brightness."""

    def __init__(self, model: CameraModel) -> None:
        self._model, self._focal_px = model, float(model.focal_px.mean())
        self._anchors: list[Keyframe] = []
        self._before: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
        self._T_odom_camera: FloatArray = np.eye(4)
        self._stamp_ns = self._keyframes = self._began_with = 0
        self._velocity = np.zeros(6)  # of points in the camera: metres and radians a second
        self.readout = Readout()

    @property
    def keyframe(self) -> Keyframe:
        """The last one; there is none before the first step."""
        return self._anchors[-1]

    @property
    def swept(self) -> FloatArray:
        """(6,) how points move in the camera while an image is read out, by what is known now."""
        return self.readout.seconds * self._velocity

    def step(self, stamp_ns: int, grey: NDArray[np.uint8], depth_m: Float32Array) -> RgbdStep:
        """The motion until grey (h, w) with depth_m (h, w) along z, nan or 0 for none.

        Raises BadNumbers for images of another size than the camera's.
        """
        self._require_images(grey, depth_m)
        nothing, seconds = np.zeros((6, 6)), max(1e-9 * (stamp_ns - self._stamp_ns), 1e-3)
        before, self._before, self._stamp_ns = self._before, grey, stamp_ns
        if not self._anchors:
            self._begin(grey, depth_m, nothing)
            return RgbdStep(stamp_ns, np.eye(4), 0, np.eye(4), nothing, 0, "started", True)
        last = self.keyframe
        fitted, points = self._moved(before, grey, depth_m, seconds)
        covariance, own = None, nothing
        if fitted is not None:
            T = fitted.T_now_keyframe
            covariance = fitted.covariance + turned_into(T, last.own)
            own = about_camera(T, fitted.covariance)
        self._move_on(fitted, seconds)
        starts = fitted is None or points < NEXT_KEYFRAME_SHARE * self._began_with
        if starts:
            self._begin(grey, depth_m, own)
        return RgbdStep(
            stamp_ns,
            self._T_odom_camera.copy(),
            last.number,
            np.asarray(np.linalg.inv(last.T_odom_camera) @ self._T_odom_camera),
            covariance,
            points,
            "lost" if fitted is None else "tracked",
            starts,
        )

    def _require_images(self, grey: NDArray[np.uint8], depth_m: Float32Array) -> None:
        size = (self._model.height, self._model.width)
        if grey.shape != size or grey.dtype != np.uint8 or depth_m.shape != size:
            raise BadNumbers(
                f"images of {grey.shape} {grey.dtype} and {depth_m.shape} are none of a camera "
                f"of {size}, uint8 and metres"
            )

    def _move_on(self, fitted: FittedMotion | None, seconds: float) -> None:
        """To where the fit has the camera; without one, as fast as since the image before."""
        T_camera_before = exponential(seconds * self._velocity)
        if fitted is not None:
            T_camera_odom = fitted.T_now_keyframe @ np.linalg.inv(self.keyframe.T_odom_camera)
            T_camera_before = T_camera_odom @ self._T_odom_camera
            self._velocity = logarithm(T_camera_before) / seconds
        else:
            self._anchors = []
        self._T_odom_camera = self._T_odom_camera @ np.linalg.inv(T_camera_before)

    def _begin(self, grey: NDArray[np.uint8], depth_m: Float32Array, own: FloatArray) -> None:
        """Make the image the next key frame; own: its covariance."""
        seen = [one for one in self._anchors if len(one.followed) >= LEAST_OF_ANCHOR]
        self._anchors = seen[-(MOST_ANCHORS - 1) :]
        taken_px = [np.zeros((0, 2), dtype=np.float32), *(one.last_px for one in self._anchors)]
        keyframe = Keyframe(self._keyframes, self._T_odom_camera.copy(), own, grey)
        keyframe.mark(self._model, depth_m, np.concatenate(taken_px), self.swept)
        self._anchors.append(keyframe)
        self._keyframes += 1
        self._began_with = sum(len(one.followed) for one in self._anchors)

    def _moved(
        self, before: NDArray[np.uint8], grey: NDArray[np.uint8], depth_m: Float32Array, s: float
    ) -> tuple[FittedMotion | None, int]:
        """The motion since the last key frame, s seconds after the image before; None if it cannot
        be told; and of how many points."""
        T_now_odom = exponential(s * self._velocity) @ np.linalg.inv(self._T_odom_camera)
        for one in self._anchors:
            one.follow(before, grey, self._model, T_now_odom)
        seen = self._seen(depth_m)
        guess = T_now_odom @ self.keyframe.T_odom_camera
        guess, rigid = self._rigid(seen, guess)
        fitted: FittedMotion | None = None
        if _are_enough(rigid):
            fitted, rigid = self._fitted(seen, guess, rigid, s)
        self._keep(rigid)
        return fitted, int(np.count_nonzero(rigid))

    def _seen(self, depth_m: Float32Array) -> SeenPoints:
        """All followed points, in the frame of the last key frame."""
        T_last_odom, points = np.linalg.inv(self.keyframe.T_odom_camera), []
        for one in self._anchors:
            T_last_one = T_last_odom @ one.T_odom_camera
            points.append(one.points_m[one.followed] @ T_last_one[:3, :3].T + T_last_one[:3, 3])
        pixels = np.concatenate([one.last_px for one in self._anchors])
        return SeenPoints(
            np.concatenate(points),
            rays_xy_at(self._model, pixels),
            depths_at(depth_m, pixels),
            late_of(self._model, pixels),
            np.concatenate([one.vague[one.followed] for one in self._anchors]),
        )

    def _rigid(self, seen: SeenPoints, guess: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(4, 4) motion of most points, and (n,) which; guess: where the camera should be by now,
        which tells how far points move while the image is read out."""
        fine: BoolArray = np.asarray(np.isfinite(seen.rays_xy).all(axis=1))
        if np.count_nonzero(fine) < LEAST_POINTS:
            return guess, np.zeros(len(seen), dtype=np.bool_)
        there = seen.points_m @ guess[:3, :3].T + guess[:3, 3]
        late = swept_points(there, seen.late, self.swept)
        shift = late[:, :2] / late[:, 2:] - there[:, :2] / there[:, 2:]
        chosen = seen.those(fine)
        found, inside = rigid_motion(chosen.points_m, chosen.rays_xy - shift[fine], self._focal_px)
        fine[fine] = inside
        # In noise alone, some always move as one.
        if np.count_nonzero(inside) < LEAST_RIGID_SHARE * min(len(inside), ENOUGH_RIGID):
            fine[:] = False
        return found, fine

    def _fitted(
        self, seen: SeenPoints, guess: FloatArray, rigid: BoolArray, seconds: float
    ) -> tuple[FittedMotion | None, BoolArray]:
        """The motion, None where it is unsure, and (n,) which points tell it."""
        T_keyframe_before = np.linalg.inv(self.keyframe.T_odom_camera) @ self._T_odom_camera
        fitted: FittedMotion | None = None
        try:
            for _ in range(2):
                velocity = logarithm(guess @ T_keyframe_before) / seconds
                swept = self.readout.seconds * velocity
                fitted = fit_motion(guess, seen.those(rigid), self._focal_px, swept)
                guess = fitted.T_now_keyframe
                off_px = self._focal_px * np.linalg.norm(misfit(guess, seen, swept)[0], axis=1)
                rigid = np.nan_to_num(off_px, nan=np.inf) < RIGID_WITHIN_PX
                if not _are_enough(rigid):
                    return None, rigid
            assert fitted is not None
            if not _is_sure(fitted):
                return None, rigid
            sigma = fitted.pixel_sigma / self._focal_px
            self.readout.learn(guess, seen.those(rigid), velocity, sigma)
        except np.linalg.LinAlgError:
            return None, rigid
        return fitted, rigid

    def _keep(self, rigid: BoolArray) -> None:
        """Follow only these of all points."""
        ends = np.cumsum([len(one.followed) for one in self._anchors])
        for one, chosen in zip(self._anchors, np.split(rigid, ends[:-1]), strict=True):
            one.keep(np.flatnonzero(chosen))


def rigid_motion(
    points_m: FloatArray,
    rays_xy: FloatArray,
    focal_px: float,
    within_px: float = RIGID_WITHIN_PX,
) -> tuple[FloatArray, BoolArray]:
    """(4, 4) T_now_keyframe of most points (n, 3), seen at rays (n, 2), and (n,) which it explains.

    The same points give the same motion.
    """
    cv2.setRNGSeed(0)
    done, turn, shift, inliers = cv2.solvePnPRansac(
        points_m,
        focal_px * rays_xy,
        np.diag([focal_px, focal_px, 1.0]),
        None,
        iterationsCount=100,
        reprojectionError=within_px,
        confidence=0.999,
    )
    rigid = np.zeros(len(points_m), dtype=np.bool_)
    if not done or inliers is None:
        return np.eye(4), rigid
    rigid[np.ravel(inliers)] = True
    R = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    return se3_from_parts(R, np.ravel(shift)), rigid


def _are_enough(chosen: BoolArray | Sequence[bool]) -> bool:
    return int(np.count_nonzero(chosen)) >= LEAST_POINTS


def _is_sure(fitted: FittedMotion) -> bool:
    variances = np.diag(fitted.covariance)
    if not np.isfinite(fitted.T_now_keyframe).all() or not (variances > 0.0).all():
        return False
    sigmas = np.sqrt(variances)
    return bool(sigmas[:3].max() < WORST_SIGMA_M and sigmas[3:].max() < WORST_SIGMA_RAD)
