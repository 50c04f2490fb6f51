"""A camera of one or more imagers at a site."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from slamsim.cameras.align import DepthAlignment
from slamsim.cameras.appearance import Appearance, PlainGrey
from slamsim.cameras.settings import ImagerConfig
from slamsim.core.geometry import mount_transform
from slamsim.core.types import FloatArray
from slamsim.recording import RawStream
from slamsim.sensors.cameras.imager import DepthImager, LightImager
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.cameras.streams import CameraTopics
from slamsim.sensors.cameras.viewpoint import Moved, Taken, Viewpoint
from slamsim.sensors.scene import Scene

if TYPE_CHECKING:
    from slamsim.sensors.base import Site
    from slamsim.sensors.cameras.entry import CameraSettings
    from slamsim.sensors.motion import Motion

_MOST_PACKERS = 4
"""Threads that pack images: what they make does not depend on their number."""
_FLOOR_TRIANGLES = 2


class Camera:
    """All imagers of an entry; images are packed in threads while the next ones are rendered."""

    def __init__(self, entry: CameraSettings, site: Site) -> None:
        reach_m = max(config.depth.depth_max_m for config in entry.imagers.values())
        scene = Scene(site.mesh, floor_reach_m=max(reach_m, 30.0), threads=site.threads)
        appearance: Appearance = PlainGrey(len(site.mesh.triangles) + _FLOOR_TRIANGLES)
        if site.appearance is not None:
            appearance = site.appearance()
        self._topics = CameraTopics(entry)
        self._viewpoints = tuple(
            Viewpoint(
                entry,
                View(scene, first.lens.model(), entry.T_base_imager(first), first.readout_s),
                {
                    name: (config, _imager(entry, site.seed, name))
                    for name, config in shared.items()
                },
                appearance,
                site,
            )
            for first, shared in _sharing(entry.enabled_imagers)
        )
        self._packers = min(_MOST_PACKERS, os.cpu_count() or 1)

    @property
    def needed_ns(self) -> int:
        """The earliest instant that later frames look at."""
        return min(viewpoint.needed_ns for viewpoint in self._viewpoints)

    def sense(self, motion: Motion) -> CameraBatch:
        """All images whose exposure the motion covers and that were not given yet."""
        with ThreadPoolExecutor(self._packers) as pool:
            taken = [each for v in self._viewpoints for each in v.sense(motion, pool.submit)]
        return CameraBatch(self._topics, taken)


@dataclass(frozen=True, slots=True, eq=False)
class CameraBatch:
    """Images of all imagers of one window."""

    topics: CameraTopics
    taken: list[Taken | Moved]

    def streams(self) -> tuple[RawStream, ...]:
        return self.topics.streams(self.taken)


def _sharing(
    imagers: Mapping[str, ImagerConfig],
) -> list[tuple[ImagerConfig, dict[str, ImagerConfig]]]:
    """Imagers that look along the same rays, each group with its first."""

    def key(item: tuple[str, ImagerConfig]) -> str:
        config = item[1]
        return repr((config.lens, config.offset, config.readout_s))

    groups = (dict(group) for _, group in groupby(sorted(imagers.items(), key=key), key))
    return [(next(iter(group.values())), group) for group in groups]


def _imager(entry: CameraSettings, seed: int, name: str) -> LightImager | DepthImager:
    config = entry.imagers[name]
    if not config.is_depth:
        return LightImager(entry, name, seed)
    if not config.depth.aligned_to:
        return DepthImager(entry, name, seed)
    other = entry.imagers[config.depth.aligned_to]
    alignment = DepthAlignment(config.lens.model(), other.lens.model(), _between(other, config))
    return DepthImager(entry, name, seed, alignment.aligned)


def _between(other: ImagerConfig, config: ImagerConfig) -> FloatArray:
    """``T_other_camera`` of the optical frames."""
    from slamsim.sensors.cameras.entry import T_CAMERA_OPTICAL

    T_camera_other = mount_transform(other.offset) @ T_CAMERA_OPTICAL
    T_camera_this = mount_transform(config.offset) @ T_CAMERA_OPTICAL
    return np.asarray(np.linalg.inv(T_camera_other) @ T_camera_this)
