"""Camera models beside OpenCV's, on random lenses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers

SMALL = st.floats(-0.15, 0.15)
TANGENTIAL = st.floats(-0.005, 0.005)


@st.composite
def lenses(draw: st.DrawFn) -> CameraModel:
    """Cameras of some 60 to 110 degrees whose distortion does not fold."""
    model = draw(st.sampled_from(["plumb_bob", "rational_polynomial", "equidistant"]))
    if model == "equidistant":
        values = [draw(SMALL) * 0.3 for _ in range(4)]
    else:
        radial = [draw(SMALL) for _ in range(4 if model == "rational_polynomial" else 1)]
        tangential = [draw(TANGENTIAL), draw(TANGENTIAL)]
        values = [draw(SMALL), draw(SMALL), *tangential, *radial]
    width, height = draw(st.integers(16, 90)), draw(st.integers(12, 70))
    focal = width / draw(st.floats(1.2, 2.8))
    K = np.array(
        [
            [focal, 0.0, 0.5 * width + draw(st.floats(-2.0, 2.0))],
            [0.0, focal * draw(st.floats(0.8, 1.2)), 0.5 * height + draw(st.floats(-2.0, 2.0))],
            [0.0, 0.0, 1.0],
        ]
    )
    camera = CameraModel(width, height, K, model, np.array(values))
    assume(not camera.folds())
    return camera


def projected_by_opencv(camera: CameraModel, points_m: FloatArray) -> FloatArray:
    still = np.zeros(3)
    view = (points_m[:, None], still, still, camera.K, camera.coefficients)
    fisheye = camera.distortion_model == "equidistant"
    pixels, _ = (cv2.fisheye.projectPoints if fisheye else cv2.projectPoints)(*view)
    return np.asarray(pixels[:, 0])


def pixels_of(camera: CameraModel) -> FloatArray:
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


@settings(max_examples=25)
@given(lenses(), st.floats(0.1, 50.0))
def test_rays_are_those_that_opencv_projects_back(camera: CameraModel, far_m: float) -> None:
    points_m = far_m * camera.rays()
    ahead = points_m[:, 2] > 0.05  # cv2.fisheye takes a point behind the camera for one before it
    pixels, seen = camera.project(points_m)
    assert seen.all()
    np.testing.assert_allclose(pixels, pixels_of(camera), atol=1e-9)
    again = projected_by_opencv(camera, points_m[ahead])
    np.testing.assert_allclose(again, pixels_of(camera)[ahead], atol=1e-9)


@settings(max_examples=15)
@given(lenses())
def test_rays_are_those_of_opencv_where_its_iteration_ends(camera: CameraModel) -> None:
    pixels, rays = pixels_of(camera), camera.rays()
    if camera.distortion_model == "equidistant":
        plane = cv2.fisheye.undistortPoints(pixels[:, None], camera.K, camera.coefficients)
    else:
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
        view = (pixels[:, None], camera.K, camera.coefficients)
        plane = cv2.undistortPoints(*view, criteria=until)
    points_m = np.column_stack([plane[:, 0], np.ones(len(pixels))])
    # Its fixed-point iteration diverges far from the axis, which its own projection tells.
    off_px = np.abs(projected_by_opencv(camera, points_m) - pixels).max(axis=1)
    ended = (off_px < 1e-9) & (rays[:, 2] > 0.05)
    assume(ended.mean() > 0.5)
    ours, theirs = (rays / rays[:, 2:])[ended, :2], points_m[ended, :2]
    # It also ends behind a fold: the same image, farther from the axis.
    behind = np.linalg.norm(theirs, axis=1) > np.linalg.norm(ours, axis=1) + 1e-3
    assert behind.mean() < 0.2
    np.testing.assert_allclose(ours[~behind], theirs[~behind], atol=1e-6)


def test_opencv_agrees_on_points_in_view() -> None:
    """Not along rays of pixels: random points, some of them outside of the picture."""
    rng = np.random.default_rng(0)
    points_m = rng.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 5.0], (1000, 3))
    for model, coefficients in CASES.items():
        camera = pinhole(640, 480, 80.0, model, np.array(coefficients))
        pixels, seen = camera.project(points_m)
        assert seen.mean() > 0.9
        expected = projected_by_opencv(camera, points_m)
        np.testing.assert_allclose(pixels[seen], expected[seen], atol=1e-9)


CASES = {
    "plumb_bob": [-0.28, 0.07, 0.0002, -0.0003, 0.0],
    "rational_polynomial": [0.5, 0.1, 0.001, -0.002, 0.01, 0.8, 0.3, 0.02],
    "equidistant": [-0.007, 0.046, -0.04, 0.007],
}


@settings(max_examples=20)
@given(st.floats(-0.9, 0.4), st.floats(-0.4, 0.4), st.floats(30.0, 120.0), TANGENTIAL, TANGENTIAL)
def test_folding_is_seen_where_a_slow_walk_outwards_sees_it(
    k1: float, k2: float, fov_deg: float, p1: float, p2: float
) -> None:
    """The image of a finely stepped ray outwards turns back, or never reaches the corner."""
    camera = pinhole(64, 48, fov_deg, "plumb_bob", np.array([k1, k2, p1, p2]))
    corners = np.array([[-0.5, -0.5], [63.5, -0.5], [-0.5, 47.5], [63.5, 47.5]])
    reach = float(np.hypot(*((corners[0] - camera.centre_px) / camera.focal_px)))
    radii = np.linspace(0.0, 40.0, 400_001)
    images = radii * (1.0 + k1 * radii**2 + k2 * radii**4)
    turned = np.flatnonzero(np.diff(images) <= 0.0)
    highest = images[turned[0]] if turned.size else images[-1]
    # Tangential terms move the corner by a few times their size.
    margin = 12.0 * max(abs(p1), abs(p2)) * (1.0 + reach**2) + 1e-3
    assume(abs(highest - reach) > margin)
    assert camera.folds() == (highest < reach)


def test_a_distortion_that_folds_gives_no_rays() -> None:
    camera = pinhole(64, 48, 90.0, "plumb_bob", np.array([-0.6]))
    assert camera.folds()
    with pytest.raises(BadNumbers, match=r"plumb_bob \[-0.6\] folds inside the image"):
        camera.rays()


def test_what_a_fold_brings_back_into_the_picture_is_not_seen() -> None:
    camera = pinhole(64, 48, 60.0, "plumb_bob", np.array([-0.2]))
    outside = np.array([[2.2, 0.0, 1.0], [0.0, 0.0, -1.0], [0.1, 0.0, -1.0], [0.1, 0.0, 0.0]])
    pixels, seen = camera.project(outside)
    assert camera.contains(pixels)[0]
    assert not seen.any()


def test_a_fisheye_sees_behind_itself() -> None:
    camera = pinhole(200, 200, 220.0, "equidistant")
    rays = camera.rays()
    assert rays[:, 2].min() < -0.3
    pixels, seen = camera.project(2.0 * rays)
    assert seen[np.hypot(rays[:, 0], rays[:, 1]) > 1e-3].all()
    np.testing.assert_allclose(pixels, pixels_of(camera), atol=1e-9)


GOOD = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]])


def changed(row: int, column: int, value: float) -> FloatArray:
    K = GOOD.copy()
    K[row, column] = value
    return K


@pytest.mark.parametrize(
    ("width", "K", "model", "given", "told"),
    [
        (0, GOOD, "plumb_bob", [], "the width of an image must be a whole number from 1"),
        (64, np.zeros((3, 3)), "plumb_bob", [], "is singular"),
        (64, changed(1, 1, 0.0), "plumb_bob", [], "is singular"),
        (64, changed(2, 2, 0.0), "plumb_bob", [], "is singular"),
        (64, changed(0, 0, -50.0), "plumb_bob", [], "focal length along x"),
        (64, changed(0, 1, 0.3), "plumb_bob", [], "is not of the form"),
        (64, changed(0, 0, np.nan), "plumb_bob", [], "not finite"),
        (64, GOOD[:2], "plumb_bob", [], "an array of"),
        (64, GOOD, "plum_bob", [], "did you mean 'plumb_bob'"),
        (64, GOOD, "fisheye62", [], "is not one of plumb_bob, rational_polynomial, equidistant"),
        (64, GOOD, "equidistant", [0.0] * 5, "has 4 coefficients, not 5"),
        (64, GOOD, "plumb_bob", [np.inf], "not finite"),
    ],
)
def test_what_is_no_camera_is_refused(
    width: int, K: FloatArray, model: str, given: list[float], told: str
) -> None:
    with pytest.raises(BadNumbers, match=told):
        CameraModel(width, 48, K, model, np.array(given))
