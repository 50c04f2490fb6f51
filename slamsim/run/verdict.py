"""The verdict on a map in one sentence, and its warnings in order of weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from slamsim.core.result import EventKind, PoseGraph, SlamResult
from slamsim.guard.quantities import as_lengths, as_number
from slamsim.slam.events import BY_WEIGHT, by_weight

_DOUBTFUL: dict[EventKind, str] = {
    "kidnapped": "where the robot may have been carried",
    "torn": "where it may be torn",
    "joined": "where its parts hang together by little",
    "lost": "where scans fitted nowhere",
}
_GRAVE = BY_WEIGHT[: BY_WEIGHT.index("open loop") + 1]
_STILL_M = 0.1
"""A path that is shorter than a pose counts as a step (``report.numbers``) is none."""
_SIGMAS = float(np.sqrt(chi2.ppf(0.95, 2)))


def weighed(result: SlamResult, of_recording: Sequence[str]) -> tuple[str, ...]:
    """The warnings, the gravest first: a line for each kind of event.

    of_recording: what is wrong with the recording itself: it stands after events that make a map
    wrong, and before those that the map has coped with.
    """
    stamps_ns = result.trajectory.stamps_ns
    told = by_weight(result.events, int(stamps_ns[0]) if stamps_ns.size else 0)
    grave = [words for kind, words in told if kind in _GRAVE]
    light = [words for kind, words in told if kind not in _GRAVE]
    return (*map(str, result.failed), *grave, *of_recording, *light)


def position_95_m(graph: PoseGraph) -> float | None:
    """Within which every key frame's position in the map is, with 95 % each."""
    if len(graph.keyframes) == 0:
        return None
    variances = np.linalg.eigvalsh(graph.position_covariances)[:, -1]
    return float(_SIGMAS * np.sqrt(max(float(variances.max()), 0.0)))


def verdict(result: SlamResult, path_m: float, ate_m: float | None) -> str:
    """How good, how sure, what to look at. path_m: driven. ate_m: RMSE, None without a truth."""
    if path_m < _STILL_M:
        return "The robot did not move: this is what it saw from one place, not a map."
    kinds = [event.kind for event in result.events]
    looks = [f"{kinds.count(k)} {words}" for k, words in _DOUBTFUL.items() if k in kinds]
    within_m = position_95_m(result.graph)
    lengths_m = [length_m for length_m in (ate_m, within_m) if length_m is not None]
    told = as_lengths(*lengths_m)
    parts = [_how_well_it_fits(result) if ate_m is None else f"{told[0]} from the truth (RMSE)"]
    if within_m is not None:
        parts.append(f"every position is sure within {told[-1]} (95 %)")
    parts.append(f"places to look at: {', '.join(looks)}" if looks else _checked(result))
    return f"{'A map with doubts' if looks else 'A whole map'}: {'; '.join(parts)}."


def _how_well_it_fits(result: SlamResult) -> str:
    if not result.match_quality.size:
        return "no scan was matched"
    return (
        f"{as_number(100.0 * float(np.mean(result.match_quality)), 3)} % of what scans see fits it"
    )


def _checked(result: SlamResult) -> str:
    count = result.closures_accepted
    if not count:
        return "no place was seen twice, so no loop checks it"
    return f"{count:,} loop closures agree and nothing needs a look"
