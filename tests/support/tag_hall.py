"""A hall in which a short-sighted lidar sees next to nothing, with tags on its walls.

What a camera sees of the tags is made by projecting their exact corners and adding noise of pixels;
the poses and covariances are then those of ``tag_pose``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simulated import Simulated, box, simulate

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import compose, inverse, se3_from_parts, se3_from_se2
from slamsim.core.landmarks import KnownTag, TagObservation
from slamsim.core.types import FloatArray, ScanGeometry
from slamsim.perception.planar import planar_observation
from slamsim.perception.tag_edges import LEAST_SIDE_PX, Corners
from slamsim.perception.tag_families import TagKind
from slamsim.perception.tag_pose import square_corners, tag_pose
from slamsim.perception.tags import TagSighting

SIZE_M = (17.0, 12.0)
BLIND = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(1.0), 271, 69_444, 0.1, 4.0)
CAMERA = pinhole(640, 480, 69.0)
R_BASE_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAMERA = se3_from_parts(R_BASE_OPTICAL, np.array([0.1, 0.02, 0.3]))
KIND = TagKind("apriltag_36h11", 0.4)
NOISE_PX = 0.12
"""Of a corner: what lines through edges leave in images of tags this far away (``tag_edges``)."""


def hall(seed: int, max_s: float = 150.0) -> Simulated:
    """Rounds on which the lidar sees a shelf near the start and nothing afterwards."""
    w, h = SIZE_M
    walls = np.concatenate([box(0, 0, w, h), box(1.0, 5.6, 4.0, 5.8)])
    start, round_ = (3.0, 4.6), [(8.0, 4.4), (12.6, 4.4), (12.6, 7.6), (8.0, 7.6)]
    points = np.array([start, *round_, *round_, *round_])
    return simulate(walls, points, seed, geometry=BLIND, gyro=False, max_s=max_s)


def half_blind_hall(seed: int) -> Simulated:
    """The same with a block and a box in it, which half of the scans see."""
    w, h = SIZE_M
    things = [box(1.0, 5.6, 4.0, 5.8), box(6.0, 5.6, 9.0, 6.4), box(10.0, 1.0, 11.0, 2.0)]
    walls = np.concatenate([box(0, 0, w, h), *things])
    start, round_ = (3.0, 4.6), [(8.0, 4.4), (12.6, 4.4), (12.6, 7.6), (8.0, 7.6)]
    points = np.array([start, *round_, *round_, start])
    return simulate(walls, points, seed, geometry=BLIND, gyro=False, max_s=100.0)


TAGS_IN_ROOM = np.array(
    [[6.0, 2.0, np.pi], [3.0, 4.0, -np.pi / 2], [0.0, 2.5, 0.0], [2.0, 0.0, np.pi / 2]]
)


def room(seed: int) -> Simulated:
    """Rounds in a room of 6 x 4 m whose walls a lidar sees all the time."""
    walls = np.concatenate([box(0, 0, 6, 4), box(2.6, 1.8, 3.4, 2.2)])
    round_ = [(1.5, 1.1), (4.5, 1.1), (4.5, 2.9), (1.5, 2.9)]
    points = np.array([*round_, *round_, round_[0]])
    return simulate(walls, points, seed, gyro=False, max_s=30.0)


def tags_on_walls(count: int = 10) -> FloatArray:
    """(n, 3) T_map_tag spread along the walls, facing inwards."""
    w, h = SIZE_M
    found = []
    for at in (np.arange(count) + 0.5) / count * 2.0 * (w + h):
        if at < w:
            found.append((at, 0.0, np.pi / 2))
        elif at < w + h:
            found.append((w, at - w, np.pi))
        elif at < 2 * w + h:
            found.append((2 * w + h - at, h, -np.pi / 2))
        else:
            found.append((0.0, 2 * (w + h) - at, 0.0))
    return np.array(found)


def surveyed(tags: FloatArray) -> tuple[KnownTag, ...]:
    covariance = np.diag(np.square([0.002, 0.002, 0.005]))
    return tuple(KnownTag(k, T_map_tag, covariance) for k, T_map_tag in enumerate(tags))


def observed(
    sim: Simulated, tags: FloatArray, seed: int, period_ns: int = 66_666_667
) -> tuple[TagObservation, ...]:
    """What the camera sees of the tags from the start of the drive to its end."""
    rng = np.random.default_rng([seed, 77])
    first, last = int(sim.truth.stamps_ns[0]), int(sim.truth.stamps_ns[-1])
    found = []
    for stamp_ns in range(first + 30_000_000, last, period_ns):
        T_map_base = sim.truth.at(np.array([stamp_ns]))[0]
        for number, T_map_tag in enumerate(tags):
            sighting = _sighting(compose(inverse(T_map_base), T_map_tag), number, CAMERA, rng)
            if sighting is not None:
                found.append(planar_observation(stamp_ns, sighting, T_BASE_CAMERA))
    return tuple(found)


def _sighting(
    T_base_tag: FloatArray, number: int, model: CameraModel, rng: np.random.Generator
) -> TagSighting | None:
    facing = se3_from_se2(T_base_tag)
    upright = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    T_base = facing @ se3_from_parts(upright, np.array([0.0, 0.0, 0.5]))
    T_camera_tag = np.linalg.inv(T_BASE_CAMERA) @ T_base
    if T_camera_tag[2, 3] < 0.3 or T_camera_tag[2, 2] > -0.2:  # behind, or from the side
        return None
    corners = square_corners(KIND.size_m) @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]
    pixels, seen = model.project(corners)
    sides = np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1)
    if not (seen & model.contains(pixels)).all() or sides.min() < LEAST_SIDE_PX:
        return None
    noise = NOISE_PX / float(model.focal_px[0])
    rays_xy = corners[:, :2] / corners[:, 2:] + rng.normal(0.0, noise, (4, 2))
    seen_corners = Corners(rays_xy, np.eye(8) * noise**2, pixels)
    pose = tag_pose(seen_corners, KIND.size_m)
    return None if pose is None else TagSighting(KIND, number, seen_corners, pose)


def mistaken(
    observations: tuple[TagObservation, ...], every: int, number: int
) -> tuple[TagObservation, ...]:
    """With each so-many-th observation under the number of another tag."""
    return tuple(
        replace(one, number=number) if k % every == 0 else one for k, one in enumerate(observations)
    )
