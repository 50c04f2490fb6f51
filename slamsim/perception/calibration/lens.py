"""Lenses of cameras, and where those of a rig are to each other, from pictures of a board.

A first solution by OpenCV (Zhang 2000: A flexible new technique for camera calibration) or, of a
fisheye, from several focal lengths; then robust least squares over all images (``rig``), with
standard deviations by a jackknife over the views.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import COEFFICIENTS, CameraModel, pinhole
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import NoSolution, solving
from slamsim.perception.calibration.least_squares import Equations, solve
from slamsim.perception.calibration.mount import TooFew
from slamsim.perception.calibration.projection import lens_names
from slamsim.perception.calibration.rig import Rig, Sighting
from slamsim.perception.calibration.sightings import CornerMisfits

FEWEST_VIEWS = 8
"""For a jackknife; OpenCV's tutorial asks for ten."""
SAME_PX = 3.0
"""Views whose corners move by less in the mean are one and the same."""
ROUNDS = 3
FISHEYE_FOVS_DEG = (100.0, 140.0, 180.0, 220.0)
"""Across the image, from which fits begin: lenses that are sold lie between."""
COVERAGE_CELLS = (8, 6)


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """models: of the cameras. T_camera_first: (c, 4, 4), points of the first into each.

    covariance: (p, p) of all lenses, one after the other as ``lens_names`` has them, then of small
    steps of the places of all cameras but the first: m, then rad, about their own axes.
    residual_px: (c,) root mean square distance of corners, outliers included. views: (c,) images
    used. coverage: (c,) share of the image in which corners were seen. misfits: of each camera,
    by numbers of views.
    """

    models: tuple[CameraModel, ...]
    T_camera_first: FloatArray
    covariance: FloatArray
    residual_px: FloatArray
    views: tuple[int, ...]
    coverage: tuple[float, ...]
    misfits: tuple[CornerMisfits, ...]

    def lens_sigmas(self, camera: int) -> FloatArray:
        """(l,) standard deviations of one lens, as ``lens_names`` has them."""
        sizes = [len(lens_names(model)) for model in self.models]
        begin = sum(sizes[:camera])
        return np.sqrt(np.diag(self.covariance))[begin : begin + sizes[camera]]

    def place_sigmas(self, camera: int) -> FloatArray:
        """(6,) of where a camera but the first is."""
        begin = sum(len(lens_names(model)) for model in self.models) + 6 * (camera - 1)
        return np.sqrt(np.diag(self.covariance))[begin : begin + 6]


def fit_lens(
    sightings: Sequence[Sighting], size: tuple[int, int], distortion_model: str = "plumb_bob"
) -> LensFit:
    """The lens of one camera (number 0) with images of size (width, height).

    Raises TooFew, naming how many views are needed, and NoSolution.
    """
    used = _distinct(sightings)
    if len(used) < FEWEST_VIEWS:
        raise TooFew(
            f"the board was seen in {len(sightings)} images, of which {len(used)} differ from each "
            f"other; {FEWEST_VIEWS} are needed, from near and far, tilted, and up to the corners"
        )
    numbered = tuple(replace(each, view=k) for k, each in enumerate(used))
    starts = _starts(numbered, size, distortion_model)
    begun = [found for start in starts if (found := _begun(start)) is not None]
    best = _solved(min(begun, key=lambda pair: pair[1].cost)[0]) if begun else None
    if best is None:
        raise NoSolution(f"no {distortion_model} lens explains the images of the board")
    return _fit_of(*best)


def fit_pair(sightings: Sequence[Sighting], lenses: Sequence[LensFit]) -> LensFit:
    """Two cameras (numbers 0 and 1) that saw the board at the same instants, begun at their lenses.

    Raises TooFew, naming how many common views are needed, and NoSolution.
    """
    views = [{each.view for each in sightings if each.camera == camera} for camera in (0, 1)]
    common = sorted(views[0] & views[1])
    if len(common) < FEWEST_VIEWS:
        raise TooFew(
            f"both cameras saw the board in {len(common)} images of the same instant; "
            f"{FEWEST_VIEWS} are needed"
        )
    used = tuple(
        replace(each, view=common.index(each.view)) for each in sightings if each.view in common
    )
    models = tuple(lens.models[0] for lens in lenses)
    boards = [_poses([each for each in used if each.camera == k], models[k]) for k in (0, 1)]
    T_second_first = _middle(boards[1] @ np.linalg.inv(boards[0]))
    places = np.array([np.eye(4), T_second_first])
    noise_px = np.array([lens.residual_px[0] for lens in lenses]) / np.sqrt(2.0)
    found = _solved(Rig(used, models, places, boards[0], np.maximum(noise_px, 0.01)))
    if found is None:
        raise NoSolution("no place of the second camera explains the images of the board")
    return _fit_of(*found)


