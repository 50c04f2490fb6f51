"""Pictures of a chessboard by a camera without distortion, drawn by homographies."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import matrix_from_rpy
from slamsim.perception.calibration.boards import Board

BOARD, TYPED = Board(7, 5, 0.03), "chessboard:7x5:0.03"
MODEL = pinhole(320, 240, 60.0)
PX_A_SQUARE = 40


def drawn(board: Board = BOARD) -> NDArray[np.uint8]:
    """Head-on, 40 px a square, with a white margin of one square and a half."""
    squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
    inner = np.kron(squares, np.ones((PX_A_SQUARE, PX_A_SQUARE))) * 200.0 + 20.0
    return np.pad(inner, 3 * PX_A_SQUARE // 2, constant_values=220.0).astype(np.uint8)


def board_views(count: int, seed: int = 0, tilt: float = 0.6) -> list[NDArray[np.uint8]]:
    """(h, w) images, most of which show the board whole."""
    rng = np.random.default_rng([seed, 9])
    return [_view(MODEL, rng, tilt) for _ in range(count)]


def _view(model: CameraModel, rng: np.random.Generator, tilt: float) -> NDArray[np.uint8]:
    turn = matrix_from_rpy(*rng.uniform(-tilt, tilt, 3))
    middle = np.array([rng.uniform(-0.06, 0.06), rng.uniform(-0.04, 0.04), rng.uniform(0.3, 0.5)])
    half = 0.5 * BOARD.square_m * np.array([BOARD.columns - 1, BOARD.rows - 1])
    shift = middle - turn[:, :2] @ half
    onto = model.K @ np.column_stack([turn[:, :2], shift])
    # Pixels of the drawing to metres on the board, whose origin is its first inner corner.
    scale = BOARD.square_m / PX_A_SQUARE
    first_px = 2.5 * PX_A_SQUARE - 0.5
    metres = np.array([[scale, 0, -scale * first_px], [0, scale, -scale * first_px], [0, 0, 1]])
    size = (model.width * 4, model.height * 4)
    larger = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1]])
    large = cv2.warpPerspective(drawn(), larger @ onto @ metres, size, borderValue=(120.0,))
    small = cv2.resize(large, (model.width, model.height), interpolation=cv2.INTER_AREA)
    noisy = small + rng.normal(0.0, 1.0, small.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def write_views(folder: Path, views: list[NDArray[np.uint8]]) -> None:
    """Pictures in color/, of a camera of which nothing is claimed."""
    (folder / "color").mkdir(parents=True)
    for number, grey in enumerate(views):
        (folder / "color" / f"{number:05d}.png").write_bytes(encode_png(grey))
