"""What is asked of images: refused before anything long is begun where it cannot be, and read."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.config.streams import SensorEntry
from slamsim.core.landmarks import NO_TAGS, TagsSeen
from slamsim.core.types import Log, Scan
from slamsim.guard.errors import OverrideRefused, shown
from slamsim.perception.calibrated import CalibratedCameras, read_calibration
from slamsim.perception.recorded import known_tags, tags_seen
from slamsim.perception.tag_families import parse_tags
from slamsim.recording import Recording
from slamsim.run.cameras.layers import LayerSources, layer_sources
from slamsim.run.stages import Stages
from slamsim.sensors.cameras.entry import CameraSettings
from slamsim.slam.frontend.scan_order import NothingSeen, nothing_seen

_log = logging.getLogger(__name__)
_KINDS = {"Image", "CompressedImage"}
_LABELS = {"instances", "materials"}


def refuse_unseen(config: RunConfig) -> CalibratedCameras:
    """Refuse what the cameras of a world to be simulated will not show; as ``refuse_wrong_files``.

    Raises OverrideRefused; UnknownTags, NotFound or InputRefused for wrong tags, surveys and
    calibrations.
    """
    calibrated = refuse_wrong_files(config)
    entries = [entry for entry in config.sensors.additional if entry.enabled]
    layers, lacks = config.mapping.layers, "needs a camera that sees {}; as --config realsense_d435"
    if config.slam.landmarks.tags and not any(_shows(entry, is_depth=False) for entry in entries):
        raise OverrideRefused("--tags", lacks.format("them"))
    if layers.obstacles and not any(_shows(entry, is_depth=True) for entry in entries):
        raise OverrideRefused("--obstacles", lacks.format("depth"))
    topics = sorted(topic for entry in entries for topic in _labels(entry))
    if layers.labels and layers.labels not in topics:
        known = ", ".join(topics) or "none"
        reason = f"no camera of the robot has this topic; label images are on {known}"
        raise OverrideRefused(f"--labels {shown(layers.labels)}", reason)
    return calibrated


def _shows(entry: SensorEntry, *, is_depth: bool) -> bool:
    """Of sensors of other kinds than cameras it is not known what their images show."""
    if isinstance(entry, CameraSettings):
        return any(each.is_depth == is_depth for each in entry.enabled_imagers.values())
    return bool(_images(entry))


def _labels(entry: SensorEntry) -> list[str]:
    """Topics of label images; of sensors of other kinds all images may be some."""
    if isinstance(entry, CameraSettings):
        return [topic for topic in _images(entry) if topic.rsplit("/", 1)[-1] in _LABELS]
    return _images(entry)


def _images(entry: SensorEntry) -> list[str]:
    return [topic for topic, kind in entry.topics.items() if kind.split("/")[-1] in _KINDS]


def refuse_wrong_files(config: RunConfig, *, continues: bool = False) -> CalibratedCameras:
    """The cameras as calibrated, read once, for what is inconclusive of them is told.

    Raises UnknownTags, NotFound or InputRefused as reading tags and surveys will; OverrideRefused
    for a survey in a drive that continues an earlier map.
    """
    if config.slam.landmarks.tags:
        if continues and config.slam.landmarks.surveyed:
            reason = "a map that is continued keeps its own frame; leave it out"
            raise OverrideRefused("slam.landmarks.surveyed", reason)
        parse_tags(config.slam.landmarks.tags)
        known_tags(config.slam.landmarks)
    return read_calibration(config.slam.camera_calibration)


def from_images(
    path: Path,
    recording: Recording,
    config: RunConfig,
    stages: Stages,
    calibrated: CalibratedCameras,
) -> tuple[LayerSources, TagsSeen]:
    """Of what layers are made, and what images show of the tags that the configuration asks for.

    Raises as ``layer_sources`` and ``tags_seen``.
    """
    sources = layer_sources(path, recording, config.mapping.layers, calibrated)
    is_for_tags, layers = bool(config.slam.landmarks.tags), config.mapping.layers
    if calibrated.cameras and not (is_for_tags or layers.obstacles or layers.labels):
        _log.warning("--calibration changes nothing without --tags, --obstacles or --labels")
    if not is_for_tags:
        return sources, NO_TAGS
    with stages.stage("tags", "images/s") as progress:
        tags = tags_seen(path, recording, config.slam.landmarks, progress, calibrated)
    return sources, tags


def require_returns(log: Log) -> None:
    """Raises NothingSeen for scans of which no beam ever returns, before they are tracked."""
    if any(_returns(one) for scan in log.scans for one in (scan, *(b.scan for b in scan.beside))):
        return
    if len(log.scans):
        raise NothingSeen(nothing_seen(len(log.scans)))


def _returns(scan: Scan) -> bool:
    low_m, high_m = scan.geometry.range_min_m, scan.geometry.range_max_m
    return bool(np.any((scan.ranges_m >= low_m) & (scan.ranges_m < high_m)))
