"""What SLAM made of a log, put together from what its front end and its back end found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between, compose
from slamsim.core.result import Event, MapGraph, PoseGraph, SlamResult
from slamsim.core.types import Log, PlanarPoses, PlanarTrajectory
from slamsim.core.weighing import in_words
from slamsim.slam.backend.correction import correct_pieces
from slamsim.slam.backend.smoothing import Smoothed
from slamsim.slam.backend.surface_information import MapInformation, smoothed_information
from slamsim.slam.failures import Failures
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.frontend.track import Track
from slamsim.slam.online.sync_back_end import BackEndOutcome


def assemble(
    track: Track,
    front_end: FrontEnd,
    outcome: BackEndOutcome,
    first: int,
    seconds: Mapping[str, float],
    torn: Sequence[Event] = (),
) -> tuple[SlamResult, MapInformation | None]:
    """The result of one drive, and what holds its key frames, None without a refinement.

    track: its scans, at least one of them. outcome: of the whole map; the drive begins at key
    frame number ``first`` of it. seconds: spent on the way, by stage. torn: what is to be told
    besides. What fails here leaves the result of the back end as it is.
    """
    graph = _since(outcome.graph, first)
    raw, odometry = track.front_end(), track.odometry()
    corrected = correct_pieces(raw, graph.keyframes, _breaks_ns(front_end, outcome))
    failures, last = Failures(outcome.failed), len(outcome.graph.keyframes) - 1
    trajectory, of_scans, information = corrected, graph, None
    with failures.caught("smooth", last):
        smoothed = track.smoothed(corrected, track.calibrated_odometry(outcome.calibration))
        of_scans, information = _smoothed_graph(graph, outcome, first, smoothed)
        trajectory = smoothed.track
    events = _in_order(front_end, outcome, torn)
    counted = (*front_end.warnings(), *track.warnings())
    result = SlamResult(
        trajectory=trajectory,
        odometry=odometry,
        graph=of_scans,
        match_quality=track.quality,
        degenerate=track.degenerate,
        closures_accepted=outcome.accepted,
        closures_rejected=outcome.rejected,
        warnings=(*map(str, failures), *counted, *in_words(events, int(trajectory.stamps_ns[0]))),
        seconds=_summed(seconds, outcome.seconds),
        closure_refusals=dict(outcome.refusals),
        front_end=raw,
        parts={
            "prediction": odometry,
            "front_end": raw,
            "closures": _poses_since(outcome.unrefined, first),
            "graph": graph.keyframes,
            "smoothed": trajectory,
        },
        match_information=track.information,
        calibration=front_end.calibrated(outcome.calibration),
        events=events,
        failed=tuple(failures),
    )
    return result, information


def odometry_alone(log: Log, prediction: PlanarTrajectory) -> PlanarTrajectory:
    """What the log's own odometry says at the tracked scans; the prediction if it is silent, and in
    steps from its ends where scans were tracked before it began or after it ended."""
    if log.odometry is None or not len(log.odometry):
        return prediction
    stamps_ns, steps = prediction.stamps_ns, prediction.poses
    first_ns, last_ns = log.odometry.stamps_ns[[0, -1]].tolist()
    covered = np.flatnonzero((stamps_ns >= first_ns) & (stamps_ns <= last_ns))
    if not covered.size:
        return prediction
    first, last = int(covered[0]), int(covered[-1])
    poses = steps.copy()
    poses[covered] = log.odometry.at(stamps_ns[covered])
    for end, beyond in ((first, slice(0, first)), (last, slice(last + 1, None))):
        poses[beyond] = compose(poses[end], between(steps[end], steps[beyond]))
    return PlanarTrajectory(stamps_ns, poses)


def _breaks_ns(front_end: FrontEnd, outcome: BackEndOutcome) -> list[int]:
    """Where the map is torn apart: what lies before and after is corrected apart as well."""
    carried_ns = [event.start_ns for event in outcome.events if event.kind == "kidnapped"]
    withdrawn_ns = {e.start_ns for e in front_end.events() if _is_withdrawn(e, outcome)}
    return sorted({*front_end.breaks_ns, *carried_ns} - withdrawn_ns)


def _is_withdrawn(event: Event, outcome: BackEndOutcome) -> bool:
    return event.kind == "kidnapped" and event.end_ns in outcome.withdrawn_ns


def _smoothed_graph(
    graph: PoseGraph, outcome: BackEndOutcome, first: int, smoothed: Smoothed
) -> tuple[PoseGraph, MapInformation | None]:
    """The drive's key frames where its smoothed track has them, as sure as they are there."""
    stamps_ns = graph.keyframes.stamps_ns
    keyframes = PlanarTrajectory(stamps_ns, smoothed.track.at(stamps_ns))
    graph = replace(graph, keyframes=keyframes)
    if outcome.information is None:
        return graph, None
    information = smoothed_information(outcome.information, outcome.graph, first, smoothed)
    sure = information.covariances()
    return replace(graph, covariances=sure.relative, in_map=sure.in_map), information


def _in_order(
    front_end: FrontEnd, outcome: BackEndOutcome, torn: Sequence[Event]
) -> tuple[Event, ...]:
    noticed = (event for event in front_end.events() if not _is_withdrawn(event, outcome))
    happened = (*noticed, *outcome.events, *torn)
    return tuple(sorted(happened, key=lambda event: event.start_ns))


def _summed(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {stage: one.get(stage, 0.0) + other.get(stage, 0.0) for stage in {**one, **other}}


def _since(graph: MapGraph, first: int) -> PoseGraph:
    """The key frames from number ``first`` on, and the edges between them."""
    edges = tuple(
        replace(edge, source=edge.source - first, target=edge.target - first)
        for edge in graph.edges
        if min(edge.source, edge.target) >= first
    )
    return PoseGraph(_poses_since(graph.keyframes, first), graph.covariances[first:], edges)


def _poses_since(keyframes: PlanarPoses, first: int) -> PlanarTrajectory:
    """Those of one drive alone; the stamps of several are in no order."""
    return PlanarTrajectory(keyframes.stamps_ns[first:], keyframes.poses[first:])
