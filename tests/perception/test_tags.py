"""Tags in images: which, where, and whether the error is as large as is claimed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from tag_images import draw_tags, random_tag_pose

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.guard.numbers import BadNumbers
from slamsim.perception.tag_edges import Corners, refine_corners
from slamsim.perception.tag_families import FAMILIES, TagKind, UnknownTags, parse_tags
from slamsim.perception.tag_pose import moved, square_corners, step_between, tag_pose
from slamsim.perception.tags import TagDetector, TagSighting, linear_light

KIND = TagKind("apriltag_36h11", 0.2)
PINHOLE = pinhole(320, 240, 69.0)
LENS = pinhole(320, 240, 69.0, "plumb_bob", np.array([-0.28, 0.09, 0.001, -0.0005, 0.0]))
FISHEYE = pinhole(320, 240, 120.0, "equidistant", np.array([-0.01, 0.002, 0.0, 0.0]))
LIGHT = np.linspace(0.0, 1.0, 256)
AS_CODED = np.rint(
    255 * np.where(LIGHT <= 0.0031308, 12.92 * LIGHT, 1.055 * LIGHT ** (1 / 2.4) - 0.055)
).astype(np.uint8)
"""What sRGB makes of light from 0 to 255."""


def _one(model: CameraModel, T: np.ndarray, seed: int, **image: float) -> TagSighting | None:
    rng = np.random.default_rng(seed)
    seen = TagDetector(KIND, model).detect(draw_tags(model, [(KIND, 5, T)], rng, **image))
    return seen[0] if seen else None


@pytest.mark.parametrize("family", ["apriltag_36h11", "aruco_4x4_50", "aruco_6x6_250"])
def test_a_tag_is_found_where_it_was_drawn(family: str) -> None:
    kind, rng = TagKind(family, 0.16), np.random.default_rng(1)
    T = random_tag_pose(PINHOLE, rng, (0.8, 0.8), 0.6)
    image = draw_tags(PINHOLE, [(kind, 7, T)], rng)

    (seen,) = TagDetector(kind, PINHOLE).detect(image)

    assert (seen.number, seen.kind) == (7, kind)
    step = step_between(seen.pose.T_camera_tag, T)
    assert np.abs(step[:3]).max() < 0.004
    assert np.abs(step[3:]).max() < 0.02
    corners, _ = PINHOLE.project(square_corners(0.16) @ T[:3, :3].T + T[:3, 3])
    assert np.abs(seen.corners_px - corners).max() < 0.1


@pytest.mark.long
@pytest.mark.parametrize("model", [LENS, FISHEYE], ids=["brown", "fisheye"])
def test_the_lens_is_taken_out(model: CameraModel) -> None:
    for seed in range(4):
        T = random_tag_pose(model, np.random.default_rng(seed), (0.45, 0.9), 0.8)
        seen = _one(model, T, seed)

        assert seen is not None
        step = step_between(seen.pose.T_camera_tag, T)
        true, _ = model.project(square_corners(0.2) @ T[:3, :3].T + T[:3, 3])
        assert np.sqrt(np.mean((seen.corners_px - true) ** 2)) < 0.15
        assert np.abs(step[:3]).max() < 0.01


@pytest.mark.long
@pytest.mark.parametrize(
    "model",
    [pytest.param(LENS, id="brown", marks=pytest.mark.slow), pytest.param(FISHEYE, id="fisheye")],
)
def test_edges_of_large_tags_are_looked_for_where_the_lens_bends_them(model: CameraModel) -> None:
    """Their middles lie up to two pixels beside the straight line from corner to corner."""
    off_px, nees = [], []
    for seed in range(12):
        T = random_tag_pose(model, np.random.default_rng(seed), (0.3, 0.5), 0.4)
        seen = _one(model, T, seed)
        if seen is None:
            continue
        true, _ = model.project(square_corners(0.2) @ T[:3, :3].T + T[:3, 3])
        off_px.append(np.sqrt(np.mean((seen.corners_px - true) ** 2)))
        step = step_between(seen.pose.T_camera_tag, T)
        nees.append(step @ np.linalg.solve(seen.pose.covariance, step))
    assert len(nees) >= 7
    assert max(off_px) < 0.08
    assert np.mean(nees) < 9.0


@pytest.mark.slow
def test_errors_are_as_large_as_claimed() -> None:
    """Over random views, blurs and noises: 95 % within what the covariance says 95 % are in."""
    rng = np.random.default_rng(2031)
    nees, errors, claimed = [], [], []
    for number in range(48):
        T = random_tag_pose(PINHOLE, rng, (0.35, 2.4))
        image = {"blur_px": rng.uniform(0.4, 1.1), "noise": rng.uniform(1.0, 4.0)}
        seen = _one(PINHOLE, T, number, **image)
        if seen is None or seen.pose.is_ambiguous:
            continue
        step = step_between(seen.pose.T_camera_tag, T)
        nees.append(step @ np.linalg.solve(seen.pose.covariance, step))
        errors.append(step[:3])
        claimed.append(np.trace(seen.pose.covariance[:3, :3]))

    chi2_95 = 12.59  # of six degrees of freedom
    assert len(nees) > 26
    assert 0.90 <= np.mean(np.array(nees) < chi2_95) <= 1.0
    assert 3.0 < np.mean(nees) < 8.0
    assert np.median(np.linalg.norm(errors, axis=1)) < np.sqrt(np.median(claimed)) * 1.2


def test_corners_are_nearer_than_opencvs() -> None:
    """The sweep by which the lines were chosen, in small; see ``tag_edges``."""
    rng = np.random.default_rng(3)
    ours, theirs = [], []
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    for _ in range(9):
        T = random_tag_pose(PINHOLE, rng, (0.5, 1.2), 0.9)
        image = draw_tags(PINHOLE, [(KIND, 5, T)], rng)
        true, _ = PINHOLE.project(square_corners(0.2) @ T[:3, :3].T + T[:3, 3])
        seen, found = TagDetector(KIND, PINHOLE).detect(image), detector.detectMarkers(image)[0]
        if seen and found:
            ours.append(np.sqrt(np.mean((seen[0].corners_px - true) ** 2)))
            theirs.append(np.sqrt(np.mean((found[0][0] - true) ** 2)))

    assert np.median(ours) < 0.06
    assert np.median(theirs) > 3.0 * np.median(ours)


def test_what_fits_both_ways_is_told() -> None:
    """A small tag seen head-on from afar: both tilts fit, and the covariance spans both."""
    T = random_tag_pose(PINHOLE, np.random.default_rng(4), (2.2, 2.2), 0.0)
    T = moved(T, np.array([0, 0, 0, 0.25, 0.1, 0]))
    wrong = 0
    for seed in range(6):
        seen = _one(PINHOLE, T, seed, noise=4.0)
        assert seen is not None
        step = step_between(seen.pose.T_camera_tag, T)
        if seen.pose.other is not None:
            nearer = step_between(seen.pose.other, T)
            if np.linalg.norm(nearer[3:]) < np.linalg.norm(step[3:]):
                wrong += 1
        else:
            assert np.linalg.norm(step[3:]) < 0.3
        assert step @ np.linalg.solve(seen.pose.covariance, step) < 30.0
    assert wrong < 6


@pytest.mark.long
def test_edges_are_where_the_light_is_half_way() -> None:
    """Coded as sRGB, tags look smaller; in linear light they are as large as they are."""
    plain, linear = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        T = random_tag_pose(PINHOLE, rng, (1.0, 1.0), 0.4)
        grey = AS_CODED[draw_tags(PINHOLE, [(KIND, 5, T)], rng)]
        detector = TagDetector(KIND, PINHOLE)
        (as_coded,) = detector.detect(grey)
        (as_light,) = detector.detect(grey, linear_light(np.dstack([grey] * 3)))
        plain.append(as_coded.pose.T_camera_tag[2, 3] - T[2, 3])
        linear.append(as_light.pose.T_camera_tag[2, 3] - T[2, 3])

    assert np.mean(plain) > 0.002
    assert abs(np.mean(linear)) < 0.001


@pytest.mark.long
@pytest.mark.parametrize(
    ("codes", "is_colour"),
    [
        pytest.param(True, True, id="coded-colour"),
        pytest.param(False, False, id="as light-grey"),
        pytest.param(True, False, id="coded-grey", marks=pytest.mark.slow),
        pytest.param(False, True, id="as light-colour", marks=pytest.mark.slow),
    ],
)
def test_edges_tell_whether_pixels_are_light(codes: bool, is_colour: bool) -> None:
    """Colours that are not coded, as simulators draw them, and grey images that are."""
    detector, found = TagDetector(KIND, PINHOLE), []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        T = random_tag_pose(PINHOLE, rng, (0.8, 1.6), 0.4)
        drawn = draw_tags(PINHOLE, [(KIND, 5, T)], rng)
        grey = AS_CODED[drawn] if codes else drawn
        light = linear_light(np.dstack([grey] * 3)) if is_colour else None
        found += [(seen, T[2, 3]) for seen in detector.detect(grey, light)]
        if len(found) < 10:  # too few to say that the usual reading is wrong
            assert all(detector.settled(seen) is seen for seen, _ in found)

    off = [detector.settled(seen).pose.T_camera_tag[2, 3] / far_m - 1.0 for seen, far_m in found]
    assert len(off) > 20 and abs(np.median(off)) < 0.0015
    usual = codes == is_colour
    assert all((detector.settled(seen) is seen) == usual for seen, _ in found)


def test_exact_corners_give_the_exact_pose() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        T = random_tag_pose(PINHOLE, rng, (0.5, 3.0))
        points = square_corners(0.2) @ T[:3, :3].T + T[:3, 3]
        rays_xy = points[:, :2] / points[:, 2:]
        pose = tag_pose(Corners(rays_xy, np.eye(8) * 1e-10, np.zeros((4, 2))), 0.2)

        assert pose is not None
        assert np.abs(step_between(pose.T_camera_tag, T)).max() < 1e-6


def test_what_is_no_square_is_refused() -> None:
    points = square_corners(0.2)[:, :2] / 0.8
    bent = points + np.array([[0.05, 0], [0, 0], [-0.05, 0.02], [0, 0]])

    assert tag_pose(Corners(bent, np.eye(8) * 1e-8, np.zeros((4, 2))), 0.2) is None


def test_a_number_seen_twice_is_left_out() -> None:
    rng = np.random.default_rng(6)
    places = [
        moved(np.diag([1.0, -1.0, -1.0, 1.0]), np.array([x, 0, 1, 0, 0, 0]))
        for x in (-0.35, 0.0, 0.35)
    ]
    tags = [(KIND, number, T) for number, T in zip((3, 9, 3), places, strict=True)]

    seen = TagDetector(KIND, PINHOLE).detect(draw_tags(PINHOLE, tags, rng))

    assert [sighting.number for sighting in seen] == [9]


def test_nothing_is_found_in_an_empty_image() -> None:
    noise = np.random.default_rng(7).integers(0, 255, (240, 320), dtype=np.uint8)

    assert TagDetector(KIND, PINHOLE).detect(np.full((240, 320), 80, np.uint8)) == ()
    assert TagDetector(KIND, PINHOLE).detect(noise) == ()
    assert refine_corners(np.zeros((240, 320), np.float32), np.eye(4, 2) * 50, 8, PINHOLE) is None


def test_an_image_of_another_size_is_refused() -> None:
    detector = TagDetector(KIND, PINHOLE)
    with pytest.raises(BadNumbers, match=r"\(240, 320\)"):
        detector.detect(np.zeros((480, 640), np.uint8))
    with pytest.raises(BadNumbers, match="uint8"):
        detector.detect(np.zeros((240, 320), np.uint16))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("apriltag_36h1:0.2", "apriltag_36h11"),
        ("apriltag_36h11", "family and size"),
        ("apriltag_36h11:big", "family and size"),
        ("aruco_4x4_50:-1", "wider than 0"),
        ("aruco_4x4_50:nan", "wider than 0"),
        ("", "family and size"),
    ],
)
def test_what_names_no_tags_is_refused(text: str, told: str) -> None:
    with pytest.raises(UnknownTags, match=told):
        parse_tags(text)


def test_tags_are_named_as_they_are_typed() -> None:
    assert parse_tags("apriltag_36h11:0.2") == KIND
    assert all(hasattr(cv2.aruco, name) for name in FAMILIES.values())
