"""Lenses from a board, beside what made the images and beside OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.perception.calibration.boards import Board, parse_board
from slamsim.perception.calibration.lens import FEWEST_VIEWS, LensFit, fit_lens, fit_pair
from slamsim.perception.calibration.mount import TooFew
from slamsim.perception.calibration.projection import lens_names
from slamsim.perception.calibration.rig import Sighting
from slamsim.run.cameras.calibration_report import is_lens_told

BOARD = Board(9, 6, 0.03)
NOISE_PX = 0.1
SIZE = (640, 480)
BROWN = CameraModel(
    *SIZE,
    np.array([[612.0, 0, 325.0], [0, 609.0, 236.0], [0, 0, 1]]),
    "plumb_bob",
    np.array([-0.15, 0.06, 1e-3, -5e-4, 0.0]),
)
FISHEYE = pinhole(*SIZE, 170.0, "equidistant", np.array([-0.01, 0.003]))
RATIONAL = CameraModel(*SIZE, BROWN.K, "rational_polynomial", np.array([0.3, 0.1, 0, 0, 0, 0.4]))


def points() -> FloatArray:
    x, y = np.meshgrid(np.arange(9.0), np.arange(6.0))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(54)]) * BOARD.square_m


def seen(
    models: tuple[CameraModel, ...], T_second_first: FloatArray, seed: int, views: int, tilt: float
) -> list[Sighting]:
    """Whole boards before one or two cameras, with noise."""
    rng = np.random.default_rng(seed)
    found: list[Sighting] = []
    view = 0
    while view < views:
        turn = matrix_from_rpy(*rng.uniform(-tilt, tilt, 3))
        middle = np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), rng.uniform(0.3, 0.8)])
        T = se3_from_parts(turn, middle - turn @ points().mean(axis=0))
        images = []
        for camera, model in enumerate(models):
            T_camera_board = (T_second_first if camera else np.eye(4)) @ T
            pixels, there = model.project(
                points() @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
            )
            if there.all() and model.contains(pixels).all():
                noisy = pixels + rng.normal(0.0, NOISE_PX, (54, 2))
                images.append(Sighting(view, camera, points(), noisy))
        if len(images) == len(models):
            found += images
            view += 1
    return found


def errors(found: CameraModel, true: CameraModel) -> FloatArray:
    size = len(lens_names(true))
    told, so = np.zeros(size - 4), np.zeros(size - 4)
    told[: len(found.coefficients)] = found.coefficients
    so[: len(true.coefficients)] = true.coefficients
    places = ([0, 1, 0, 1], [0, 1, 2, 2])
    return np.concatenate([(found.K - true.K)[places], told - so])


@pytest.mark.parametrize("true", [BROWN, FISHEYE])
def test_a_lens_is_found_within_its_sigmas(true: CameraModel) -> None:
    found = fit_lens(seen((true,), np.eye(4), 1, 12, 0.6), SIZE, true.distortion_model)
    off, sigmas = errors(found.models[0], true), found.lens_sigmas(0)
    assert (np.abs(off) < 4.5 * sigmas).all()
    assert sigmas[:2].max() < 3.0 and np.abs(off[:2]).max() < 5.0
    assert found.residual_px[0] == pytest.approx(NOISE_PX * np.sqrt(2.0), rel=0.15)
    assert 0.2 < found.coverage[0] <= 1.0


def test_a_rational_lens_maps_pixels_to_the_same_rays() -> None:
    found = fit_lens(seen((RATIONAL,), np.eye(4), 2, 12, 0.6), SIZE, "rational_polynomial")
    pixels = np.array([[100.0, 80.0], [320.0, 240.0], [540.0, 400.0], [200.0, 350.0]])
    again, _ = RATIONAL.project(found.models[0].rays_at(pixels))
    # Coefficients trade with each other; where pixels look does not.
    assert np.abs(again - pixels).max() < 3.0


def test_it_is_what_opencv_finds() -> None:
    sightings = seen((BROWN,), np.eye(4), 3, 15, 0.6)
    found = fit_lens(sightings, SIZE)
    images = [each.pixels.astype(np.float32) for each in sightings]
    boards = [each.points_m.astype(np.float32) for each in sightings]
    _, K, _, _, _, sigmas, _, _ = cv2.calibrateCameraExtended(
        boards, images, SIZE, np.eye(3), np.zeros(5)
    )
    ours = found.models[0].K[[0, 1, 0, 1], [0, 1, 2, 2]]
    theirs, theirs_sigmas = np.asarray(K)[[0, 1, 0, 1], [0, 1, 2, 2]], np.ravel(sigmas)[:4]
    # Weights of single corners differ: by less than a sigma.
    assert (np.abs(ours - theirs) < theirs_sigmas).all()
    assert (found.lens_sigmas(0)[:4] / theirs_sigmas < 3.0).all()
    assert (found.lens_sigmas(0)[:4] / theirs_sigmas > 0.4).all()


def test_a_pair_is_found_where_it_is() -> None:
    T = se3_from_parts(matrix_from_rpy(0.01, -0.02, 0.005), np.array([-0.12, 0.002, 0.003]))
    sightings = seen((BROWN, BROWN), T, 4, 12, 0.5)
    lenses: list[LensFit] = []
    for camera in (0, 1):
        mine = [each for each in sightings if each.camera == camera]
        lenses.append(fit_lens([Sighting(s.view, 0, s.points_m, s.pixels) for s in mine], SIZE))
    found = fit_pair(sightings, lenses)
    shift = found.T_camera_first[1, :3, 3] - T[:3, 3]
    sigmas = found.place_sigmas(1)
    assert (np.abs(shift) < 4.5 * sigmas[:3]).all() and np.abs(shift).max() < 0.002
    turn = found.T_camera_first[1, :3, :3] @ T[:3, :3].T
    angles = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
    assert (np.abs(angles) < 4.5 * sigmas[3:]).all() and np.abs(angles).max() < 0.005
    with pytest.raises(TooFew, match="0 images of the same instant"):
        fit_pair([s for s in sightings if (s.view + s.camera) % 2], lenses)


def test_views_that_are_alike_are_one() -> None:
    one = seen((BROWN,), np.eye(4), 5, 1, 0.3)[0]
    rng = np.random.default_rng(0)
    alike = [
        Sighting(k, 0, one.points_m, one.pixels + rng.normal(0.0, 0.3, (54, 2))) for k in range(30)
    ]
    with pytest.raises(TooFew, match=f"30 images, of which 1 differ .*{FEWEST_VIEWS} are needed"):
        fit_lens(alike, SIZE)


def test_a_board_that_is_never_tilted_does_not_tell_the_focal_length() -> None:
    plain = CameraModel(*SIZE, BROWN.K)
    found = fit_lens(seen((plain,), np.eye(4), 6, 14, 0.0), SIZE)
    assert not is_lens_told(found)


@pytest.mark.slow
def test_intervals_hold() -> None:
    """Of 60 calibrations, in 93 to 97 %, focal lengths and centre together."""
    inside: list[bool] = []
    for seed in range(60):
        found = fit_lens(seen((BROWN,), np.eye(4), 100 + seed, 15, 0.6), SIZE)
        off, sigmas = errors(found.models[0], BROWN)[:4], found.lens_sigmas(0)[:4]
        inside += (np.abs(off) < 1.96 * sigmas).tolist()
    assert 0.91 <= np.mean(inside) <= 0.98


def drawn(board: Board) -> FloatArray:
    """A picture of a chessboard, head-on, 40 px a square."""
    squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
    inner = np.kron(squares, np.ones((40, 40))) * 200.0 + 20.0
    return np.pad(inner, 60, constant_values=220.0)


def test_corners_of_a_chessboard_are_found_where_they_are() -> None:
    grey = cv2.GaussianBlur(drawn(BOARD).astype(np.uint8), (0, 0), 1.0)
    found = BOARD.corners(np.asarray(grey, dtype=np.uint8))
    assert found is not None
    expected = 60.0 + 40.0 * (1.0 + points()[:, :2] / BOARD.square_m) - 0.5
    assert np.abs(found[1] - expected).max() < 0.1
    assert BOARD.corners(np.full((200, 300), 90, np.uint8)) is None


def test_a_charuco_board_is_found_in_part() -> None:
    board = parse_board("charuco:6x5:0.04:0.03:aruco_4x4_50")
    picture = np.asarray(board._aruco.generateImage((600, 500), marginSize=20), dtype=np.uint8)
    found = board.corners(picture)
    assert found is not None and len(found[0]) == 20
    part = board.corners(np.ascontiguousarray(picture[:, :400]))
    assert part is not None and 8 <= len(part[0]) < 20
    assert board.corners(np.full((200, 300), 90, np.uint8)) is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("chessboard", "describes no board; right is, for example, chessboard:9x6:0.03"),
        ("checkerboard:9x6:0.03", "describes no board"),
        ("chessboard:9:0.03", "describes no board"),
        ("chessboard:9x6:wide", "describes no board"),
        ("chessboard:9x6:0", "a square is 0 m wide"),
        ("chessboard:9x6:nan", "a square is nan m wide"),
        ("chessboard:1x6:0.03", "3 to 60 corners"),
        ("charuco:9x6:0.03:0.04:aruco_5x5_100", "do not fit into squares"),
        ("charuco:9x6:0.03:0.02:aruco_5x5", "no family of tags; did you mean"),
    ],
)
def test_wrong_boards_are_refused(text: str, said: str) -> None:
    with pytest.raises(SlamsimError, match=said) as refused:
        parse_board(text)
    assert refused.value.exit_code == 2
