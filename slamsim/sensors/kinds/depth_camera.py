"""A depth camera without errors: a pinhole, all of an image at one instant, depth in millimetres.

The worked example of a sensor; ``camera.py`` has lenses, shutters, noise and truth.

Images are those of REP 118 (16UC1, 0 where nothing is in reach) with their CameraInfo. The mount
is that of the body frame (x forward); images are in ``NAME_optical_frame`` (z forward, x right,
y down, REP 103).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slamsim.config.streams import SensorEntry
from slamsim.core.geometry import StaticTransform, mount_transform, se3_from_parts
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.recording import RawStream
from slamsim.recording.images import RawCameraInfos, RawImages

if TYPE_CHECKING:
    from slamsim.sensors.base import Site
    from slamsim.sensors.motion import Motion

R_LINK_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the optical frame to the body frame of the camera."""


class DepthCameraEntry(SensorEntry):
    """A depth camera: a pinhole without errors and without noise."""

    type: Literal["depth_camera"]
    """Kind of sensor."""
    rate_hz: float = Field(default=30.0, gt=0.01, le=1000.0)
    """Images per second."""
    width: int = Field(default=320, ge=1, le=8192)
    """Columns of an image."""
    height: int = Field(default=240, ge=1, le=8192)
    """Rows of an image."""
    horizontal_fov_deg: float = Field(default=87.0, gt=1.0, lt=179.0)
    """Angle between the outer edges of the left and the right column; pixels are square."""
    depth_min_m: float = Field(default=0.3, ge=0.0, le=100.0)
    """Nearer surfaces give no depth."""
    depth_max_m: float = Field(default=10.0, gt=0.0, le=65.0)
    """Surfaces farther away give no depth."""

    @property
    def optical_frame(self) -> str:
        return f"{self.name}_optical_frame"

    @property
    def focal_px(self) -> float:
        """Focal length, in pixels."""
        return 0.5 * self.width / float(np.tan(np.radians(0.5 * self.horizontal_fov_deg)))

    @property
    def K(self) -> FloatArray:  # noqa: N802
        """(3, 3) the camera matrix; the middle of the first pixel is at (0, 0)."""
        focal, x, y = self.focal_px, 0.5 * (self.width - 1), 0.5 * (self.height - 1)
        return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])

    @property
    def frames(self) -> tuple[StaticTransform, ...]:
        turned = se3_from_parts(R_LINK_OPTICAL, np.zeros(3))
        return (StaticTransform(self.frame, self.optical_frame, turned),)

    @property
    def topics(self) -> Mapping[str, str]:
        kinds: Mapping[str, type[RawStream]]
        kinds = {"image_raw": RawImages, "camera_info": RawCameraInfos}
        return {f"/{self.name}/depth/{leaf}": k.schema.type_name for leaf, k in kinds.items()}

    def build(self, site: Site) -> DepthCamera:
        return DepthCamera(self, site)


@dataclass(frozen=True, slots=True, eq=False)
class DepthBatch:
    """Images of one camera: depths_mm (k, height, width) uint16 at stamps_ns (k,)."""

    entry: DepthCameraEntry
    stamps_ns: IntArray
    arrival_ns: IntArray
    depths_mm: NDArray[np.uint16]

    def streams(self) -> tuple[RawStream, ...]:
        entry, when = self.entry, (self.stamps_ns, self.arrival_ns)
        frame, size = (entry.optical_frame,), (entry.height, entry.width)
        pixels = self.depths_mm.astype("<u2").reshape(-1, entry.height * entry.width)
        data = pixels.view(np.uint8)
        images, infos = entry.topics
        return (
            RawImages(images, frame, *when, *size, data),
            RawCameraInfos(infos, frame, *when, *size, entry.K),
        )


class DepthCamera:
    """The camera of an entry at a site: one ray through the middle of each pixel."""

    def __init__(self, entry: DepthCameraEntry, site: Site) -> None:
        from slamsim.sensors.clock import StreamClock
        from slamsim.sensors.scene import Scene

        self._entry = entry
        self._scene = Scene(site.mesh, floor_reach_m=entry.depth_max_m, threads=site.threads)
        self._clock = StreamClock(entry, site.start_ns, site.seed, entry.name)
        self._rays = _pixel_rays(entry)
        self._T_base_camera = mount_transform(entry.mount)
        self._next = 0

    @property
    def needed_ns(self) -> int:
        return self._clock.needed_ns(self._next)

    def sense(self, motion: Motion) -> DepthBatch:
        """All images whose instant the motion covers and that were not given yet."""
        samples = self._clock.samples_until(self._next, motion.covered_ns)
        self._next += samples.size
        true_ns = self._clock.instants_ns(samples)
        stamps_ns = self._clock.stamps_ns(true_ns)
        arrival_ns = self._clock.arrivals_ns(true_ns)
        there = self._clock.arrived(true_ns.size)
        images = [self._image(motion, int(instant_ns)) for instant_ns in true_ns[there]]
        size = (len(images), self._entry.height, self._entry.width)
        depths_mm = np.array(images, dtype=np.uint16).reshape(size)
        return DepthBatch(self._entry, stamps_ns[there], arrival_ns[there], depths_mm)

    def _image(self, motion: Motion, instant_ns: int) -> NDArray[np.uint16]:
        """(height * width,) depths in millimetres, along the optical axis; 0 for none."""
        entry = self._entry
        rays, axis = self._posed(motion, instant_ns)
        depths_m = self._scene.cast(rays).ranges_m * (rays[:, 3:] @ axis)
        inside = (depths_m >= entry.depth_min_m) & (depths_m <= entry.depth_max_m)
        return np.where(inside, np.rint(1e3 * depths_m), 0.0).astype(np.uint16)

    def _posed(self, motion: Motion, instant_ns: int) -> tuple[Float32Array, Float32Array]:
        """(n, 6) rays in the map from where the camera is at an instant, and its optical axis."""
        pose = motion.pose_samples(self._T_base_camera, instant_ns, instant_ns)
        at = int(np.searchsorted(pose.stamps_ns, instant_ns))
        left = max(at - 1, 0)
        span_ns = max(int(pose.stamps_ns[at] - pose.stamps_ns[left]), 1)
        later = (instant_ns - pose.stamps_ns[left]) / span_ns

        def between(values: FloatArray) -> FloatArray:
            return np.asarray((1.0 - later) * values[left] + later * values[at])

        x, y = between(pose.x_axis), between(pose.y_axis)
        x = x / np.linalg.norm(x)
        z = np.cross(x, y)
        z = z / np.linalg.norm(z)
        R_map_optical = np.column_stack([x, np.cross(z, x), z]) @ R_LINK_OPTICAL
        rays = np.empty((len(self._rays), 6), dtype=np.float32)
        rays[:, :3] = between(pose.origin_m) - self._scene.origin_m
        rays[:, 3:] = self._rays @ R_map_optical.T
        return rays, R_map_optical[:, 2].astype(np.float32)


def _pixel_rays(entry: DepthCameraEntry) -> FloatArray:
    """(height * width, 3) unit directions in the optical frame, row by row from above."""
    columns = (np.arange(entry.width) - 0.5 * (entry.width - 1)) / entry.focal_px
    rows = (np.arange(entry.height) - 0.5 * (entry.height - 1)) / entry.focal_px
    x, y = np.meshgrid(columns, rows)
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
