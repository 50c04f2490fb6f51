"""A camera with imagers of colour, grey, infrared and depth: alone, in pairs, or as a RealSense.

Images are in ``NAME_IMAGER_optical_frame``, topics below ``/NAME/IMAGER``, the truth below
``/ground_truth/NAME/IMAGER``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from slamsim.sensors.cameras.entry import CameraSettings

if TYPE_CHECKING:
    from slamsim.sensors.base import Site
    from slamsim.sensors.cameras.camera import Camera


class CameraEntry(CameraSettings):
    """A camera: one clock, and imagers that are exposed at the same instants."""

    type: Literal["camera"]
    """Kind of sensor."""

    @property
    def topics(self) -> Mapping[str, str]:
        from slamsim.sensors.cameras.streams import CameraTopics

        return CameraTopics(self).types

    @property
    def custom_data(self) -> Mapping[str, str]:
        from slamsim.sensors.cameras.streams import CameraTopics

        return CameraTopics(self).custom_data

    def build(self, site: Site) -> Camera:
        from slamsim.sensors.cameras.camera import Camera

        return Camera(self, site)
