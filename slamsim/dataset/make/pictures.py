"""A picture of what the cameras of a sequence saw, for people who look into a data set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.dataset.store.images import TRUTH, ImageTable
from slamsim.dataset.store.place import Location
from slamsim.guard.output import write_atomic

PICTURES = "images/frames.png"
_ACROSS, _WIDTH_PX, _EDGE_PX = 3, 212, 4
_FAR_M = 6.0
"""Depths from here on have the last colour of the map."""


def write_pictures(folder: Path, tables: Sequence[str]) -> None:
    """``images/frames.png``: of each camera, and then of each truth, a row of three images.

    folder: of a sequence. tables: under ``images/``. Nothing is written without any.
    """
    if not tables:
        return
    truths = sorted(
        f"{TRUTH}{path.stem}"
        for path in (folder / "truth").glob("*.parquet")
        for table in tables
        if path.stem.startswith(f"{table}_") and not path.stem.endswith("_frame")
    )
    place = Location(str(folder.parent.resolve()))
    rows = [_row(ImageTable(place, folder.name, name)) for name in (*sorted(tables), *truths)]
    write_atomic(folder / PICTURES, encode_png(np.concatenate(rows), level=9))


def _row(table: ImageTable) -> NDArray[np.uint8]:
    """Images from the beginning, the middle and the end, side by side on white."""
    count = len(table.table)
    numbers = [(2 * place + 1) * count // (2 * _ACROSS) for place in range(_ACROSS)]
    shown = [_small(_coloured(table.at(number), table.name)) for number in numbers]
    height = shown[0].shape[0]
    row = np.full((height + _EDGE_PX, _ACROSS * (_WIDTH_PX + _EDGE_PX), 3), 255, np.uint8)
    for place, picture in enumerate(shown):
        left = place * (_WIDTH_PX + _EDGE_PX)
        row[:height, left : left + _WIDTH_PX] = picture
    return row


def _small(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height = round(pixels.shape[0] * _WIDTH_PX / pixels.shape[1])
    return np.asarray(cv2.resize(pixels, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA))


def _coloured(pixels: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """(h, w, 3) RGB: depth from near (blue) to far (red), black for none; labels each another."""
    if pixels.dtype == np.uint8 and not name.startswith(TRUTH):
        return pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
    if pixels.dtype == np.float32 and pixels.ndim == 2:
        near = np.nan_to_num(np.clip(255.0 * pixels / _FAR_M, 0.0, 255.0)).astype(np.uint8)
        mapped = cv2.applyColorMap(near, cv2.COLORMAP_TURBO)[:, :, ::-1]
        return np.where(np.isfinite(pixels)[:, :, None], mapped, 0).astype(np.uint8)
    if pixels.dtype == np.float32 and pixels.shape[2] == 3:  # normals
        return np.asarray(np.nan_to_num(127.5 * (pixels + 1.0)), np.uint8)
    if pixels.dtype == np.float32:
        return _flow(pixels)
    spread = (pixels.astype(np.int64) * 97 + 31) % 256  # neighbours in number differ in colour
    return np.asarray(cv2.applyColorMap(spread.astype(np.uint8), cv2.COLORMAP_HSV)[:, :, ::-1])


def _flow(flow_px: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Direction as hue, length as brightness up to the longest."""
    finite = np.nan_to_num(flow_px)
    length_px = np.hypot(finite[..., 0], finite[..., 1])
    hue = np.degrees(np.arctan2(finite[..., 1], finite[..., 0])) / 2.0 % 180.0
    value = 255.0 * length_px / max(float(length_px.max()), 1e-6)
    hsv = np.stack([hue, np.full_like(hue, 255.0), value], axis=2).astype(np.uint8)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB))
