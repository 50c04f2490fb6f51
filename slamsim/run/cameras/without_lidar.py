"""What stands in for a lidar, where none is there or none is wanted: scans of a depth camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from slamsim.cameras.lens import camera_matrix
from slamsim.config.slam import SlamConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import PlanarTrajectory, Trajectory
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.io.cameras import open_cameras
from slamsim.io.open import OpenRecording, open_recording
from slamsim.io.selection import Selection
from slamsim.perception.depth_scans import widest_depth, with_depth_scans
from slamsim.slam.session import run_slam


@dataclass(frozen=True, slots=True, eq=False)
class WithoutLidar:
    """A recording whose scans are cut out of depth images. why: no lidar maps. lidar: the path that
    it gives, None where it gives none."""

    opened: OpenRecording
    why: str
    lidar: PlanarTrajectory | None

    def numbers(self, path: PlanarTrajectory, truth: Trajectory | None) -> dict[str, object]:
        """How far the path and the lidar's are apart, and how far off the latter is."""
        beside = own = None
        if self.lidar is not None:
            beside = _ate_rmse_m(path, self.lidar)
            own = None if truth is None else _ate_rmse_m(self.lidar, truth.planar())
        return {"lidar_ate_rmse_m": beside, "lidar_own_ate_rmse_m": own}

    def verdict(self, of_map: str, numbers: Mapping[str, object]) -> str:
        """What the map is, and how much worse than with a lidar."""
        beside, own = numbers["lidar_ate_rmse_m"], numbers["lidar_own_ate_rmse_m"]
        told = f"Mapped by depth images, without lidar ({self.why}). {of_map}"
        if not isinstance(beside, float):
            return told
        accuracy = f", which is {1e3 * own:.3g} mm off the truth" if isinstance(own, float) else ""
        return f"{told} The path is {1e3 * beside:.3g} mm (RMSE) off the lidar's{accuracy}."


def by_depth(
    path: Path,
    wanted: Selection,
    topics: Sequence[str],
    intrinsics: str,
    why: str,
    config: SlamConfig,
    reporter: Reporter,
) -> WithoutLidar | None:
    """A recording at path with the scans of its depth camera; None where it has no depth images or
    no odometry, without which a camera follows the corners in its images better. Why a depth
    camera cannot be used is told.

    topics: of depth images, as asked, the first is used; empty for the best. intrinsics: as for
    ``camera_matrix``. Raises as ``open_recording``, and for a topic as asked InputRefused or
    NotFound where it cannot be used.
    """
    K = camera_matrix(intrinsics) if intrinsics else None
    opened = open_recording(path, wanted)
    try:
        with open_cameras(path) as cameras:
            topic = topics[0] if topics else widest_depth(cameras)
        if not topic:
            return None
        with reporter.stage("images", "images/s") as progress:
            cut = with_depth_scans(opened, topic, K, progress)
        log = cut.log()
    except (InputRefused, NotFound) as reason:
        if topics:
            raise
        reporter.note(f"{reason}; no scans are cut out of depth images")
        return None
    if log.odometry is None and log.encoders is None:
        reporter.note("nothing tells how wheels moved; no scans are cut out of depth images")
        return None
    return WithoutLidar(cut, why, lidar_path(opened, config, reporter))


def lidar_path(
    opened: OpenRecording, config: SlamConfig, reporter: Reporter
) -> PlanarTrajectory | None:
    """The path that the lidar gives, to compare with; None where it gives none."""
    if not opened.recording.scans:
        return None
    try:
        with reporter.stage("lidar", "scans/s") as progress:
            return run_slam(opened.log(), config, progress).trajectory
    except SlamsimError:
        return None


def depth_topics(path: Path, wanted: Selection) -> tuple[str, ...]:
    """Those of the scan topics that are wanted which hold depth images; none of a recording whose
    images cannot be read."""
    if not wanted.scans:
        return ()
    asked = {topic.lstrip("/") for topic in wanted.scans}
    try:
        with open_cameras(path) as cameras:
            depths = [each.topic for each in cameras.of_kind("depth")]
    except SlamsimError:
        return ()
    return tuple(topic for topic in depths if topic.lstrip("/") in asked)


def _ate_rmse_m(path: PlanarTrajectory, other: PlanarTrajectory) -> float | None:
    """None where they share too little time."""
    try:
        return statistics(compare(path, other).translation_m).rmse
    except SlamsimError:
        return None
