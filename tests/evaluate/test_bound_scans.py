"""Information of single scans: against a slow caster and numerical derivatives."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.config.lidar import DropoutConfig, LidarConfig, MixedReturnsConfig, RangeNoiseConfig
from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.evaluate.bound_scans import scan_information
from slamsim.evaluate.bound_walls import Faces, first_face, index_faces, wall_faces

T_BASE_LASER = np.array([[1, 0, 0, 0.1], [0, 1, 0, -0.05], [0, 0, 1, 0.2], [0, 0, 0, 1.0]])


def lidar(**changes: object) -> LidarConfig:
    plain = LidarConfig(
        rate_hz=10.0,
        angle_min_deg=-180.0,
        angle_step_deg=3.0,
        beam_count=120,
        resolution_m=0.0,
        range_min_m=0.0,
        max_incidence_deg=90.0,
        noise=RangeNoiseConfig(constant_m=0.01, proportional=0.0, spot_mrad=0.0),
        dropout=DropoutConfig(probability=0.0, at_max_range=0.0, at_grazing=0.0),
        mixed=MixedReturnsConfig(divergence_mrad=0.0),
    )
    return plain.model_copy(update=changes)


def polygon(rng: np.random.Generator, corners: int) -> FloatArray:
    """(n, 2, 2) the outline of a room about the origin, seen from inside: the solid is outside."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners)) + np.arange(corners) * 1e-3
    radius = rng.uniform(1.5, 6.0, corners)
    points = radius[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    ring = points[::-1]
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)


def distance(origin: FloatArray, direction: FloatArray, segment: FloatArray) -> float:
    """Along a ray to the straight line through a segment's ends."""
    along = segment[1] - segment[0]
    solved = np.linalg.solve(np.column_stack([direction, -along]), segment[0] - origin)
    return float(solved[0])


def nearest(origin: FloatArray, direction: FloatArray, segments: FloatArray) -> tuple[int, float]:
    best, which = np.inf, -1
    for number, segment in enumerate(segments):
        along = segment[1] - segment[0]
        facing = along[1] * direction[0] - along[0] * direction[1]
        if facing >= 0.0:
            continue
        solved = np.linalg.solve(np.column_stack([direction, -along]), segment[0] - origin)
        if 0.0 <= solved[0] < best and 0.0 <= solved[1] <= 1.0:
            best, which = solved[0], number
    return which, best


def standing(pose: FloatArray) -> PlanarTrajectory:
    return PlanarTrajectory(np.array([0, 10**9]), np.stack([pose, pose]))


def moved(faces: Faces, face: int, offset_m: float, angle_rad: float) -> FloatArray:
    """A face's ends after a step along its normal and a turn about its middle."""
    normal, middle = faces.normal[face], faces.middle_m[face]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned = np.array([[cos, -sin], [sin, cos]]) @ np.array([-normal[1], normal[0]])
    return np.asarray(middle + offset_m * normal + np.outer([-1.0, 1.0], turned))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
def test_the_first_face_is_the_nearest_that_faces_the_ray(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    room = polygon(rng, corners)
    outside = polygon(rng, 5) * 0.2 + rng.uniform(-3.0, 3.0, 2)
    faces = wall_faces(np.concatenate([room, outside[:, ::-1]]))
    index = index_faces(faces)
    for heading in rng.uniform(-np.pi, np.pi, 25):
        origin = rng.uniform(-8.0, 8.0, 2)
        ray = np.array([np.cos(heading), np.sin(heading)])
        at = (float(origin[0]), float(origin[1]), float(ray[0]), float(ray[1]))
        found = first_face(*at, 30.0, index)
        which, far = nearest(origin, ray, faces.ends_m)
        assert found[0] == which
        assert which < 0 or found[1] == pytest.approx(far, abs=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(3, 10))
def test_pieces_of_an_outline_are_joined_to_its_faces(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    room = polygon(rng, corners)
    pieces = []
    for start, end in room:
        cuts = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 1.0, 3)), [1.0]])
        points = start + cuts[:, None] * (end - start)
        pieces += [np.stack(pair) for pair in pairwise(points)]
        pieces.append(np.stack([points[0], points[2]]))
    faces = wall_faces(np.array(pieces)[rng.permutation(len(pieces))])
    middles = room.mean(axis=1)
    order = [int(np.argmin(np.linalg.norm(faces.middle_m - m, axis=1))) for m in middles]
    assert sorted(order) == list(range(len(faces)))
    np.testing.assert_allclose(faces.middle_m[order], middles, atol=1e-6)
    np.testing.assert_allclose(faces.ends_m[order], room, atol=1e-6)


