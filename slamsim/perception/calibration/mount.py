"""Where a camera sits on a robot, how late its clock is, and its lens, from tags along a path.

Places of the tags are fitted too, so they need no survey; a survey tells the camera's height, which
a path in the plane does not. Errors of the path count as part of the noise: how large they are is
learnt from the residuals. Standard deviations are those of a jackknife over two seconds each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import se3_from_se2
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory
from slamsim.guard.numbers import BadNumbers, NoSolution, solving
from slamsim.perception.calibration.drive import CLOCK, MOUNT, Drive
from slamsim.perception.calibration.hand_eye import mount_by_motions
from slamsim.perception.calibration.least_squares import FEWEST_BLOCKS, Equations, solve
from slamsim.perception.calibration.path import SmoothPath
from slamsim.perception.calibration.projection import LENS
from slamsim.perception.calibration.sightings import CornerMisfits, TagViews
from slamsim.perception.calibration.survey import Survey

FEWEST_OF_A_TAG = 4
"""Sightings; a tag that is seen less tells nothing that its own place does not explain."""
FEWEST_SIGHTINGS = 40
MOST_TO_START = 300
TRIED_PLACES = 12
"""Sightings of a tag from which its place is taken to begin with; the one that fits the others."""
USUAL_M = 0.4
"""Height of a camera of which nothing is known: no drive in the plane tells it."""
MOST_DOUBTED = 0.25
"""Share of sightings beyond which a fit explains nothing: of 300 under wrong numbers, a tenth."""
MOST_PATH_M = 0.1
"""What a path may be off by where tags are seen, for corners to tell a mount beside it."""
ROUNDS = 3
"""In which the errors of the path are learnt; the third changes them by less than a tenth."""
ALL_LENS = frozenset(LENS)
USUAL_FREE = frozenset((*MOUNT, *CLOCK))


class TooFew(BadNumbers):
    """Not enough was seen for a calibration; the message says how much, and how much is needed."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Values by their names in steps from where the fit began, see ``MountFit``. covariance:
    (p, p) of them in the order of names."""

    names: tuple[str, ...]
    covariance: FloatArray

    def sigma(self, name: str) -> float:
        """The standard deviation of one of them, in its unit."""
        place = self.names.index(name)
        return float(np.sqrt(self.covariance[place, place]))


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """T_base_camera: (4, 4) of the optical frame. late_s: stamp of an image less when its first row
    was exposed, on the path's clock. readout_s: from the first row to the last. model: the lens.

    estimate: covariance of small steps of these: x, y, z of the camera and turns about the axes of
    the base, then clock, then lens. T_map_tag: by number. sightings: used; doubted: of these, those
    that count for less than half. residual_px: root mean square of a coordinate of a corner.
    path_sigmas: (5,) what the path is found to be off by, as ``Drive.path_sigmas``. misfits: of all
    corners, over time.
    """

    T_base_camera: FloatArray
    late_s: float
    readout_s: float
    model: CameraModel
    estimate: Estimate
    T_map_tag: Mapping[int, FloatArray]
    sightings: int
    doubted: int
    residual_px: float
    path_sigmas: FloatArray
    misfits: CornerMisfits

    def sigma(self, name: str) -> float:
        """Of one of ``MOUNT``, ``CLOCK``, ``LENS``, or d0, d1 ... of the distortion."""
        return self.estimate.sigma(name)

    @property
    def explains(self) -> bool:
        """Whether it says where the tags were seen, or is but the best of what does not."""
        few = self.doubted <= MOST_DOUBTED * self.sightings
        return few and bool(self.path_sigmas[:2].max() <= MOST_PATH_M)

    def moved_from(self, T_base_claimed: FloatArray) -> FloatArray:
        """(6,) the step from a claimed mount (4, 4) to this one, in the order of ``MOUNT``."""
        turn = self.T_base_camera[:3, :3] @ T_base_claimed[:3, :3].T
        shift = self.T_base_camera[:3, 3] - T_base_claimed[:3, 3]
        return np.concatenate([shift, Rotation.from_matrix(turn).as_rotvec()])


def fit_mount(
    views: TagViews,
    model: CameraModel,
    trajectory: PlanarTrajectory,
    T_base_camera: FloatArray,
    *,
    free: frozenset[str] = USUAL_FREE,
    late_s: float = 0.0,
    readout_s: float = 0.0,
    survey: Mapping[int, tuple[FloatArray, FloatArray]] | None = None,
) -> MountFit:
    """The mount that explains best where tags were seen along a trajectory (T_map_base).

    model, T_base_camera (4, 4), late_s, readout_s: to begin with, and what is held of them: all
    that free does not name (``MOUNT``, ``CLOCK``, ``LENS``, d0 ...). survey: T_survey_tag (4, 4)
    and standard deviations (6,), m and rad, of tags by their numbers. Raises TooFew, naming how
    many are needed, and NoSolution.
    """
    path = SmoothPath(trajectory)
    used = _usable(views, path)
    numbers, tag_of = np.unique(used.numbers, return_inverse=True)
    drive = Drive(
        used, path, tag_of, model, T_base_camera, late_s, readout_s, np.zeros((0, 4, 4)), free
    )
    drive = replace(drive, T_map_tag=_first_places(drive, len(numbers)))
    with solving("the mount of a camera"):
        drive = _approached(_surveyed(drive, numbers.tolist(), survey or {}))
        for _ in range(ROUNDS):
            drive = replace(drive, path_sigmas=drive.path_errors())
            drive, equations = solve(drive)
    return _fit_of(drive, equations, numbers)


def _fit_of(drive: Drive, equations: Equations, numbers: IntArray) -> MountFit:
    count, weights = len(drive.names), drive.weights()
    with solving("the uncertainty of a calibration"):
        covariance = equations.covariance[:count, :count]
    off_px = drive.residuals()
    squares = weights @ np.square(off_px).mean(axis=1)
    since_s = drive.path.seconds(drive.views.stamps_ns)
    assert drive.path_sigmas is not None
    return MountFit(
        drive.T_base_camera,
        drive.late_s,
        drive.readout_s,
        drive.model,
        Estimate(drive.names, covariance),
        dict(zip(numbers.tolist(), drive.T_map_tag, strict=True)),
        sightings=len(drive.views),
        doubted=int(np.count_nonzero(weights < 0.5)),
        residual_px=float(np.sqrt(squares / weights.sum())),
        path_sigmas=drive.path_sigmas,
        misfits=CornerMisfits(
            drive.views.corners_px.reshape(-1, 2), off_px.reshape(-1, 2), np.repeat(since_s, 4)
        ),
    )


def best_start(
    views: TagViews,
    model: CameraModel,
    trajectory: PlanarTrajectory,
    starts: Sequence[FloatArray],
) -> FloatArray:
    """(4, 4) the mount that explains most of the sightings, sought from several ones (4, 4) and
    from that which motions alone tell (``mount_by_motions``).

    For cameras of which nothing is claimed, or perhaps something wrong by more than some 40
    degrees. Raises TooFew as ``fit_mount``, and NoSolution where no start leads anywhere, or there
    is none.
    """
    path = SmoothPath(trajectory)
    used = _usable(views, path)
    height_m = float(starts[0][2, 3]) if starts else USUAL_M
    try:
        starts = [*starts, mount_by_motions(used, path, height_m)]
    except NoSolution:
        if not starts:
            raise
    used = used.those(np.arange(0, len(used), max(1, len(used) // MOST_TO_START)))
    numbers, tag_of = np.unique(used.numbers, return_inverse=True)
    found = []
    for start in starts:
        nowhere = np.zeros((0, 4, 4))
        drive = Drive(used, path, tag_of, model, start, 0.0, 0.0, nowhere, USUAL_FREE)
        drive = replace(drive, T_map_tag=_first_places(drive, len(numbers)))
        with suppress(NoSolution), solving("the mount of a camera"):
            found.append(_approached(drive))
    if not found:
        raise NoSolution("no mount of the camera explains where it saw the tags")
    return min(found, key=_misfit).T_base_camera


def _usable(views: TagViews, path: SmoothPath) -> TagViews:
    """Those at times that the path covers, of tags that are seen often. Raises TooFew."""
    on_path = views.those(path.covers(path.seconds(views.stamps_ns)))
    found, counts = np.unique(on_path.numbers, return_counts=True)
    often = found[counts >= FEWEST_OF_A_TAG]
    used = on_path.those(np.isin(on_path.numbers, often))
    if len(used) < FEWEST_SIGHTINGS:
        raise TooFew(
            f"tags were seen {len(used)} times along the path, of {len(views)} in all; "
            f"{FEWEST_SIGHTINGS} times are needed"
        )
    pieces = Drive.pieces(path.seconds(used.stamps_ns))
    if len(np.unique(pieces)) < FEWEST_BLOCKS:
        raise TooFew(
            f"tags were seen in {len(np.unique(pieces))} spells of two seconds; {FEWEST_BLOCKS} "
            "are needed"
        )
    return used


def _first_places(drive: Drive, count: int) -> FloatArray:
    """(count, 4, 4) T_map_tag: what one sighting tells, that which fits the tag's others best."""
    stamps_s = drive.path.seconds(drive.views.stamps_ns) - drive.late_s
    poses, _ = drive.path.at(stamps_s)
    T_map_camera = se3_from_se2(poses) @ drive.T_base_camera
    told = T_map_camera[:, None] @ drive.views.T_camera_tag  # (n, 2, 4, 4)
    places = np.zeros((count, 4, 4))
    for tag in range(count):
        mine = np.flatnonzero(drive.tag_of == tag)
        tried = mine[np.unique(np.linspace(0, len(mine) - 1, TRIED_PLACES).astype(int))]
        own = replace(drive, views=drive.views.those(mine), tag_of=np.zeros(len(mine), np.int64))
        candidates = told[tried].reshape(-1, 4, 4)
        misfits = [_misfit(replace(own, T_map_tag=place[None])) for place in candidates]
        places[tag] = candidates[int(np.argmin(misfits))]
    return places


