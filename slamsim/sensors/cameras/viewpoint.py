"""Imagers that share a lens, a place and a shutter, and so all rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.cameras.poses import RowPoses, optical_flow
from slamsim.cameras.settings import ImagerConfig
from slamsim.core.types import BoolArray, Float32Array, IntArray
from slamsim.sensors.cameras.imager import DepthImager, Frame, Image, LightImager, Submit
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.clock import StreamClock

if TYPE_CHECKING:
    from slamsim.cameras.appearance import Appearance
    from slamsim.sensors.base import Site
    from slamsim.sensors.cameras.entry import CameraSettings
    from slamsim.sensors.motion import Motion


@dataclass(slots=True, eq=False)
class Taken:
    """One image of one imager with its truth. stamp_ns: on the camera's clock. truth: images by
    their names."""

    imager: str
    stamp_ns: int
    arrival_ns: int
    instant_ns: int
    poses: RowPoses
    image: Image
    truth: dict[str, NDArray[np.generic]]


@dataclass(slots=True, eq=False)
class Moved:
    """How what an image saw moves to the next frame, which is told when that one arrives."""

    imager: str
    stamp_ns: int
    arrival_ns: int
    flow_px: Float32Array


@dataclass(slots=True, eq=False)
class _Arrivals:
    """When images of an imager are there, and which are not lost."""

    when_ns: IntArray
    there: BoolArray


class Viewpoint:
    """Takes frames at the instants of the camera's clock, and images of each of its imagers."""

    def __init__(
        self,
        entry: CameraSettings,
        view: View,
        imagers: Mapping[str, tuple[ImagerConfig, LightImager | DepthImager]],
        appearance: Appearance,
        site: Site,
    ) -> None:
        self._view, self._imagers, self._appearance = view, imagers, appearance
        self._start_ns = site.start_ns
        self._clock = StreamClock(entry, site.start_ns, site.seed, entry.name)
        self._ways = {
            name: StreamClock(entry, site.start_ns, site.seed, f"{entry.name}/{name}")
            for name in imagers
        }
        longest_s = max(config.exposure.longest_s for config, _ in imagers.values())
        self._half_ns = int(np.ceil(0.5e9 * longest_s))
        self._after_ns = int(np.ceil(1e9 * view.readout_s)) + self._half_ns
        self._next = 0
        self._before: Frame | None = None
        self._unmoved: list[Taken] = []

    @property
    def needed_ns(self) -> int:
        """The earliest instant that later frames look at."""
        return self._clock.needed_ns(self._next) - self._half_ns

    def sense(self, motion: Motion, submit: Submit) -> list[Taken | Moved]:
        """All images whose exposure the motion covers and that were not given yet; and of those
        before, how what they saw has moved."""
        samples = self._clock.samples_until(self._next, motion.covered_ns - self._after_ns)
        self._next += samples.size
        true_ns = self._clock.instants_ns(samples)
        stamps_ns = self._clock.stamps_ns(true_ns)
        arrivals = {name: self._arrivals(way, true_ns) for name, way in self._ways.items()}
        taken: list[Taken | Moved] = []
        for place, number in enumerate(samples.tolist()):
            instant_ns = int(true_ns[place])
            frame = Frame(
                *(self._view, self._appearance, motion, number, instant_ns, self._start_ns)
            )
            taken += self._moved(frame, {n: int(a.when_ns[place]) for n, a in arrivals.items()})
            there = {n: int(a.when_ns[place]) for n, a in arrivals.items() if a.there[place]}
            images = self._images(frame, int(stamps_ns[place]), there, submit)
            self._before = frame
            self._unmoved = [i for i in images if "flow" in self._imagers[i.imager][0].truth]
            taken += images
        return taken

    def _arrivals(self, way: StreamClock, true_ns: IntArray) -> _Arrivals:
        return _Arrivals(way.arrivals_ns(true_ns + self._after_ns), way.arrived(true_ns.size))

    def _images(
        self, frame: Frame, stamp_ns: int, there: Mapping[str, int], submit: Submit
    ) -> list[Taken]:
        """Also those that are lost are taken: the exposure of the next one follows from them."""
        found = []
        for name, (config, imager) in self._imagers.items():
            image = imager.image(frame, submit)
            if name in there:
                truth = true_images(frame, self._view.camera, config.truth)
                when = stamp_ns, there[name], frame.instant_ns
                found.append(Taken(name, *when, frame.poses, image, truth))
        return found

    def _moved(self, frame: Frame, arrivals_ns: Mapping[str, int]) -> list[Moved]:
        if self._before is None or not self._unmoved:
            return []
        sight, camera = self._before.sight, self._view.camera
        flow_px = optical_flow(sight.surface.points_m, sight.hit, camera, frame.poses)
        shaped = flow_px.astype(np.float32).reshape(camera.height, camera.width, 2)
        return [
            Moved(taken.imager, taken.stamp_ns, arrivals_ns[taken.imager], shaped)
            for taken in self._unmoved
        ]


def true_images(
    frame: Frame, camera: CameraModel, wanted: Sequence[str]
) -> dict[str, NDArray[np.generic]]:
    """(h, w) or (h, w, 3) images of the truth by their names: depth (float32 metres along the
    axis, nan for nothing), normals (float32, in the optical frame, towards the camera), instances
    (int32), materials (uint8)."""
    found: dict[str, NDArray[np.generic]] = {}
    shape = camera.height, camera.width
    if "depth" in wanted:
        depths_m = np.where(frame.sight.hit, frame.sight.depths_m, np.float32(np.nan))
        found["depth"] = depths_m.reshape(shape)
    if "normals" in wanted:
        found["normals"] = _optical_normals(frame).reshape(*shape, 3)
    if "instances" in wanted:
        found["instances"] = frame.instances.reshape(shape)
    if "materials" in wanted:
        found["materials"] = frame.materials.reshape(shape)
    return found


def _optical_normals(frame: Frame) -> Float32Array:
    rotations, normals = frame.poses.R_map_optical, frame.sight.surface.normals
    by_row = normals.reshape(len(rotations), -1, 3).astype(np.float64)
    return np.asarray(np.einsum("rni,rij->rnj", by_row, rotations), dtype=np.float32)
