"""Boards for calibration: how they are named, and where their corners are in an image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError, shown
from slamsim.perception.tag_families import FAMILIES, TagKind

LEAST_SIDE, MOST_SIDE = 2, 60
LARGEST_SQUARE_M = 5.0
FEWEST_CORNERS = 8
"""Of a ChArUco board that is seen in part; four tell no more than a pose."""
CHESSBOARD_AS, CHARUCO_AS = "chessboard:9x6:0.03", "charuco:9x6:0.03:0.022:aruco_5x5_100"


class UnknownBoard(SlamsimError):
    """A description of a board that is none."""

    exit_code = 2


@dataclass(frozen=True)
class Board:
    """columns, rows: of inner corners (chessboard) or of squares (ChArUco). tag: of the squares'
    tags, None for a chessboard."""

    columns: int
    rows: int
    square_m: float
    tag: TagKind | None = None

    def corners(self, grey: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray] | None:
        """(k, 3) points of the board and (k, 2) pixels where grey (h, w) shows them; None where it
        is not seen. A chessboard must be seen whole, its first corner being the upper left one."""
        return self._charuco(grey) if self.tag is not None else self._chessboard(grey)

    def _chessboard(self, grey: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray] | None:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
        size = (self.columns, self.rows)
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if not found:
            return None
        pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        if pixels[0].sum() > pixels[-1].sum():  # half a turn of the board looks the same
            pixels = pixels[::-1].copy()
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float64)
        return points * self.square_m, pixels

    def _charuco(self, grey: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray] | None:
        corners, numbers, _, _ = self._detector.detectBoard(grey)
        if numbers is None or len(numbers) < FEWEST_CORNERS:
            return None
        points = np.asarray(self._aruco.getChessboardCorners(), dtype=np.float64)
        return points[np.ravel(numbers)], np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    @cached_property
    def _aruco(self) -> cv2.aruco.CharucoBoard:
        assert self.tag is not None
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[self.tag.family]))
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square_m, self.tag.size_m, known)

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        return cv2.aruco.CharucoDetector(self._aruco)


def parse_board(text: str) -> Board:
    """``chessboard:9x6:0.03`` (inner corners, side of a square in metres) or
    ``charuco:9x6:0.03:0.022:aruco_5x5_100`` (squares, their side, that of the tags, family).

    Raises UnknownBoard, and UnknownTags for a family that is none.
    """
    kind, *words = text.split(":")
    try:
        columns, rows = (int(word) for word in words[0].lower().split("x"))
        lengths_m = [float(word) for word in words[1:3]]
    except (ValueError, IndexError):
        columns, rows, lengths_m = 0, 0, []
    if kind == "chessboard" and len(words) == 2 and lengths_m:
        board = Board(columns, rows, lengths_m[0])
    elif kind == "charuco" and len(words) == 4 and len(lengths_m) == 2:
        board = Board(columns, rows, lengths_m[0], TagKind(words[3], lengths_m[1]))
    else:
        raise UnknownBoard(
            f"{shown(text)} describes no board; right is, for example, {CHESSBOARD_AS} (inner "
            f"corners, side of a square in metres) or {CHARUCO_AS}"
        )
    _require_size(board, text)
    return board


def _require_size(board: Board, text: str) -> None:
    sides = (board.columns, board.rows)
    if min(sides) <= LEAST_SIDE or max(sides) > MOST_SIDE:
        raise UnknownBoard(
            f"{shown(text)}: a board has {LEAST_SIDE + 1} to {MOST_SIDE} corners along each side, "
            f"not {sides[0]} x {sides[1]}"
        )
    if not 0.0 < board.square_m <= LARGEST_SQUARE_M:
        raise UnknownBoard(
            f"{shown(text)}: a square is {board.square_m:g} m wide; it must be wider than 0 and at "
            f"most {LARGEST_SQUARE_M:g} m"
        )
    if board.tag is not None and board.tag.size_m >= board.square_m:
        raise UnknownBoard(
            f"{shown(text)}: tags of {board.tag.size_m:g} m do not fit into squares of "
            f"{board.square_m:g} m"
        )