def _misfit(drive: Drive) -> float:
    return float(np.median(np.abs(drive.residuals())))


def _surveyed(
    drive: Drive, numbers: Sequence[int], survey: Mapping[int, tuple[FloatArray, FloatArray]]
) -> Drive:
    """With what a survey says of its tags, put where the first of them has it."""
    if not set(numbers) & set(survey):
        return drive
    nothing = (np.eye(4), np.full(6, np.inf))
    told = [survey.get(number, nothing) for number in numbers]
    places, sigmas = np.array([each[0] for each in told]), np.array([each[1] for each in told])
    known = np.flatnonzero(np.isfinite(sigmas).all(axis=1))
    shifts = _planar_fit(drive.T_map_tag[known], places[known])
    return replace(
        drive,
        survey=Survey(places, sigmas),
        T_survey_map=shifts,
        free=drive.free | {"survey_x_m", "survey_y_m", "survey_yaw_rad"},
    )


def _planar_fit(T_map_tag: FloatArray, T_survey_tag: FloatArray) -> FloatArray:
    """(3,) T_survey_map by the first tag's pose, or by the middles of several."""
    here, there = T_map_tag[:, :2, 3], T_survey_tag[:, :2, 3]
    turned = T_survey_tag[:, :3, :3] @ np.swapaxes(T_map_tag[:, :3, :3], 1, 2)
    yaw = float(np.arctan2((turned[:, 1, 0]).sum(), turned[:, 0, 0].sum()))
    cos, sin = np.cos(yaw), np.sin(yaw)
    shift = there - here @ np.array([[cos, sin], [-sin, cos]])
    return np.array([*np.median(shift, axis=0), yaw])


def _approached(drive: Drive) -> Drive:
    """First with errors of any size, then of the size that is left, until that stays."""
    for _ in range(4):
        squares = np.square(drive.unit_residuals()).mean(axis=1)
        drive = replace(drive, scale=max(1.0, float(np.median(squares))))
        drive, _ = solve(drive)
        if drive.scale == 1.0:
            break
    return replace(drive, scale=1.0)