def _distinct(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Those that differ from all earlier ones."""
    kept: list[Sighting] = []
    for each in sightings:
        if all(_apart_px(each, other) > SAME_PX for other in kept):
            kept.append(each)
    return kept


def _apart_px(one: Sighting, other: Sighting) -> float:
    """By how much corners that both show moved, in the mean; inf where there are none."""
    same = (one.points_m[:, None] == other.points_m[None]).all(axis=2)
    here, there = np.nonzero(same)
    if not here.size:
        return np.inf
    return float(np.linalg.norm(one.pixels[here] - other.pixels[there], axis=1).mean())


def _starts(
    sightings: tuple[Sighting, ...], size: tuple[int, int], distortion_model: str
) -> list[Rig]:
    count = COEFFICIENTS[distortion_model]
    if distortion_model == "equidistant":
        models = [pinhole(*size, fov, distortion_model) for fov in FISHEYE_FOVS_DEG]
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if count == 8 else 0
        points = [each.points_m.astype(np.float32) for each in sightings]
        pixels = [each.pixels.astype(np.float32) for each in sightings]
        with solving("a first camera matrix"):
            K = np.asarray(cv2.initCameraMatrix2D(points, pixels, size), dtype=np.float64)
            flags |= cv2.CALIB_USE_INTRINSIC_GUESS
            _, found, told, _, _ = cv2.calibrateCamera(points, pixels, size, K, None, flags=flags)
        K, coefficients = np.asarray(found, np.float64), np.asarray(told, np.float64).ravel()
        models = [CameraModel(*size, K, distortion_model, coefficients[:count])]
    return [
        Rig(sightings, (model,), np.eye(4)[None], _poses(sightings, model), np.array([0.2]))
        for model in models
    ]


def _poses(sightings: Sequence[Sighting], model: CameraModel) -> FloatArray:
    """(v, 4, 4) T_camera_board of each view of one camera, in the order of the views."""
    found = np.tile(np.eye(4), (len(sightings), 1, 1))
    found[:, 2, 3] = 1.0
    for each in sightings:
        rays = model.rays_at(each.pixels)
        ahead = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.2)
        if np.count_nonzero(ahead) < 4:
            continue
        plane = rays[ahead, :2] / rays[ahead, 2:]
        ok, turn, shift = cv2.solvePnP(each.points_m[ahead], plane, np.eye(3), None)
        if ok:
            found[each.view, :3, :3] = Rotation.from_rotvec(np.ravel(turn)).as_matrix()
            found[each.view, :3, 3] = np.ravel(shift)
    return found


def _middle(T: FloatArray) -> FloatArray:
    """(4, 4) the median of transforms (n, 4, 4)."""
    found = np.eye(4)
    found[:3, 3] = np.median(T[:, :3, 3], axis=0)
    found[:3, :3] = Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix()
    return found


def _begun(rig: Rig) -> tuple[Rig, Equations] | None:
    """The nearest minimum, None if there is none."""
    with suppress(NoSolution, ValueError):
        return solve(rig)
    return None


def _solved(rig: Rig) -> tuple[Rig, Equations] | None:
    """None where it leads nowhere."""
    with suppress(NoSolution, ValueError):
        found = None
        for _ in range(ROUNDS):
            found = solve(rig)
            rig = found[0].learnt()
        return rig, rig.equations()
    return None


def _fit_of(rig: Rig, equations: Equations) -> LensFit:
    with solving("the uncertainty of a lens"):
        covariance = equations.covariance
        # By noise alone: views that all say the same contradict nothing, and tell nothing.
        by_noise = np.diag(np.linalg.inv(equations.information))
    stretch = np.sqrt(np.maximum(by_noise / np.diag(covariance), 1.0))
    cameras = range(len(rig.models))
    mine = [[each for each in rig.sightings if each.camera == camera] for camera in cameras]
    return LensFit(
        rig.models,
        rig.T_camera_first,
        np.outer(stretch, stretch) * covariance,
        np.array([np.sqrt(np.square(off_px).sum(axis=1).mean()) for off_px in rig.residuals]),
        tuple(map(len, mine)),
        tuple(map(_coverage, mine, rig.models)),
        tuple(map(_misfits, mine, rig.residuals)),
    )


def _misfits(sightings: Sequence[Sighting], off_px: FloatArray) -> CornerMisfits:
    counts = [len(each.pixels) for each in sightings]
    views = np.repeat(np.array([float(each.view) for each in sightings]), counts)
    return CornerMisfits(np.concatenate([each.pixels for each in sightings]), off_px, views)


def _coverage(sightings: Sequence[Sighting], model: CameraModel) -> float:
    """Share of the image's cells in which a corner was seen."""
    pixels = np.concatenate([each.pixels for each in sightings])
    columns, rows = COVERAGE_CELLS
    size = np.array([model.width / columns, model.height / rows])
    cells = np.clip(((pixels + 0.5) / size).astype(int), 0, [columns - 1, rows - 1])
    return len(np.unique(cells, axis=0)) / (columns * rows)