def test_faces_apart_or_back_to_back_are_not_joined() -> None:
    outline = np.array(
        [[[0, 0], [1, 0]], [[1.1, 0], [2, 0]], [[1, 0], [0, 0]], [[0, 0.01], [1, 0.01]]],
        dtype=float,
    )
    faces = wall_faces(outline)
    assert len(faces) == 4
    assert sorted(faces.length_m.tolist()) == pytest.approx([0.9, 1.0, 1.0, 1.0])


@pytest.mark.long
@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(3, 10))
def test_information_is_that_of_numerical_derivatives(seed: int, corners: int) -> None:
    """d range / d (pose, wall) by moving poses and walls a little, one beam at a time, each from
    where the laser is at its own instant."""
    rng = np.random.default_rng(seed)
    faces = wall_faces(polygon(rng, corners))
    pose = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)])
    config = lidar()
    later = compose(pose, np.array([0.3, 0.1, 0.5]))
    drive = PlanarTrajectory(np.array([0, 10**8]), np.stack([pose, later]))
    stamp = np.zeros(1, dtype=np.int64)
    found = scan_information(faces, drive, stamp, T_BASE_LASER, config)
    information = np.zeros((3 + 2 * len(faces), 3 + 2 * len(faces)))
    step = 1e-6
    for number, beam in enumerate(np.deg2rad(-180.0 + 3.0 * np.arange(120))):
        driven = between(pose, drive.at(np.array([number * config.beam_dt_ns]))[0])

        def at(
            pose: FloatArray, beam: float = beam, driven: FloatArray = driven
        ) -> tuple[FloatArray, FloatArray]:
            laser = compose(compose(pose, driven), np.array([0.1, -0.05, beam]))
            return laser[:2], np.array([np.cos(laser[2]), np.sin(laser[2])])

        face = nearest(*at(pose), faces.ends_m)[0]
        if face < 0:
            continue
        row = np.zeros(len(information))
        for axis in range(3):
            nudge = step * np.eye(3)[axis]
            ends = [distance(*at(pose + s * nudge), faces.ends_m[face]) for s in (-1, 1)]
            row[axis] = (ends[1] - ends[0]) / (2 * step)
        for axis in range(2):
            nudge = step * np.eye(2)[axis]
            ends = [distance(*at(pose), moved(faces, face, *(s * nudge))) for s in (-1, 1)]
            row[3 + 2 * face + axis] = (ends[1] - ends[0]) / (2 * step)
        information += np.outer(row, row) / 0.01**2
    dense = np.zeros_like(information)
    dense[:3, :3] = found.pose[0]
    for face, cross, wall in zip(found.face, found.cross, found.wall, strict=True):
        place = slice(3 + 2 * face, 5 + 2 * face)
        dense[:3, place], dense[place, :3], dense[place, place] = cross, cross.T, wall
    size = np.sqrt(np.outer(information.diagonal(), information.diagonal())) + 1.0
    np.testing.assert_allclose(dense / size, information / size, atol=2e-5)


def test_noise_loss_and_reach_count_as_configured() -> None:
    faces = wall_faces(polygon(np.random.default_rng(2), 8))
    stamp, base = np.zeros(1, dtype=np.int64), standing(np.zeros(3))

    def information(**changes: object) -> FloatArray:
        return np.asarray(
            scan_information(faces, base, stamp, T_BASE_LASER, lidar(**changes)).pose[0]
        )

    plain = information()
    noise = RangeNoiseConfig(constant_m=0.02, proportional=0.0, spot_mrad=0.0)
    np.testing.assert_allclose(information(noise=noise), plain / 4.0)
    coarse = information(resolution_m=0.01 * np.sqrt(12.0))
    np.testing.assert_allclose(coarse, plain / 2.0)
    half = DropoutConfig(probability=0.5, at_max_range=0.0, at_grazing=0.0)
    np.testing.assert_allclose(information(dropout=half), plain / 2.0)
    assert np.all(information(range_max_m=0.5) == 0.0)
    assert np.all(information(range_min_m=20.0, range_max_m=30.0) == 0.0)
    slanted = information(max_incidence_deg=45.0)
    assert np.all(np.linalg.eigvalsh(plain - slanted) > -1e-6)


def test_a_share_of_the_beams_stands_for_all() -> None:
    faces = wall_faces(polygon(np.random.default_rng(3), 9))
    stamps = np.arange(0, 64, dtype=np.int64)
    fine = lidar(angle_step_deg=0.25, beam_count=1081)
    base = standing(np.array([0.2, -0.1, 0.3]))
    every = scan_information(faces, base, stamps[:1], T_BASE_LASER, fine)
    some = scan_information(faces, base, stamps, T_BASE_LASER, fine, beam_stride=4)
    np.testing.assert_allclose(some.pose.mean(axis=0), every.pose[0], rtol=0.01, atol=1e3)
    assert some.returns / 64 == pytest.approx(every.returns, rel=0.01)
