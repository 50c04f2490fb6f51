"""What a sensor is to the rig: a module in ``sensors/kinds/`` is one kind more.

A kind is a ``SensorEntry`` (its settings, as they stand in ``sensors.additional``) whose ``build``
gives a ``Sensor``. What it measured becomes streams of the recording by their schemas.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from slamsim.cameras.appearance import Appearance
from slamsim.config.streams import SensorEntry
from slamsim.core.geometry import StaticTransform, mount_transform
from slamsim.core.types import TriangleMesh
from slamsim.recording import RawStream
from slamsim.sensors.motion import Motion

BASE_FRAME = "base_footprint"


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Where sensors are switched on.

    mesh: the world in the map frame, metres. start_ns: true time of the start of the drive.
    seed: of all random streams, which carry the sensor's name. threads: for casting rays.
    appearance: gives how the world looks to cameras; without it, plain grey.
    """

    mesh: TriangleMesh
    seed: int
    start_ns: int
    threads: int = 1
    appearance: Callable[[], Appearance] | None = None


class Batch(Protocol):
    """What one sensor measured during one window of a drive."""

    def streams(self) -> tuple[RawStream, ...]:
        """The messages, each stream on its topic; received when they arrived."""
        ...


class Sensor(Protocol):
    """Samples a motion that it is given window by window.

    The outcome depends on the motion and the seed, never on how the drive is cut into windows.
    """

    @property
    def needed_ns(self) -> int:
        """The earliest instant of the motion that later samples look at."""
        ...

    def sense(self, motion: Motion) -> Batch:
        """All samples that the motion covers and that were not given yet."""
        ...


def static_frames(entries: Iterable[SensorEntry]) -> Iterator[StaticTransform]:
    """The edges of the transform tree that additional sensors bring."""
    for entry in entries:
        yield StaticTransform(BASE_FRAME, entry.frame, mount_transform(entry.mount))
        yield from entry.frames
