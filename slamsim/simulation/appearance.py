"""The looks of a world as cameras ask for them; drives in pieces that cameras can be sensed in."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache

import numpy as np

from slamsim.cameras.appearance import Appearance
from slamsim.config.looks import LooksConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Drive
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.world.looks.build import build_looks
from slamsim.world.model import World

_PIECE_STEPS = 120
"""Half a second of the default physics: of images of the truth no more are held in memory."""


def appearance_of(world: World, config: LooksConfig) -> Callable[[], Appearance]:
    """What gives the looks of a world, which are made when the first camera asks."""

    @cache
    def made() -> Appearance:
        return build_looks(world, config)

    return made


def casting_threads(sensors: SensorsConfig) -> int:
    """All cores where there are cameras, whose rays are many; what is sensed is the same."""
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    return (os.cpu_count() or 1) if has_cameras else 1


def in_pieces(window: Drive, sensors: SensorsConfig) -> Iterator[Drive]:
    """A window as it is, or in short pieces where there are cameras, whose images fill memory.

    What is sensed does not depend on it.
    """
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    if not has_cameras or len(window) <= 2 * _PIECE_STEPS:
        yield window
        return
    starts = np.arange(0, len(window) - _PIECE_STEPS, _PIECE_STEPS)
    for start, end in zip(starts, [*starts[1:], len(window)], strict=True):
        yield Drive(**{f.name: getattr(window, f.name)[start:end] for f in fields(Drive)})
