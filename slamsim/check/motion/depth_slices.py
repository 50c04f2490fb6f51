"""What a depth camera sees at the height of the lidar, against the scans of the same instants.

Texture plays no part in it. One fit to all images tells where the camera sits in the plane, how
far its depths and its focal length are off, and how late its stamps are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from slamsim.cameras.lens import CameraModel
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.motion.robust import biweights, scatter
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawScans, Recording

NAMES = ("x_m", "y_m", "yaw_rad", "scale", "focal", "delay_s")
_DELAY = NAMES.index("delay_s")
FEWEST_IMAGES, FEWEST_POINTS = 10, 300
_MOST_IMAGES = 150
_GATES_M = (0.5, 0.3, 0.2)
"""How far apart a point and its surface may be, one after the other."""
_ROUNDS, _SETTLED = 100, (1e-3, 1e-3, 1e-5)
"""At most so many of each gate, until one would change nothing by as much (m, rad, s, the whole).
What agrees already outweighs what does not, so that between walls a metre away place, scale and
focal length, which look alike there, creep until they are told apart: of a camera 0.1 m from where
it is declared, 25 plain steps found 14 mm of place and 4 % of scale, and 100 all of it."""
_ALONG, _FASTER, _LONGEST = 0.9, 1.5, 16.0
"""As long as steps go the same way (by the cosine between two), each is made longer than the one
before, up to so many times: 5 to 8 times fewer rounds."""
_FEWEST_OF_SCAN = 10
"""Points on surfaces."""
_STEP = 0.05
"""Of the depth: rows farther apart see two surfaces."""
_GAP_M, _BENT_M = 0.25, 0.02
"""Between neighbouring beams, and off the line through them: else there is no surface."""
_FLOOR_M = 0.003
"""How exactly a wall is the same at two heights."""
_LEAST_NOISE = 1e-6
"""Of the scatter that is looked for."""
_SHIFTS, _LINEAR_S = 4, 0.01
"""How often stamps are shifted by what was found: so long motion is taken for even."""
_DELAYS_NS = tuple(round(1e9 * late_s) for late_s in np.arange(-1.0, 1.01, 0.1).tolist())
_FEW_IMAGES, _PLAINLY = 60, 0.8
_UNTOLD = np.zeros(len(NAMES))
_HEALTHY = np.concatenate([_UNTOLD, [0.4, 0.4]])
_KNOWN = np.concatenate([_UNTOLD, np.square([1.0 / 0.3, 1.0 / 0.3])])
"""Mean, and inverse variance, of what is known of each unknown before. Two more stand after
``NAMES``: how far depths in the pixels of another camera are pulled nearer, where of several that
meet in a pixel the nearest is kept. On a wall that is seen aslant, half a pixel to its nearer side
where each depth fills a patch (``align`` of librealsense), nothing where it fills a point. By noise
of disparity, most of which neighbouring pixels have in common, the nearest of two to four is nearer
by 0.25 to 0.5 sigma: a pixel's angle times distance squared times 0.13 to 1 a metre (sigmas of 0.05
to 0.1 pixels over 5 to 10 cm, data sheets), nothing of time of flight."""
_SIZES, _MOST_SHARE = [NAMES.index("scale"), NAMES.index("focal")], 0.5
"""Beyond such a scale or focal length the fit has left what it can tell: all points at the camera,
and the camera on a wall, fit any scan."""
_RANK = 1e-10
"""Of the information: below, nothing is told, and sigmas are 1 (m, rad, s, the whole)."""


@dataclass(frozen=True, slots=True, eq=False)
class SliceFit:
    """By ``NAMES``: what is to be added to the claimed place (base axes; the turn about the
    camera's own place), by which share depths are too short, by which share what is seen is too
    wide (the claimed focal length too short), and by how much stamps are later than the scans' of
    the same instant. sigmas: (6,). mixed: (6,) how many times less sure each is than if the others
    were known, and so how many times more of what the fit does not know of gets into it. pixel_rad:
    the angle of a pixel into which depths of another camera's were put, 0 where they are its own.
    """

    values: FloatArray
    sigmas: FloatArray
    mixed: FloatArray
    pixel_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """One image: points_m (n, 2) in the base at its stamp, beside_m (n, 2) their part off the
    optical axis, origin_m (2,) the camera, depths_m (n,); surfaces_m (m, 2) and normals
    (m, 2) of the scan there; motion of the robot (v_x, v_y, yaw rate)."""

    points_m: FloatArray
    beside_m: FloatArray
    origin_m: FloatArray
    depths_m: FloatArray
    surfaces_m: FloatArray
    normals: FloatArray
    motion: FloatArray


def fit_slices(
    recording: Recording,
    depth: CameraSurvey,
    scans: RawScans,
    T_base_camera: FloatArray,
    T_base_laser: FloatArray,
    is_registered: bool = False,
) -> SliceFit | None:
    """None where too few images show the walls of the scans, or nothing tells how the robot moved.
    Raises BadNumbers for a CameraInfo that no camera can have.

    T_base_camera, T_base_laser: (4, 4) as claimed. is_registered: whether depths were put into the
    pixels of another camera.
    """
    assert depth.claim is not None
    model = depth.claim.model()
    pixel_rad = 1.0 / float(model.focal_px[0]) if is_registered else 0.0
    path = _path(recording)
    if path is None or not len(scans):
        return None
    place = T_base_camera, float(T_base_laser[2, 3])
    placed = _PlacedScans(scans, T_base_laser, path)
    few = depth.selected(depth.sampled[:: max(depth.sampled.size // _FEW_IMAGES, 1)])
    late_ns = _coarse_ns(_crossings(few, model, *place), placed)
    crossings = _crossings(depth, model, *place)
    values, gates = _HEALTHY, tuple(zip(_GATES_M, _SETTLED, strict=True))
    fit = None
    for _ in range(_SHIFTS):
        found = _settled(list(_slices(crossings, placed, late_ns)), values, gates, pixel_rad)
        if found is None:
            return None
        left_s = float(found.values[_DELAY])
        told = found.values[: len(NAMES)].copy()
        told[_DELAY] += 1e-9 * late_ns
        own = slice(len(NAMES))
        fit = replace(found, values=told, sigmas=found.sigmas[own], mixed=found.mixed[own])
        if abs(left_s) < _LINEAR_S:
            break
        late_ns += round(1e9 * left_s)
        values, gates = found.values.copy(), gates[-1:]
        values[_DELAY] = 0.0
    return fit


def _coarse_ns(few: list[_Crossing], placed: _PlacedScans) -> int:
    """The delay of some with which a few images lie best on the scans, ns; none where that is
    hardly better."""
    apart_m = {}
    for late_ns in _DELAYS_NS:
        each = [
            np.minimum(cKDTree(one.surfaces_m).query(one.points_m)[0], _GATES_M[0]).mean()
            for one in _slices(few, placed, late_ns)
        ]
        apart_m[late_ns] = float(np.mean(each)) if each else np.inf
    best = min(apart_m, key=lambda late_ns: apart_m[late_ns])
    return best if apart_m[best] < _PLAINLY * apart_m[0] else 0


def _path(recording: Recording) -> tuple[IntArray, FloatArray] | None:
    for odometry in recording.odometries:
        known_ns, track = planar_track(
            odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw
        )
        if known_ns.size > 1:
            return known_ns, track
    return None


_Crossing = tuple[int, FloatArray, FloatArray, FloatArray, FloatArray]
"""The stamp of an image in ns, and what ``_seen`` gives of it."""


def _crossings(
    depth: CameraSurvey, model: CameraModel, T_base_camera: FloatArray, height_m: float
) -> list[_Crossing]:
    """Of the chosen images, as far as they see surfaces at the lidar's height."""
    rays, grids_m = grid_rays(depth, model), depth.grids_m
    # To a camera on its side heights change along its rows: across them only noise of depths would
    # cross the lidar's height, at depths that are chosen by that.
    if abs(T_base_camera[2, 0]) > abs(T_base_camera[2, 1]):
        rays, grids_m = rays.transpose(1, 0, 2), grids_m.transpose(0, 2, 1)
    found = []
    for look in chosen_looks(depth).tolist():
        seen = _seen(grids_m[look], rays, T_base_camera, height_m)
        if seen is not None:
            found.append((int(depth.stamps_ns[depth.sampled[look]]), *seen))
    return found


def _slices(crossings: list[_Crossing], placed: _PlacedScans, late_ns: int) -> Iterator[_Slice]:
    """late_ns: by which stamps of images are later."""
    for stamp_ns, points_m, beside_m, origin_m, depths_m in crossings:
        at_ns = stamp_ns - late_ns
        surfaces = placed.at(at_ns)
        if surfaces is not None:
            motion = _motion(placed.path, at_ns)
            yield _Slice(points_m, beside_m, origin_m, depths_m, *surfaces, motion)


def chosen_looks(depth: CameraSurvey) -> IntArray:
    """(k,) which of the sampled images are looked at: new ones, evenly chosen."""
    new = np.flatnonzero(depth.is_new)
    return new[:: max(-(-new.size // _MOST_IMAGES), 1)]


def grid_rays(depth: CameraSurvey, model: CameraModel) -> FloatArray:
    """(h, w, 3) of depth 1 in the optical frame."""
    height, width = depth.grids_m.shape[1:]
    first, step = depth.grid_px // 2, depth.grid_px
    x, y = np.meshgrid(first + step * np.arange(width), first + step * np.arange(height))
    rays = model.rays_at(np.column_stack([x.ravel(), y.ravel()]).astype(np.float64))
    return np.asarray((rays / rays[:, 2:]).reshape(height, width, 3))


def _seen(
    grid_m: FloatArray, rays: FloatArray, T_base_camera: FloatArray, height_m: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Points where surfaces cross the lidar's height: in the base, the part off the optical axis,
    the camera, depths."""
    in_camera = rays * grid_m[..., None]
    heights_m = in_camera @ T_base_camera[2, :3] + T_base_camera[2, 3]
    above, below = heights_m[:-1] - height_m, heights_m[1:] - height_m
    deep = grid_m[:-1], grid_m[1:]
    same = np.abs(deep[0] - deep[1]) < _STEP * np.minimum(*deep)
    rows, columns = np.nonzero((above * below <= 0.0) & same & (above != below))
    if rows.size < 5:
        return None
    over, under = above[rows, columns], below[rows, columns]
    share = (over / (over - under))[:, None]
    upper, lower = in_camera[rows, columns], in_camera[rows + 1, columns]
    points = upper + share * (lower - upper)
    R, origin = T_base_camera[:2, :3], T_base_camera[:2, 3]
    beside = points[:, :2] @ R[:, :2].T
    return points @ R.T + origin, beside, origin, points[:, 2]


class _PlacedScans:
    """Surfaces of scans as they lie along the path, each worked out once.

    path: stamps (n,) and poses (n, 3). T_base_laser: (4, 4).
    """

    def __init__(
        self, scans: RawScans, T_base_laser: FloatArray, path: tuple[IntArray, FloatArray]
    ) -> None:
        self.path = path
        self._scans, self._T_base_laser = scans, T_base_laser
        self._order = np.argsort(scans.stamps_ns)
        self._sorted_ns = scans.stamps_ns[self._order]
        self._known: dict[int, tuple[FloatArray, FloatArray]] = {}

    def at(self, at_ns: int) -> tuple[FloatArray, FloatArray] | None:
        """Points (n, 2) and normals (n, 2) of the nearest scan in the base at an instant; None
        where the path does not reach, no scan is near or it shows hardly a surface."""
        if not self.path[0][0] < at_ns < self.path[0][-1]:
            return None
        after = int(
            np.clip(np.searchsorted(self._sorted_ns, at_ns), 1, max(len(self._order) - 1, 1))
        )
        pair = self._order[[after - 1, min(after, len(self._order) - 1)]]
        scan = int(pair[np.argmin(np.abs(self._scans.stamps_ns[pair] - at_ns))])
        if abs(int(self._scans.stamps_ns[scan]) - at_ns) > 200_000_000:
            return None
        if scan not in self._known:
            self._known[scan] = self._surfaces(scan)
        points, normals = self._known[scan]
        if len(points) <= _FEWEST_OF_SCAN:
            return None
        x_m, y_m, yaw = track_at(*self.path, np.array([at_ns]))[0].tolist()
        R_path_base = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        return (points - [x_m, y_m]) @ R_path_base, normals @ R_path_base

    def _surfaces(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """Points and normals in the frame of the path, each beam from the pose of its instant."""
        layout = self._scans.layout(scan)
        ranges = np.asarray(self._scans.ranges_m[scan], dtype=np.float64)
        beams = np.arange(ranges.size)
        angles = layout.angle_min_rad + beams * layout.angle_step_rad
        there = np.isfinite(ranges) & (ranges > layout.range_min_m) & (ranges < layout.range_max_m)
        ranges = np.where(there, ranges, np.nan)
        in_laser = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges])
        T = self._T_base_laser
        x_m, y_m = (in_laser @ T[:3, :3].T + T[:3, 3])[:, :2].T
        beam_ns = self._scans.stamps_ns[scan] + np.rint(1e9 * layout.beam_dt_s * beams).astype(
            np.int64
        )
        then = track_at(*self.path, beam_ns)
        cos, sin = np.cos(then[:, 2]), np.sin(then[:, 2])
        points = then[:, :2] + np.column_stack([cos * x_m - sin * y_m, sin * x_m + cos * y_m])
        along = points[2:] - points[:-2]
        gap = np.hypot(*along.T)
        with np.errstate(invalid="ignore", divide="ignore"):
            normals = np.column_stack([-along[:, 1], along[:, 0]]) / gap[:, None]
            bent = np.abs(((points[1:-1] - points[:-2]) * normals).sum(axis=1))
            is_surface = (gap < 2.0 * _GAP_M) & (bent < _BENT_M)
        return points[1:-1][is_surface], normals[is_surface]


def _motion(path: tuple[IntArray, FloatArray], at_ns: int) -> FloatArray:
    """(3,) forward and sideways in m/s, and yaw rate, over a tenth of a second."""
    before, after = track_at(*path, at_ns + np.array([-50_000_000, 50_000_000]))
    cos, sin = np.cos(before[2]), np.sin(before[2])
    x, y, turned = after - before
    return 10.0 * np.array([cos * x + sin * y, cos * y - sin * x, turned])


def _settled(
    slices: list[_Slice],
    values: FloatArray,
    gates: tuple[tuple[float, float], ...],
    pixel_rad: float,
) -> SliceFit | None:
    """The fit from these values (8,) on, of all unknowns; None where too few images or points lie
    near the scans, or walls on one side let depths shrink to nothing. gates: of ``_GATES_M`` and
    ``_SETTLED``. pixel_rad: as of ``SliceFit``."""
    if len(slices) < FEWEST_IMAGES:
        return None
    each_tree = [(each, cKDTree(each.surfaces_m)) for each in slices]
    for gate_m, least in gates:
        stride = 1.0
        last: FloatArray = np.zeros(values.size)
        for _ in range(_ROUNDS):
            parts = [_equations(*one, values, gate_m, pixel_rad) for one in each_tree]
            apart = np.concatenate([r / s for _, r, s in parts])
            if apart.size < FEWEST_POINTS:
                return None
            noise = scatter(apart, _LEAST_NOISE)
            blocks = [_weighed(A, r, s, noise) for A, r, s in parts]
            # What was known before counts as one image does: errors within an image are alike.
            an_image = noise**2 * apart.size / len(slices)
            prior = an_image * _KNOWN
            H = sum(b[0] for b in blocks) + np.diag(prior)
            g = sum(b[1] for b in blocks) + prior * (_HEALTHY - values)
            step: FloatArray = np.asarray(np.linalg.lstsq(H, g, rcond=_RANK)[0])
            creeps = step @ last > _ALONG * np.linalg.norm(step) * np.linalg.norm(last)
            stride = min(_FASTER * stride, _LONGEST) if creeps else 1.0
            values, last = values + stride * step, step
            if np.abs(values[_SIZES]).max() > _MOST_SHARE:
                return None
            if np.abs(step).max() < least:
                break
    # Errors within an image are alike (noise of disparity, one wall): images count, not points.
    spread = sum(np.outer(g, g) for _, g in blocks) + np.diag(an_image * prior)
    inverse = np.linalg.pinv(H, rcond=_RANK)
    size, vectors = np.linalg.eigh(H)
    untold = vectors[:, size < _RANK * size[-1]]  # the delay of a robot that stands
    covariance = inverse @ spread @ inverse + untold @ untold.T
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    mixed = np.sqrt(np.maximum(np.diag(H) * np.diag(inverse), 1.0))
    return SliceFit(values, sigmas, mixed, pixel_rad)


_Equations = tuple[FloatArray, FloatArray, FloatArray]


def _equations(
    each: _Slice, tree: cKDTree, values: FloatArray, gate_m: float, pixel_rad: float
) -> _Equations:
    """(n, 8) by how much points leave their surfaces with each unknown, (n,) how far they are
    before them, (n,) up to which scatter."""
    from_camera = each.points_m - each.origin_m
    x_m, y_m, yaw, scale, focal, delay_s = values[:6]
    scaled = (1.0 + scale) * (from_camera - focal * each.beside_m)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = scaled @ np.array([[cos, sin], [-sin, cos]])
    points = turned + each.origin_m + [x_m, y_m]
    v, rate = each.motion[:2], each.motion[2]
    drift = v + rate * np.column_stack([-points[:, 1], points[:, 0]])
    points = points - delay_s * drift
    found = tree.query(points)
    near, place = np.asarray(found[0]) < gate_m, np.asarray(found[1])
    n = each.normals[place[near]]
    apart = ((each.surfaces_m[place[near]] - points[near]) * n).sum(axis=1)
    outward_m = (n * turned[near]).sum(axis=1)
    distances_m = np.linalg.norm(turned[near], axis=1)
    along_m = np.sqrt(np.maximum(np.square(distances_m) - np.square(outward_m), 0.0))
    pulls_m = pixel_rad * np.column_stack([np.sign(outward_m) * along_m, outward_m * distances_m])
    columns = (
        n[:, 0],
        n[:, 1],
        n[:, 1] * turned[near, 0] - n[:, 0] * turned[near, 1],
        outward_m,
        -(n * each.beside_m[near]).sum(axis=1),
        -(n * drift[near]).sum(axis=1),
        *pulls_m.T,
    )
    scatter_m = _FLOOR_M + 0.01 * np.square(each.depths_m[near])
    return np.column_stack(columns), apart - pulls_m @ values[6:], scatter_m


def _weighed(
    A: FloatArray, apart: FloatArray, scatter_m: FloatArray, noise: float
) -> tuple[FloatArray, FloatArray]:
    """(n, n) and (n,) of one image's n unknowns, its points by Tukey's biweight."""
    weight = biweights(apart / scatter_m, noise) / np.square(scatter_m)
    by = A * weight[:, None]
    return by.T @ A, by.T @ apart
