"""SLAM from a log to a trajectory, a graph and what they are worth."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.progress import Progress, silent
from slamsim.safe.errors import SlamsimError
from slamsim.slam.back_end import BackEnd
from slamsim.slam.correction import correct
from slamsim.slam.motion import predict_motion
from slamsim.slam.odometry import FrontEnd, Tracked
from slamsim.types import FloatArray, Log, OutsideTimeRange, PlanarTrajectory, SlamResult

FINISH_SHARE = 0.1
"""Part of the progress that the final search and solution take."""

DEGENERATE_SHARE_TO_TELL = 0.05


def run_slam(log: Log, config: SlamConfig, progress: Progress = silent) -> SlamResult:
    """Trajectory and graph of a recording; ``mapping.build_grid`` draws its map.

    The map frame begins where the base stood at the first scan used. Raises SlamsimError for a
    log without a scan that the motion covers, and what ``predict_motion`` raises.
    """
    seconds: dict[str, float] = {}
    started_s = time.perf_counter()
    motion = predict_motion(log)
    seconds["motion"] = time.perf_counter() - started_s

    gyro = log.imu is not None
    front_end = FrontEnd(config.front_end, motion, log.T_base_laser, gyro)
    back_end = BackEnd(config, gyro, config.front_end.max_range_m)
    track = _Track()
    whole = len(log.scans) * (1.0 + FINISH_SHARE)
    started_s = time.perf_counter()
    for number, scan in enumerate(log.scans):
        tracked = front_end.step(scan) if track.is_later(scan.stamp_ns) else None
        if tracked is not None:
            track.keep(tracked)
            back_end.add(tracked)
        progress(number + 1, whole)
    seconds["front end"] = time.perf_counter() - started_s - sum(back_end.seconds.values())

    if not track.stamps_ns:
        raise SlamsimError(_nothing_to_track(log, motion))
    graph = back_end.finish(_rest_of(progress, len(log.scans), whole))
    trajectory = correct(track.front_end(), graph.keyframes)
    progress(whole, whole)
    return SlamResult(
        trajectory=trajectory,
        odometry=_odometry_alone(log, track.odometry()),
        graph=graph,
        match_quality=np.array(track.quality),
        degenerate=np.array(track.degenerate, dtype=np.bool_),
        closures_accepted=back_end.accepted,
        closures_rejected=back_end.rejected,
        warnings=(*front_end.warnings(), *track.warnings(), *back_end.warnings()),
        seconds=seconds | dict(back_end.seconds),
        closure_refusals=dict(back_end.refusals),
        front_end=track.front_end(),
    )


@dataclass(slots=True)
class _Track:
    """What is kept of every scan."""

    stamps_ns: list[int] = field(default_factory=list)
    T_map_base: list[FloatArray] = field(default_factory=list)
    T_odom_base: list[FloatArray] = field(default_factory=list)
    quality: list[float] = field(default_factory=list)
    degenerate: list[bool] = field(default_factory=list)
    out_of_order: int = 0

    def is_later(self, stamp_ns: int) -> bool:
        later = not self.stamps_ns or stamp_ns > self.stamps_ns[-1]
        self.out_of_order += not later
        return later

    def keep(self, tracked: Tracked) -> None:
        self.stamps_ns.append(tracked.stamp_ns)
        self.T_map_base.append(tracked.T_map_base)
        self.T_odom_base.append(tracked.T_odom_base)
        self.quality.append(tracked.match_quality)
        self.degenerate.append(tracked.degenerate)

    def front_end(self) -> PlanarTrajectory:
        return PlanarTrajectory(np.array(self.stamps_ns), np.array(self.T_map_base))

    def odometry(self) -> PlanarTrajectory:
        return PlanarTrajectory(np.array(self.stamps_ns), np.array(self.T_odom_base))

    def warnings(self) -> tuple[str, ...]:
        told = []
        if self.out_of_order:
            told.append(f"{self.out_of_order} scans left out: not later than the one before")
        share = float(np.mean(self.degenerate))
        if share > DEGENERATE_SHARE_TO_TELL:
            told.append(f"{share:.0%} of the scans left some direction to odometry (corridor?)")
        return tuple(told)


def _odometry_alone(log: Log, prediction: PlanarTrajectory) -> PlanarTrajectory:
    """What the log's own odometry says at the tracked scans; the prediction if it is silent."""
    if log.odometry is None:
        return prediction
    try:
        return PlanarTrajectory(prediction.stamps_ns, log.odometry.at(prediction.stamps_ns))
    except OutsideTimeRange:
        return prediction


def _rest_of(progress: Progress, done_before: float, whole: float) -> Progress:
    """Progress of the finish as the last part of the whole."""

    def report(done: float, total: float) -> None:
        progress(done_before + (whole - done_before) * done / max(total, 1.0), whole)

    return report


def _nothing_to_track(log: Log, motion: PlanarTrajectory) -> str:
    if len(log.scans) == 0:
        return f"{log.name}: no laser scans in the log; SLAM needs them"
    covered = f"{motion.stamps_ns[0]}..{motion.stamps_ns[-1]} ns" if len(motion) else "nothing"
    return (
        f"{log.name}: none of the {len(log.scans)} scans could be used; "
        f"odometry covers {covered}: is it on another clock?"
    )
