"""A drive past tags on the walls of a hall, and where a camera sees their corners.

Nothing is rendered.

Corners are projected one by one, from where the robot was when their row was exposed, and get noise
of pixels; the path is known with errors that last for seconds, as SLAM makes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from simulated import drive

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts, se3_from_se2
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory
from slamsim.perception.calibration.sightings import TagViews
from slamsim.perception.tag_edges import LEAST_SIDE_PX
from slamsim.perception.tag_pose import square_corners

HALL_M = (8.0, 6.0)
SIZE_M = 0.16
R_BASE_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_CLAIMED = se3_from_parts(R_BASE_OPTICAL, np.array([0.1, 0.0, 0.4]))
FARTHEST_M = 6.0


def off_by(step: FloatArray) -> FloatArray:
    """(4, 4) the claimed mount after a step (6,): m, then rad about the axes of the base."""
    T = T_CLAIMED.copy()
    T[:3, 3] += step[:3]
    T[:3, :3] = matrix_from_rpy(*step[3:]) @ T[:3, :3]
    return T


@dataclass(frozen=True)
class Setting:
    """What is so. noise_px: of a corner. path_sigmas: m and rad, of errors that last path_s, as do
    tilts of the robot (rad)."""

    T_base_camera: FloatArray = field(
        default_factory=lambda: off_by(np.array([0.02, -0.015, 0.01, 0.008, -0.017, 0.026]))
    )
    model: CameraModel = field(default_factory=lambda: pinhole(424, 240, 69.0))
    late_s: float = 0.012
    readout_s: float = 0.02
    noise_px: float = 0.08
    path_sigmas: tuple[float, float] = (0.001, 0.0005)
    tilt_sigma: float = 0.0
    path_s: float = 3.0
    seconds: float = 60.0
    rate_hz: float = 10.0


@dataclass(frozen=True)
class Driven:
    """What a calibration gets, and where the tags truly are (m, 4, 4)."""

    views: TagViews
    path: PlanarTrajectory
    truth: PlanarTrajectory
    tags: FloatArray


def driven(seed: int, setting: Setting) -> Driven:
    rng = np.random.default_rng([seed, 5])
    goals = np.column_stack([rng.uniform(1.2, side - 1.2, 60) for side in HALL_M])
    truth = drive(goals, max_s=setting.seconds)
    tags = _tags(rng)
    return Driven(_views(truth, tags, setting, rng), _estimated(truth, setting, rng), truth, tags)


def _tags(rng: np.random.Generator, count: int = 16) -> FloatArray:
    """(m, 4, 4) T_map_tag, spread along the walls."""
    w, h = HALL_M
    found = []
    for at in (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count * 2.0 * (w + h):
        sides = [(at, 0.0, np.pi / 2), (w, at - w, np.pi), (2 * w + h - at, h, -np.pi / 2)]
        sides.append((0.0, 2 * (w + h) - at, 0.0))
        place = sides[int(np.searchsorted(np.cumsum([w, h, w, h]), at))]
        upright = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        height = np.array([0.0, 0.0, rng.uniform(0.3, 0.7)])
        tilted = upright @ matrix_from_rpy(*rng.normal(0.0, 0.05, 3))
        found.append(se3_from_se2(np.array(place)) @ se3_from_parts(tilted, height))
    return np.array(found)


def _estimated(
    truth: PlanarTrajectory, setting: Setting, rng: np.random.Generator
) -> PlanarTrajectory:
    """At 50 Hz, with errors that wander about zero (Ornstein and Uhlenbeck 1930)."""
    at = slice(None, None, 4)
    stamps_ns, poses = truth.stamps_ns[at], truth.poses[at].copy()
    shift_m, turn_rad = setting.path_sigmas
    poses += _wandering(len(poses), setting, rng) * [shift_m, shift_m, turn_rad]
    return PlanarTrajectory(stamps_ns, poses)


def _wandering(count: int, setting: Setting, rng: np.random.Generator) -> FloatArray:
    """(count, 3) at 50 Hz, of standard deviation 1."""
    kept = np.exp(-0.02 / setting.path_s)
    values = np.zeros((count, 3))
    values[0] = rng.normal(0.0, 1.0, 3)
    for row in range(1, count):
        values[row] = kept * values[row - 1] + np.sqrt(1.0 - kept**2) * rng.normal(0.0, 1.0, 3)
    return values


def _views(
    truth: PlanarTrajectory, tags: FloatArray, setting: Setting, rng: np.random.Generator
) -> TagViews:
    last_ns, late_ns = int(truth.stamps_ns[-1]), round(1e9 * setting.late_s)
    exposed_ns = np.arange(400_000_000, last_ns - 400_000_000, round(1e9 / setting.rate_hz))
    known_ns = np.arange(0, last_ns + 20_000_000, 20_000_000)
    tilts = setting.tilt_sigma * _wandering(len(known_ns), setting, np.random.default_rng(last_ns))

    def base_at(at_ns: IntArray) -> FloatArray:
        roll, pitch = (np.interp(at_ns, known_ns, tilts[:, axis]) for axis in range(2))
        tilted = Rotation.from_euler("xy", np.column_stack([roll, pitch])).as_matrix()
        T = se3_from_se2(truth.at(at_ns))
        T[:, :3, :3] = T[:, :3, :3] @ tilted
        return T

    found = [_seen(base_at, exposed_ns, T_map_tag, setting) for T_map_tag in tags]
    numbers = np.repeat(np.arange(len(tags)), [len(each[0]) for each in found])
    stamps_ns, pixels, poses = (np.concatenate([each[k] for each in found]) for k in range(3))
    noisy = pixels + rng.normal(0.0, setting.noise_px, pixels.shape)
    covariance = np.broadcast_to(np.eye(8) * setting.noise_px**2, (len(noisy), 8, 8)).copy()
    poses = np.repeat(poses[:, None], 2, axis=1)
    poses[:, :, :3, 3] *= 1.0 + 0.01 * rng.normal(size=(len(poses), 1, 1))
    return TagViews(stamps_ns + late_ns, numbers, noisy, covariance, poses, SIZE_M)


def _seen(
    base_at: Callable[[IntArray], FloatArray],
    exposed_ns: IntArray,
    T_map_tag: FloatArray,
    setting: Setting,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """(k,) exposures in which a tag is seen well, (k, 4, 2) its corners' pixels, T_camera_tag."""
    pixels = np.zeros((len(exposed_ns), 4, 2))
    corners = np.column_stack([square_corners(SIZE_M), np.ones(4)])
    for _ in range(4):
        for corner, point in enumerate(corners):
            shares = np.clip(pixels[:, corner, 1] / (setting.model.height - 1), 0.0, 1.0)
            at_ns = exposed_ns + np.rint(1e9 * setting.readout_s * shares).astype(np.int64)
            T_map_camera = base_at(at_ns) @ setting.T_base_camera
            T_camera_tag = np.linalg.inv(T_map_camera) @ T_map_tag
            pixels[:, corner], _ = setting.model.project((T_camera_tag @ point)[:, :3])
    sides = np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=2).min(axis=1)
    inside = setting.model.contains(pixels.reshape(-1, 2)).reshape(-1, 4).all(axis=1)
    depths_m = T_camera_tag[:, 2, 3]
    well = inside & (sides >= LEAST_SIDE_PX) & (T_camera_tag[:, 2, 2] < -0.2)
    well &= (depths_m > 0.3) & (depths_m < FARTHEST_M)
    return exposed_ns[well], pixels[well], T_camera_tag[well]
