"""Localising in a finished map: SLAM that goes on with it while its key frames are held fixed.

New ground is mapped as anywhere, a robot that was carried is found again by the same search, and
what joins a drive to the map are the same closures that join two drives. What is told of each scan
is decided at the end, when all of them are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from scipy.spatial import cKDTree

from slamsim.config.slam import SlamConfig
from slamsim.core.components import components
from slamsim.core.geometry import transform_points
from slamsim.core.progress import Progress, silent
from slamsim.core.result import SlamResult
from slamsim.core.types import BoolArray, FloatArray, IntArray, Log, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.slam.closures.submaps import sample_surfaces
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.mapping.saved_map import SavedMap
from slamsim.slam.session import map_log

State = Literal["placed", "odometry", "unknown"]
"""placed: what was seen lies on the map, where the robot surely is. odometry: the map does not show
what was seen; the robot was followed there by its own scans and odometry, as surely as the
covariance tells. unknown: nothing tells where in the map the robot was."""

STATES: tuple[State, ...] = get_args(State)
PLACED, FOLLOWED, UNKNOWN = range(3)

ON_MAP_M = 0.15
"""What is farther from all surfaces of the map is no part of it: beyond three times the error of
the poses of real maps. A robot less sure of its place than this is not placed by its scans."""

ON_MAP_SHARE = 0.5
"""Of what was seen must lie on the map: most of it. In the offices of fr079, of places that the map
does not show 0 to 0.4 does by chance, of those that it shows 0.8 and more."""


@dataclass(frozen=True, slots=True, eq=False)
class Localised:
    """What became of a drive in a finished map.

    stamps_ns, states: (n,) of all tracked scans, as numbers of STATES. poses: (n, 3) T_map_base,
    nan where unknown. covariances: (n, 3, 3) of a small step of the base in its own frame relative
    to the map, inf where unknown. slam: the drive as SLAM has it, with all events.
    """

    stamps_ns: IntArray
    states: IntArray
    poses: FloatArray
    covariances: FloatArray
    slam: SlamResult

    @property
    def known(self) -> BoolArray:
        """(n,) whether anything tells where the robot was."""
        return np.not_equal(self.states, UNKNOWN)

    @property
    def trajectory(self) -> PlanarTrajectory:
        """``T_map_base`` at the scans of which it is known."""
        return PlanarTrajectory(self.stamps_ns[self.known], self.poses[self.known])

    def spans(self) -> list[tuple[int, int, int]]:
        """(state, first scan, last scan) of scans one after the other of which the same holds."""
        changes = np.flatnonzero(np.diff(self.states)) + 1
        bounds = [0, *changes.tolist(), len(self.states)]
        return [(int(self.states[first]), first, end - 1) for first, end in pairwise(bounds)]


class NotPlaced(SlamsimError):
    """Nothing of a drive could be placed in a map."""


def localise_log(
    log: Log,
    config: SlamConfig,
    known: SavedMap,
    start: FloatArray | None = None,
    progress: Progress = silent,
) -> Localised:
    """Where a log was driven in a map that stays as it is.

    start: (3,) T_map_base at the first scan, give or take half a metre; without it, and where it
    proves wrong, the robot finds itself. Raises NotPlaced if nothing of the log is in the map.
    """
    slam, whole = map_log(log, config, progress, known, start, fixed=True)
    stamps_ns, held = slam.trajectory.stamps_ns, len(known)
    of_keyframes = _states_of_keyframes(whole, held, slam.graph.covariances)
    if not (of_keyframes == PLACED).any():
        raise NotPlaced(
            f"none of the {len(stamps_ns)} scans could be placed in the map: does it show where "
            f"this was recorded, and that place alone?{''.join(f' {one}' for one in slam.failed)}"
        )
    states, nearest = _states_of_scans(slam, of_keyframes)
    unknown = (states == UNKNOWN)[:, None]
    poses = np.where(unknown, np.nan, slam.trajectory.poses)
    covariances = np.where(unknown[..., None], np.inf, slam.graph.covariances[nearest])
    return Localised(stamps_ns, states, poses, covariances, slam)


def _states_of_keyframes(whole: SavedMap, held: int, covariances: FloatArray) -> IntArray:
    """(n,) of the key frames from number ``held`` on; covariances: (n, 3, 3) of these."""
    new = list(zip(whole.keyframes, whole.poses, strict=True))[held:]
    surfaces = cKDTree(
        np.concatenate(
            [_seen_m(*one) for one in zip(whole.keyframes[:held], whole.poses, strict=False)]
        )
    )
    sure = np.trace(covariances[:, :2, :2], axis1=1, axis2=2) <= ON_MAP_M**2
    on_map = np.array([_share_beside(surfaces, _seen_m(*one)) for one in new]) >= ON_MAP_SHARE
    states = np.where(sure & on_map, PLACED, FOLLOWED)
    states[~_joined_to_map(whole, held)] = UNKNOWN
    return states


def _seen_m(keyframe: Keyframe, T_map_base: FloatArray) -> FloatArray:
    """(p, 2) along the surfaces of its view, in the map frame."""
    return transform_points(T_map_base, sample_surfaces(keyframe.view.astype(np.float64)))


def _share_beside(surfaces: cKDTree, points_m: FloatArray) -> float:
    if not len(points_m):
        return 0.0
    distance_m, _ = surfaces.query(points_m, distance_upper_bound=ON_MAP_M)
    return float(np.isfinite(distance_m).mean())


def _joined_to_map(whole: SavedMap, held: int) -> BoolArray:
    """(n,) whether matches, odometry and closures lead from the map to each later key frame."""
    count = len(whole)
    followed = [k.index for k in whole.keyframes[1:] if k.index < held or not k.kidnapped]
    ends = [(number - 1, number) for number in followed]
    ends += [(edge.source, edge.target) for edge in whole.closures]
    part = components(np.array(ends, dtype=np.int64).reshape(-1, 2), count)
    return np.asarray(part[held:] == part[0])


def _states_of_scans(slam: SlamResult, of_keyframes: IntArray) -> tuple[IntArray, IntArray]:
    """(n,) states of all scans, and (n,) the nearest key frame of each.

    A scan is as well known as the worse of the key frames before and after it; the robot was not
    carried between the three.
    """
    stamps_ns, keyframes_ns = slam.trajectory.stamps_ns, slam.graph.keyframes.stamps_ns
    last = len(keyframes_ns) - 1
    after = np.searchsorted(keyframes_ns, stamps_ns)
    before, after = np.maximum(after - 1, 0), np.minimum(after, last)
    breaks_ns = np.array([e.start_ns for e in slam.events if e.kind == "kidnapped"], dtype=np.int64)
    piece, of_keyframe = (
        np.searchsorted(breaks_ns, at, side="right") for at in (stamps_ns, keyframes_ns)
    )
    before = np.where(of_keyframe[before] == piece, before, after)
    after = np.where(of_keyframe[after] == piece, after, before)
    states = np.maximum(of_keyframes[before], of_keyframes[after])
    states = np.where(of_keyframe[before] == piece, states, UNKNOWN)
    matched = (slam.match_quality > 0.0) | np.isin(stamps_ns, keyframes_ns)
    later = np.abs(keyframes_ns[after] - stamps_ns) < np.abs(keyframes_ns[before] - stamps_ns)
    return np.where(matched, states, np.maximum(states, FOLLOWED)), np.where(later, after, before)
