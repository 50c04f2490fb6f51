"""What is asked of images and cannot be, refused before anything long is begun."""

from __future__ import annotations

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.config.streams import SensorEntry
from slamsim.core.types import Log, Scan
from slamsim.guard.errors import OverrideRefused, shown
from slamsim.perception.calibrated import read_calibration
from slamsim.perception.recorded import known_tags
from slamsim.perception.tag_families import parse_tags
from slamsim.sensors.cameras.entry import CameraSettings
from slamsim.slam.frontend.scan_order import NothingSeen, nothing_seen

_KINDS = {"Image", "CompressedImage"}


def refuse_unseen(config: RunConfig) -> None:
    """Refuse what the cameras of a world to be simulated will not show.

    Raises OverrideRefused; UnknownTags, NotFound or InputRefused for wrong tags, surveys and
    calibrations.
    """
    refuse_wrong_files(config)
    entries = [entry for entry in config.sensors.additional if entry.enabled]
    layers, lacks = config.mapping.layers, "needs a camera that sees {}; as --config realsense_d435"
    if config.slam.landmarks.tags and not any(_shows(entry, is_depth=False) for entry in entries):
        raise OverrideRefused("--tags", lacks.format("them"))
    if layers.obstacles and not any(_shows(entry, is_depth=True) for entry in entries):
        raise OverrideRefused("--obstacles", lacks.format("depth"))
    topics = sorted(topic for entry in entries for topic in _images(entry))
    if layers.labels and layers.labels not in topics:
        known = ", ".join(topic for topic in topics if topic.startswith("/ground_truth/")) or "none"
        reason = f"no camera of the robot has this topic; label images are on {known}"
        raise OverrideRefused(f"--labels {shown(layers.labels)}", reason)


def _shows(entry: SensorEntry, *, is_depth: bool) -> bool:
    """Of sensors of other kinds than cameras it is not known what their images show."""
    if isinstance(entry, CameraSettings):
        return any(each.is_depth == is_depth for each in entry.enabled_imagers.values())
    return bool(_images(entry))


def _images(entry: SensorEntry) -> list[str]:
    return [topic for topic, kind in entry.topics.items() if kind.split("/")[-1] in _KINDS]


def refuse_wrong_files(config: RunConfig, *, continues: bool = False) -> None:
    """Raises UnknownTags, NotFound or InputRefused as reading them will; OverrideRefused for tags
    in a drive that continues an earlier map."""
    if config.slam.landmarks.tags:
        if continues:
            raise OverrideRefused("--tags", "tags do not continue a map; leave out --continue")
        parse_tags(config.slam.landmarks.tags)
        known_tags(config.slam.landmarks)
    read_calibration(config.slam.camera_calibration)


def require_returns(log: Log) -> None:
    """Raises NothingSeen for scans of which no beam ever returns, before they are tracked."""
    if any(_returns(one) for scan in log.scans for one in (scan, *(b.scan for b in scan.beside))):
        return
    if len(log.scans):
        raise NothingSeen(nothing_seen(len(log.scans)))


def _returns(scan: Scan) -> bool:
    low_m, high_m = scan.geometry.range_min_m, scan.geometry.range_max_m
    return bool(np.any((scan.ranges_m >= low_m) & (scan.ranges_m < high_m)))
