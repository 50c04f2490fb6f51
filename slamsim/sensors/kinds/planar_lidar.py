"""An additional planar lidar, such as one at the rear: scans on ``NAME/scan`` in ``NAME_link``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from slamsim.config.lidar import LidarConfig
from slamsim.config.streams import SensorEntry
from slamsim.core.geometry import mount_transform
from slamsim.recording import RawScans, RawStream

if TYPE_CHECKING:
    from slamsim.sensors.base import Site
    from slamsim.sensors.lidar import Lidar
    from slamsim.sensors.motion import Motion
    from slamsim.sensors.readings import ScanBatch


class PlanarLidarEntry(LidarConfig, SensorEntry):
    """A rotating planar lidar, with all the settings of ``sensors.lidar``."""

    type: Literal["planar_lidar"]
    """Kind of sensor."""

    @property
    def topics(self) -> Mapping[str, str]:
        return {self._topic: RawScans.schema.type_name}

    def build(self, site: Site) -> AdditionalLidar:
        from slamsim.sensors.lidar import Lidar

        T_base_laser = mount_transform(self.mount)
        lidar = Lidar(self, T_base_laser, site, name=self.name, frame_id=self.frame)
        return AdditionalLidar(lidar, self._topic, self.rate_hz)

    @property
    def _topic(self) -> str:
        return f"/{self.name}/scan"


@dataclass(frozen=True, slots=True, eq=False)
class AdditionalLidar:
    """A lidar with a topic of its own."""

    lidar: Lidar
    topic: str
    scan_rate_hz: float

    @property
    def needed_ns(self) -> int:
        return self.lidar.needed_ns

    def sense(self, motion: Motion) -> LidarBatch:
        return LidarBatch(self.lidar.sense(motion), self.topic, self.scan_rate_hz)


@dataclass(frozen=True, slots=True, eq=False)
class LidarBatch:
    """Scans of an additional lidar."""

    scans: ScanBatch
    topic: str
    scan_rate_hz: float

    def streams(self) -> tuple[RawStream, ...]:
        from slamsim.sensors.readings import scan_streams

        return scan_streams(self.topic, [self.scans], self.scan_rate_hz)
