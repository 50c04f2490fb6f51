"""What the tags of a drive say of camera, lens and clock: residuals of corners and their slopes.

A corner is seen where ``model.project(T_camera_base T_base_map(t) T_map_tag corner)`` is, with
t = stamp - late + row * readout / (rows - 1). Steps of mount and tags are small motions:
displacement, then turn about axes of the base (mount) or of the map (tags).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import FloatArray, IntArray
from slamsim.perception.calibration.least_squares import (
    DOUBT_SQUARED,
    Equations,
    GroupedSlopes,
    by_blocks,
    weigh,
)
from slamsim.perception.calibration.path import SmoothPath
from slamsim.perception.calibration.projection import (
    LENS,
    lens_names,
    lens_slopes,
    project_slopes,
    rigid_slopes,
    with_lens,
)
from slamsim.perception.calibration.sightings import TagViews
from slamsim.perception.calibration.survey import Survey
from slamsim.perception.tag_pose import square_corners

MOUNT = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
CLOCK = ("late_s", "readout_s")
EDGES = "edges_px"
"""By how much all edges of small tags are seen too far outwards."""
SURVEY = ("survey_x_m", "survey_y_m", "survey_yaw_rad")
TETHERS = {
    **dict.fromkeys(MOUNT[:3], 1.0),
    **dict.fromkeys(MOUNT[3:], 1.0),
    **dict(zip(CLOCK, (1.0, 0.03), strict=True)),
    **dict.fromkeys(LENS, 100.0),
    EDGES: 0.02,
    **dict.fromkeys(SURVEY, 100.0),
}
"""Standard deviation of what nothing tells: no camera sits farther off, no clock is later, no
shutter rolls longer than a period of 30 Hz, no robot drives in a larger place. Edges: tags of 16 to
20 px drawn on grey are seen 0.02 px too small, those of rendered worlds 0.02 px too large, by what
lies behind their border and around them."""
SMALL_PX = 20.0
"""Side of a tag; edges of larger ones are off by less, 0.005 px at 30 px and nothing at 60."""
DISTORTION_TETHER = 1.0
HELD = 1e-9
BLOCK_S = 2.0
"""Errors farther apart than this are taken for independent, as the checker's calibration does."""
FIRST_PATH_SIGMAS = (0.005, 0.005, 0.003, 0.003, 0.003)
LEAST_PATH_SIGMAS = (1e-4, 1e-4, 1e-5, 1e-5, 1e-5)
"""Along, across and turn: what SLAM by a lidar is off by at worst, and at best. Roll and pitch,
which a path in the plane does not have: robots rock between their casters, and nod as they brake.
"""
_STEPS = [0, 1, 5, 3, 4]
"""Of those, among the six of ``rigid_slopes``."""
_EM_ROUNDS = 30
FARTHEST_OFF = 2.0
"""Widths of the image: a corner that should be seen farther off is as good as not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Values and data of the fit; a ``Problem``.

    tag_of: (n,) which of the m tags each sighting shows. T_map_tag: (m, 4, 4). free: names of what
    is fitted beside the tags; the rest is held. path_sigmas: (5,) standard deviations of the path
    where an image was taken: along, across, turn, roll, pitch. away: (q,) sum of the steps of all
    values but the tags'. T_survey_map: (3,). edges_px: see ``EDGES``. scale: see ``weigh``.
    """

    views: TagViews
    path: SmoothPath
    tag_of: IntArray
    model: CameraModel
    T_base_camera: FloatArray
    late_s: float
    readout_s: float
    T_map_tag: FloatArray
    free: frozenset[str]
    away: FloatArray | None = None
    survey: Survey | None = None
    T_survey_map: FloatArray | None = None
    path_sigmas: FloatArray | None = None
    edges_px: float = 0.0
    scale: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Of all values but the tags'."""
        survey = () if self.survey is None else SURVEY
        return (*MOUNT, *CLOCK, *lens_names(self.model), EDGES, *survey)

    @property
    def at_s(self) -> FloatArray:
        """(n, 4) when each corner was seen, on the path's clock."""
        stamps_s = self.path.seconds(self.views.stamps_ns)
        return np.asarray(stamps_s[:, None] - self.late_s + self.readout_s * self.row_shares)

    @property
    def row_shares(self) -> FloatArray:
        """(n, 4) how far down the image each corner is: 0 in the first row, 1 in the last."""
        rows = self.views.corners_px[:, :, 1] / max(self.model.height - 1, 1)
        return np.asarray(np.clip(rows, 0.0, 1.0))

    @property
    def blocks(self) -> IntArray:
        """(n,) number of the piece of the drive in which each sighting is, from 0 on."""
        pieces = self.pieces(self.path.seconds(self.views.stamps_ns))
        return np.asarray(np.unique(pieces, return_inverse=True)[1])

    @staticmethod
    def pieces(at_s: FloatArray) -> IntArray:
        """(n,) which block of time each instant is in."""
        return np.asarray(at_s // BLOCK_S, dtype=np.int64)

    def residuals(self) -> FloatArray:
        """(n, 8) corners as they should be seen less those seen, px; large where none is seen."""
        return self._seen()[0]

    def unit_residuals(self) -> FloatArray:
        """(n, 8) the same, whitened: in standard deviations."""
        off_px, _, by_base = self._linear()
        return _times(self._roots(by_base), off_px[..., None])[..., 0]

    def weights(self) -> FloatArray:
        """(n,) 1 for sightings that fit, 0 for those that do not."""
        return weigh(self.unit_residuals())[0]

    def equations(self) -> Equations:
        off_px, slopes, by_base = self._linear()
        roots = self._roots(by_base)
        unit = _times(roots, off_px[..., None])[..., 0]
        weights, cost = weigh(unit, self.scale)
        unit *= np.sqrt(weights)[:, None]
        roots *= np.sqrt(weights)[:, None, None]
        blocks = self.blocks
        equations = by_blocks(unit, slopes.times(roots).of, blocks, int(blocks.max()) + 1)
        if self.survey is not None:
            assert self.T_survey_map is not None
            rows, row_slopes = self.survey.rows(self.T_survey_map, self.T_map_tag, len(self.names))
            more = by_blocks(rows, row_slopes.__getitem__, np.arange(len(rows)), len(rows))
            both = [np.concatenate(pair) for pair in zip(equations, more, strict=True)]
            equations = both[0], both[1]
            cost += float(np.square(rows).sum())
        return Equations(*equations, cost, self._prior_sigmas(), self._away())

    def moved(self, step: FloatArray) -> Drive:
        places = {name: k for k, name in enumerate(self.names)}
        lens = step[[k for name, k in places.items() if name in LENS or name[0] == "d"]]
        tags = step[len(places) :].reshape(-1, 6)
        T_map_tag = self.T_map_tag.copy()
        T_map_tag[:, :3, 3] += tags[:, :3]
        T_map_tag[:, :3, :3] = Rotation.from_rotvec(tags[:, 3:]).as_matrix() @ T_map_tag[:, :3, :3]
        T_base_camera = self.T_base_camera.copy()
        T_base_camera[:3, 3] += step[:3]
        T_base_camera[:3, :3] = Rotation.from_rotvec(step[3:6]).as_matrix() @ T_base_camera[:3, :3]
        T_survey_map = self.T_survey_map
        if T_survey_map is not None:
            T_survey_map = T_survey_map + step[len(places) - 3 : len(places)]
        return replace(
            self,
            model=with_lens(self.model, lens),
            T_base_camera=T_base_camera,
            late_s=self.late_s + float(step[6]),
            readout_s=self.readout_s + float(step[7]),
            T_map_tag=T_map_tag,
            away=self._away()[: len(places)] + step[: len(places)],
            edges_px=self.edges_px + float(step[places[EDGES]]),
            T_survey_map=T_survey_map,
        )

    def _seen(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residuals (n, 8), corners in the base (4 n, 3) and in the camera, velocities (4 n, 3)."""
        poses, velocities = self.path.at(self.at_s.ravel())
        T_map_tag = self.T_map_tag[self.tag_of]
        corners = square_corners(self.views.size_m)
        in_map = np.einsum("nij,cj->nci", T_map_tag[:, :3, :3], corners) + T_map_tag[:, None, :3, 3]
        away = in_map.reshape(-1, 3) - np.column_stack([poses[:, :2], np.zeros(len(poses))])
        in_base = _unturned(poses[:, 2], away)
        in_camera = (in_base - self.T_base_camera[:3, 3]) @ self.T_base_camera[:3, :3]
        pixels, seen = self.model.project(in_camera)
        pixels = pixels + self.edges_px * _outwards(self.views.corners_px)
        off = pixels - self.views.corners_px.reshape(-1, 2)
        # What cannot be seen, or only far out, is off by so much, whichever way things move.
        seen &= (np.abs(off) < FARTHEST_OFF * self.model.width).all(axis=1)
        off = np.where(seen[:, None], off, FARTHEST_OFF * self.model.width)
        return off.reshape(-1, 8), in_base, in_camera, velocities

    def _linear(self) -> tuple[FloatArray, GroupedSlopes, FloatArray]:
        """Residuals (n, 8), their slopes, and those (n, 8, 5) by a step of the base."""
        off_px, in_base, in_camera, velocities = self._seen()
        count = len(self.views)
        by_point = project_slopes(self.model, in_camera) @ self.T_base_camera[:3, :3].T
        farthest_px = np.abs(off_px).reshape(-1, 2).max(axis=1)
        near = np.asarray(farthest_px < FARTHEST_OFF * self.model.width)
        by_point = np.where(near[:, None, None], by_point, 0.0)
        from_camera = in_base - self.T_base_camera[:3, 3]
        by_base = -by_point @ rigid_slopes(in_base)[:, :, _STEPS]
        by_time = np.einsum("nij,nj->ni", by_base[:, :, :3], velocities)
        poses, _ = self.path.at(self.at_s.ravel())
        by_map = _turned_slopes(by_point, poses[:, 2])
        middles = np.repeat(self.T_map_tag[self.tag_of, :3, 3], 4, axis=0)
        in_map = self._in_map().reshape(-1, 3)
        by_tag = by_map @ rigid_slopes(in_map - middles)
        shared = np.concatenate(
            [
                -by_point @ rigid_slopes(from_camera),
                -by_time[:, :, None],
                (by_time * self.row_shares.ravel()[:, None])[:, :, None],
                self._lens_slopes(in_camera),
                np.where(near[:, None], _outwards(self.views.corners_px), 0.0)[:, :, None],
            ],
            axis=2,
        )
        shared = shared.reshape(count, 8, -1)
        if self.survey is not None:
            shared = np.concatenate([shared, np.zeros((count, 8, len(SURVEY)))], axis=2)
        slopes = GroupedSlopes(
            shared, by_tag.reshape(count, 8, 6), self.tag_of, len(self.T_map_tag)
        )
        return off_px, slopes, by_base.reshape(count, 8, len(_STEPS))

    def _in_map(self) -> FloatArray:
        """(n, 4, 3) the corners of each sighting."""
        T_map_tag = self.T_map_tag[self.tag_of]
        corners = square_corners(self.views.size_m)
        turned = np.einsum("nij,cj->nci", T_map_tag[:, :3, :3], corners)
        return np.asarray(turned + T_map_tag[:, None, :3, 3])

    def _lens_slopes(self, in_camera: FloatArray) -> FloatArray:
        wanted = [k for k, name in enumerate(lens_names(self.model)) if name in self.free]
        return lens_slopes(self.model, in_camera, wanted)

    def path_errors(self) -> FloatArray:
        """(5,) standard deviations of the path, as ``path_sigmas``, beyond what corners
        explain: by the EM algorithm for components of variance (Dempster, Laird & Rubin 1977)."""
        off_px, _, by_base = self._linear()
        certain = np.linalg.inv(self.views.covariances_px)
        weighed = np.swapaxes(by_base, 1, 2) @ certain
        information, pull = weighed @ by_base, -np.einsum("nij,nj->ni", weighed, off_px)
        variances = np.square(FIRST_PATH_SIGMAS)
        for _ in range(_EM_ROUNDS):
            spread = np.linalg.inv(information + np.diag(1.0 / variances))
            steps = np.einsum("nij,nj->ni", spread, pull)
            # Outliers would be taken for errors of the path.
            weights = 1.0 / (1.0 + (np.square(steps) / variances).mean(axis=1) / DOUBT_SQUARED)
            squares = np.square(steps) * weights[:, None]
            squares += np.diagonal(spread, axis1=1, axis2=2)
            variances = np.maximum(squares.mean(axis=0), np.square(LEAST_PATH_SIGMAS))
        return np.sqrt(variances)

    def _roots(self, by_base: FloatArray) -> FloatArray:
        """(n, 8, 8) upper roots of the weights of the residuals."""
        covariances = self.views.covariances_px
        if self.path_sigmas is not None:
            scaled = by_base * self.path_sigmas
            covariances = covariances + scaled @ np.swapaxes(scaled, 1, 2)
        return np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariances)), 1, 2)

    def _away(self) -> FloatArray:
        """(p,) how far values are from where they began; tags from where they are."""
        known = np.zeros(len(self.names)) if self.away is None else self.away
        return np.concatenate([known, np.zeros(6 * len(self.T_map_tag))])

    def _prior_sigmas(self) -> FloatArray:
        """(p,) of all values about where they began."""
        free = [
            TETHERS.get(name, DISTORTION_TETHER) if name in (*self.free, EDGES) else HELD
            for name in self.names
        ]
        tags = np.tile([10.0, 10.0, 10.0, 3.0, 3.0, 3.0], len(self.T_map_tag))
        return np.concatenate([free, tags])


def _outwards(corners_px: FloatArray) -> FloatArray:
    """(4 n, 2) by how many pixels corners (n, 4, 2) move where edges are seen a pixel outwards, of
    tags larger than ``SMALL_PX`` less."""
    after = np.roll(corners_px, -1, axis=1) - corners_px
    lengths = np.linalg.norm(after, axis=2, keepdims=True)
    normals = np.stack([after[..., 1], -after[..., 0]], axis=2) / lengths
    before = np.roll(normals, 1, axis=1)
    opening = 1.0 + (normals * before).sum(axis=2, keepdims=True)
    shares = np.minimum(1.0, np.square(SMALL_PX / lengths.mean(axis=1, keepdims=True)))
    return np.asarray((shares * (normals + before) / opening).reshape(-1, 2))


def _unturned(yaw_rad: FloatArray, vectors: FloatArray) -> FloatArray:
    """(n, 3) of the map as seen from bases of these headings."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = vectors.T
    return np.column_stack([cos * x + sin * y, cos * y - sin * x, z])


def _turned_slopes(by_base: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """(n, 2, 3) slopes by points in the base as slopes by the same points in the map."""
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x, y, z = np.moveaxis(by_base, 2, 0)
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=2)


def _times(roots: FloatArray, columns: FloatArray) -> FloatArray:
    return np.asarray(np.matmul(roots, columns))
