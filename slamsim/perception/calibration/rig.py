"""One camera, or several that are fixed to each other, before a board: equations of a fit.

A corner is seen where ``model.project(T_camera_first T_first_board corner)`` is. The board's pose
of each view is eliminated, so that lenses and places of the cameras alone are left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import CameraModel
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import solving
from slamsim.perception.calibration.least_squares import Equations, weigh
from slamsim.perception.calibration.projection import (
    lens_names,
    lens_slopes,
    project_slopes,
    rigid_slopes,
    with_lens,
)

FOCAL_SIGMA_PX, DISTORTION_SIGMA, PLACE_SIGMA = 1e4, 10.0, 10.0
"""What is known of lenses and places (m, rad) beforehand: next to nothing."""
LEAST_NOISE_PX = 0.01
"""Corners on perfect images: what is claimed is never more exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Corners of the board in one image: points_m (k, 3) of the board at pixels (k, 2).

    view: number of the instant; camera: which of the rig.
    """

    view: int
    camera: int
    points_m: FloatArray
    pixels: FloatArray


@dataclass(frozen=True, eq=False)
class Rig:
    """Values and data; a ``Problem``. T_camera_first: (c, 4, 4), the identity for the first.
    T_first_board: (v, 4, 4) of each view. noise_px: (c,) standard deviation of a corner."""

    sightings: tuple[Sighting, ...]
    models: tuple[CameraModel, ...]
    T_camera_first: FloatArray
    T_first_board: FloatArray
    noise_px: FloatArray

    @property
    def sizes(self) -> tuple[int, ...]:
        """How many numbers each lens has; the places of all but the first camera follow them."""
        return tuple(len(lens_names(model)) for model in self.models)

    @cached_property
    def _corners(self) -> tuple[tuple[IntArray, FloatArray, FloatArray], ...]:
        """Of each camera all corners: (k,) view, (k, 3) points of the board, (k, 2) pixels."""
        found = []
        for camera in range(len(self.models)):
            mine = [each for each in self.sightings if each.camera == camera]
            views = np.repeat([each.view for each in mine], [len(each.pixels) for each in mine])
            points_m = np.concatenate([each.points_m for each in mine])
            found.append((views, points_m, np.concatenate([each.pixels for each in mine])))
        return tuple(found)

    @cached_property
    def residuals(self) -> tuple[FloatArray, ...]:
        """(k, 2) of each camera: corners as they should be seen less those seen, px."""
        found = []
        for camera, model in enumerate(self.models):
            pixels, seen = model.project(self._points(camera)[1])
            off_px = pixels - self._corners[camera][2]
            found.append(np.where(seen[:, None], off_px, float(model.width)))
        return tuple(found)

    def equations(self) -> Equations:
        gained, gradients = [], []
        for shared, mixed, own, gradient, own_gradient in self._views:
            with solving("the pose of a board"):
                by_own = np.linalg.solve(own, np.column_stack([mixed.T, own_gradient]))
            gained.append(shared - mixed @ by_own[:, :-1])
            gradients.append(gradient - mixed @ by_own[:, -1])
        weighed = zip(self.residuals, self.noise_px, strict=True)
        cost = sum(weigh(off_px / noise_px)[1] for off_px, noise_px in weighed)
        priors = self._prior_sigmas()
        return Equations(np.array(gained), np.array(gradients), cost, priors, np.zeros(len(priors)))

    def moved(self, step: FloatArray) -> Rig:
        bounds = np.cumsum([0, *self.sizes])
        lenses = [step[a:b] for a, b in pairwise(bounds.tolist())]
        models = tuple(map(with_lens, self.models, lenses))
        places = np.concatenate([np.zeros((1, 6)), step[bounds[-1] :].reshape(-1, 6)])
        boards = np.array(
            [-np.linalg.solve(own, g + mixed.T @ step) for _, mixed, own, _, g in self._views]
        )
        return replace(
            self,
            models=models,
            T_camera_first=_stepped(self.T_camera_first, places),
            T_first_board=_stepped(self.T_first_board, boards),
        )

    def learnt(self) -> Rig:
        """With the noise of each camera as the residuals have it."""
        typical_px = [
            SIGMAS_PER_MEDIAN * float(np.median(np.abs(off_px))) for off_px in self.residuals
        ]
        return replace(self, noise_px=np.maximum(typical_px, LEAST_NOISE_PX))

    @cached_property
    def _views(self) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Of each view the equations of what is shared (s, s), mixed (s, 6) and of the board's pose
        (6, 6), and their gradients (s,) and (6,)."""
        size = sum(self.sizes) + 6 * (len(self.models) - 1)
        whole = np.zeros((len(self.T_first_board), size + 6, size + 7))
        for camera, noise_px in enumerate(self.noise_px):
            unit = self.residuals[camera] / noise_px
            roots = np.sqrt(weigh(unit)[0])[:, None]
            slopes = self._slopes(camera, size) * (roots / noise_px)[..., None]
            views = self._corners[camera][0]
            for view in np.unique(views):
                rows = slopes[views == view].reshape(-1, size + 6)
                whole[view, :, :-1] += rows.T @ rows
                whole[view, :, -1] += rows.T @ (unit * roots)[views == view].ravel()
        s = size
        return [(w[:s, :s], w[:s, s:-1], w[s:, s:-1], w[:s, -1], w[s:, -1]) for w in whole]

    def _points(self, camera: int) -> tuple[FloatArray, FloatArray]:
        """(k, 3) corners in the first camera and in the one that saw them."""
        views, points_m, _ = self._corners[camera]
        T_first_board, T = self.T_first_board[views], self.T_camera_first[camera]
        in_first = np.einsum("nij,nj->ni", T_first_board[:, :3, :3], points_m)
        in_first += T_first_board[:, :3, 3]
        return in_first, in_first @ T[:3, :3].T + T[:3, 3]

    def _slopes(self, camera: int, size: int) -> FloatArray:
        """(k, 2, size + 6)."""
        in_first, in_camera = self._points(camera)
        model, T = self.models[camera], self.T_camera_first[camera]
        by_point = np.nan_to_num(project_slopes(model, in_camera))
        found = np.zeros((len(in_camera), 2, size + 6))
        begin = sum(self.sizes[:camera])
        lens = lens_slopes(model, in_camera, range(self.sizes[camera]))
        found[:, :, begin : begin + self.sizes[camera]] = lens
        if camera:
            place = sum(self.sizes) + 6 * (camera - 1)
            found[:, :, place : place + 6] = by_point @ rigid_slopes(in_camera - T[:3, 3])
        away = in_first - self.T_first_board[self._corners[camera][0], :3, 3]
        found[:, :, size:] = by_point @ T[:3, :3] @ rigid_slopes(away)
        return found

    def _prior_sigmas(self) -> FloatArray:
        lenses = [
            FOCAL_SIGMA_PX if k < 4 else DISTORTION_SIGMA
            for size in self.sizes
            for k in range(size)
        ]
        return np.array([*lenses, *[PLACE_SIGMA] * (6 * (len(self.models) - 1))])


def _stepped(T: FloatArray, steps: FloatArray) -> FloatArray:
    """(n, 4, 4) after displacements and turns (n, 6) about their own origins."""
    found = T.copy()
    found[:, :3, 3] += steps[:, :3]
    found[:, :3, :3] = Rotation.from_rotvec(steps[:, 3:]).as_matrix() @ T[:, :3, :3]
    return found
