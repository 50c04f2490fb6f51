"""What is asked of images: refused before anything long is begun where it cannot be, and read."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.config.streams import SensorEntry
from slamsim.core.landmarks import NO_TAGS, Landmark, TagsSeen
from slamsim.core.places import SeenAgain
from slamsim.core.types import Log, Scan
from slamsim.guard.errors import OverrideRefused, shown
from slamsim.perception.calibrated import CalibratedCameras, read_calibration
from slamsim.perception.recorded import known_tags, tags_seen
from slamsim.perception.tag_families import parse_tags
from slamsim.recording import Recording
from slamsim.run.cameras.layers import LayerSources, layer_sources
from slamsim.run.cameras.places import places_seen_again
from slamsim.run.stages import Stages
from slamsim.sensors.cameras.entry import CameraSettings
from slamsim.slam.frontend.scan_order import NothingSeen, nothing_seen
from slamsim.slam.session import odometry_of, require_same_tags

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
    if config.slam.back_end.closures.images and not any(_shows(e, is_depth=True) for e in entries):
        raise OverrideRefused("--places", lacks.format("depth"))
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


def refuse_wrong_files(
    config: RunConfig, earlier: Sequence[Landmark] | None = None
) -> CalibratedCameras:
    """The cameras as calibrated, read once, for what is inconclusive of them is told.

    earlier: tags of a map that is continued. Raises UnknownTags, NotFound or InputRefused as
    reading tags and surveys will; OverrideRefused for a survey in a drive that continues a map, and
    SlamsimError for tags of another family than that map's.
    """
    if config.slam.landmarks.tags:
        if earlier is not None and config.slam.landmarks.surveyed:
            reason = "a map that is continued keeps its own frame; leave it out"
            raise OverrideRefused("slam.landmarks.surveyed", reason)
        kind = parse_tags(config.slam.landmarks.tags)
        require_same_tags(TagsSeen(family=kind.family), earlier or ())
        known_tags(config.slam.landmarks)
    return read_calibration(config.slam.camera_calibration)


@dataclass(frozen=True, slots=True, eq=False)
class FromImages:
    """layers: of what they are made. tags: as images show them. again: places that they show
    again."""

    layers: LayerSources
    tags: TagsSeen
    again: tuple[SeenAgain, ...]


def from_images(
    path: Path,
    recording: Recording,
    log: Log,
    config: RunConfig,
    stages: Stages,
    calibrated: CalibratedCameras,
) -> FromImages:
    """What the configuration asks for. log: of the recording.

    Raises as ``layer_sources``, ``tags_seen`` and ``places_seen_again``.
    """
    sources = layer_sources(path, recording, config.mapping.layers, calibrated)
    is_for_tags, is_for_places = (
        bool(config.slam.landmarks.tags),
        config.slam.back_end.closures.images,
    )
    layers, tags = config.mapping.layers, NO_TAGS
    again: tuple[SeenAgain, ...] = ()
    if calibrated.cameras and not (
        is_for_tags or is_for_places or layers.obstacles or layers.labels
    ):
        told = "--calibration changes nothing without --tags, --places, --obstacles or --labels"
        _log.warning(told)
    if is_for_tags:
        with stages.stage("tags", "images/s") as progress:
            tags = tags_seen(path, recording, config.slam.landmarks, progress, calibrated)
    if is_for_places:
        with stages.stage("places", "images/s") as progress:
            odometry = odometry_of(log)
            again = places_seen_again(path, recording, odometry, calibrated, progress)
    return FromImages(sources, tags, again)


def require_returns(log: Log) -> None:
    """Raises NothingSeen for scans of which no beam ever returns, before they are tracked."""
    if any(_returns(one) for scan in log.scans for one in (scan, *(b.scan for b in scan.beside))):
        return
    if len(log.scans):
        raise NothingSeen(nothing_seen(len(log.scans)))


def _returns(scan: Scan) -> bool:
    low_m, high_m = scan.geometry.range_min_m, scan.geometry.range_max_m
    return bool(np.any((scan.ranges_m >= low_m) & (scan.ranges_m < high_m)))
