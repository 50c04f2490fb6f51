"""Which sensor maps a recording: the lidar, or where it cannot, the camera."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import OverrideRefused, SlamsimError, shown
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.recording.cleaning.log import WithoutScans
from slamsim.run.cameras.without_lidar import by_depth, depth_topics
from slamsim.run.continuing import Earlier
from slamsim.run.mapping import map_recording
from slamsim.run.naming import log_of
from slamsim.run.stages import Report, Stages
from slamsim.slam.frontend.scan_order import NothingSeen


def map_by_lidar_or_camera(
    source: Path,
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    without: str = "",
    intrinsics: str = "",
    relations: Path | None = None,
    wanted: Selection = EVERYTHING,
    earlier: Earlier | None = None,
    overwrite: bool = False,
) -> Report:
    """``map_recording``; where there is no lidar, it sees nothing or is not to be used (without:
    ``lidar``), the same with scans cut out of depth images, and where these cannot be,
    ``map_by_camera``.

    Raises OverrideRefused for another word, and for what a map by camera cannot do; what
    ``map_recording`` raises where there are no images to map by.
    """
    named = () if _is_images(source) else depth_topics(log_of(source), wanted)
    if named and len(wanted.scans) > 1:
        raise OverrideRefused("--scan-topic", f"depth images are mapped alone: {named[0]}")
    wanted = replace(wanted, scans=()) if named else wanted
    why = _unwanted(without, source) or ("as asked" if named else "")
    mapped = partial(
        map_recording,
        source,
        config,
        folder,
        reporter,
        relations=relations,
        earlier=earlier,
        overwrite=overwrite,
    )
    if not why:
        try:
            return mapped(wanted=wanted)
        except (WithoutScans, NothingSeen) as reason:
            if not _has_images(source, config, reporter):
                raise
            why = "none was recorded" if isinstance(reason, WithoutScans) else "it sees nothing"
            reporter.note(f"{reason}; mapping by camera")
    found = None
    if not _is_images(source):
        found = by_depth(log_of(source), wanted, named, intrinsics, why, config.slam, reporter)
    if found is not None:
        try:
            return mapped(without=found)
        except (WithoutScans, NothingSeen) as reason:
            reporter.note(f"{reason}; following corners in the images")
    _require_nothing_of_lidars(config, earlier, relations)
    from slamsim.run.cameras.mapping import map_by_camera  # with what draws its report

    return map_by_camera(
        source,
        config,
        folder,
        Stages(reporter),
        why=why,
        intrinsics=intrinsics,
        wanted=wanted,
        overwrite=overwrite,
    )


def _require_nothing_of_lidars(
    config: RunConfig, earlier: Earlier | None, relations: Path | None
) -> None:
    """Raises OverrideRefused for what only a map by lidar can do."""
    layers = config.mapping.layers
    for option, given in (
        ("--continue", earlier is not None),
        ("--relations", relations is not None),
        ("--obstacles", layers.obstacles),
        ("--labels", bool(layers.labels)),
        ("--calibration", bool(config.slam.camera_calibration)),
        ("slam.landmarks.surveyed", bool(config.slam.landmarks.surveyed)),
    ):
        if given:
            reason = "needs scans, or depth images with odometry; leave it out"
            raise OverrideRefused(option, reason)


def _unwanted(without: str, source: Path) -> str:
    """Why the lidar does not map from the beginning; empty if it does."""
    if without not in ("", "lidar"):
        reason = "only the lidar can be left out: --without lidar"
        raise OverrideRefused(f"--without {shown(without)}", reason)
    if _is_images(source):
        return "there are images alone"
    return "as asked" if without else ""


def _is_images(source: Path) -> bool:
    return source.is_dir() and is_image_folder(source)


def _has_images(source: Path, config: RunConfig, reporter: Reporter) -> bool:
    """Whether a camera can map: by depth, or by tags that are asked for. Images that cannot be read
    are told."""
    try:
        with open_cameras(log_of(source)) as cameras:
            for topic, reason in cameras.unread.items():
                reporter.warn(f"{topic}: cannot be read: {reason}")
            tags = bool(config.slam.landmarks.tags)
            return bool(cameras.of_kind("depth") or (tags and cameras.pictures()))
    except SlamsimError:
        return False
