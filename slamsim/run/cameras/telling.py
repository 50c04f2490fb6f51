"""What is told of a map that was made without a lidar."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.geometry import compose, inverse, xyzw_from_matrix
from slamsim.core.spatial import CameraTrack
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, Trajectory
from slamsim.evaluate.spatial import SpatialErrors, compare_in_space
from slamsim.guard.errors import SlamsimError
from slamsim.report.pages.cameras import CameraView
from slamsim.run.naming import recording_name
from slamsim.run.stages import Report
from slamsim.slam.visual.camera_map import CameraMap, MappedTag

MANY_LOST = 0.1
"""Share of lost images from which on it is told."""


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """What is known besides the images. T_base_camera: (4, 4). log: of wheels and gyroscope. truth:
    of what is mapped: the base, or else the optical frame. told: what to warn of."""

    T_base_camera: FloatArray
    log: Log | None = None
    truth: Trajectory | None = None
    told: tuple[str, ...] = ()


def _in_space(path: PlanarTrajectory) -> Trajectory:
    count, (x, y, yaw) = len(path), path.poses.T
    quats = np.column_stack([np.zeros((count, 2)), np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    return Trajectory(path.stamps_ns, np.column_stack([x, y, np.zeros(count)]), quats)


def _errors(path: Trajectory, truth: Trajectory | None) -> SpatialErrors | None:
    """None where the truth shares too little of the path."""
    if truth is None:
        return None
    try:
        return compare_in_space(path, truth)
    except SlamsimError:
        return None


def report_of(
    source: Path,
    track: CameraTrack,
    found: CameraMap,
    robot: Robot,
    lidar: PlanarTrajectory | None,
    why: str,
) -> Report:
    """The numbers of ``report.json``, and what a person should be told. why: no lidar maps."""
    errors = _errors(found.trajectory, robot.truth)
    beside = None if lidar is None else _errors(found.trajectory, _in_space(lidar))
    lidar_errors = None if lidar is None else _errors(_in_space(lidar), robot.truth)
    moved_m = np.linalg.norm(np.diff(found.poses[:, :3, 3], axis=0), axis=1)
    stamps_ns, (accepted, withdrawn) = found.trajectory.stamps_ns, found.closures
    numbers: dict[str, object] = {
        "name": recording_name(str(source)),
        "ate_rmse_m": None if errors is None else errors.ate_rmse_m,
        "odometry_drift_percent": None if errors is None else errors.drift_percent,
        "lidar_ate_rmse_m": None if beside is None else beside.ate_rmse_m,
        "lidar_own_ate_rmse_m": None if lidar_errors is None else lidar_errors.ate_rmse_m,
        "sigma_end_m": float(found.sigmas_m[-1]),
        "sigma_max_m": float(found.sigmas_m.max()),
        "path_length_m": float(moved_m.sum()),
        "duration_s": float(stamps_ns[-1] - stamps_ns[0]) * 1e-9,
        "images": len(track.stamps_ns),
        "images_lost": track.lost,
        "keyframes": len(found.poses),
        "guessed_steps": found.guessed,
        "loop_closures": accepted,
        "loop_closures_rejected": withdrawn + track.refused,
        "sources": "" if robot.log is None else robot.log.sources,
        "tags": [_tag(tag) for tag in found.tags],
    }
    told = (*robot.told, *_doubts(track, found))
    numbers["verdict"] = verdict = _verdict(numbers, why)
    numbers["warnings"] = list(told)
    return Report(numbers, warnings=told, weighed=told, verdict=verdict)


def _tag(tag: MappedTag) -> dict[str, object]:
    return {
        "number": tag.number,
        "position_m": tag.T_map_tag[:3, 3].tolist(),
        "quat_xyzw": xyzw_from_matrix(tag.T_map_tag[:3, :3]).tolist(),
        "sigma_m": float(np.sqrt(np.trace(tag.covariance[:3, :3]))),
        "seen": tag.seen,
        "doubted": tag.doubted,
    }


def _doubts(track: CameraTrack, found: CameraMap) -> Iterator[str]:
    if track.lost > MANY_LOST * len(track.stamps_ns):
        yield f"{track.lost} of {len(track.stamps_ns)} images told no motion"
    if found.guessed:
        yield (
            f"nothing tells how the camera moved in {found.guessed} steps between key frames: the "
            "path goes on there as before, or stands"
        )


def _verdict(numbers: dict[str, object], why: str) -> str:
    """What it is, and how much worse than with a lidar."""
    begin = f"Mapped without lidar ({why})" if why else "Mapped without lidar"
    sigma_mm, beside = 1e3 * _number(numbers, "sigma_max_m"), numbers["lidar_ate_rmse_m"]
    ate, own = numbers["ate_rmse_m"], numbers["lidar_own_ate_rmse_m"]
    if isinstance(ate, float) and isinstance(own, float) and isinstance(beside, float):
        return (
            f"{begin}: {1e3 * ate:.3g} mm off the truth (RMSE), with it {1e3 * own:.3g} mm; the "
            f"two paths are {1e3 * beside:.3g} mm apart."
        )
    if isinstance(beside, float):
        return f"{begin}: {1e3 * beside:.3g} mm (RMSE) off the path that the lidar gives."
    known = f"{1e3 * ate:.3g} mm off the truth (RMSE), " if isinstance(ate, float) else ""
    return f"{begin}: {known}sure to {sigma_mm:.3g} mm where it is least sure, by its own account."


def _number(numbers: dict[str, object], key: str) -> float:
    value = numbers[key]
    assert isinstance(value, float)
    return value


def view_of(
    source: Path,
    report: Report,
    track: CameraTrack,
    found: CameraMap,
    robot: Robot,
    lidar: PlanarTrajectory | None,
) -> CameraView:
    """A camera on no robot looks along z, and its paths are seen along y, which points down."""
    plane = [0, 1] if robot.log is not None else [0, 2]
    stamps_ns = track.keyframe_stamps_ns
    truth = robot.truth if robot.log is not None else None
    tags_m = np.array([tag.T_map_tag[:3, 3] for tag in found.tags]).reshape(-1, 3)
    return CameraView(
        recording_name(str(source)),
        report.verdict,
        report.numbers,
        found.trajectory.positions_m[:, plane],
        None if truth is None else moved_onto(truth.planar(), found.trajectory),
        None if lidar is None else moved_onto(lidar, found.trajectory),
        tags_m[:, plane],
        found.sigmas_m,
        1e-9 * (stamps_ns - stamps_ns[0]),
        report.warnings,
    )


def moved_onto(other: PlanarTrajectory, path: Trajectory) -> FloatArray | None:
    """(n, 2) points of another path of the same robot, as it stood where both begin.

    None where they share no time.
    """
    mine = path.planar()
    if other.stamps_ns[0] > mine.stamps_ns[-1] or mine.stamps_ns[0] > other.stamps_ns[-1]:
        return None
    begin = np.array([max(int(other.stamps_ns[0]), int(mine.stamps_ns[0]))])
    T_map_other = compose(mine.at(begin)[0], inverse(other.at(begin)[0]))
    inside = (other.stamps_ns >= begin[0]) & (other.stamps_ns <= mine.stamps_ns[-1])
    return compose(T_map_other, other.poses[inside])[:, :2]
