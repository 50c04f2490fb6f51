"""One half of a real log localised in the map of the other, against hand-verified relations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from real_logs import needs_radish, radish
from simulated import ScanList

from slamsim.bench.robustness.disturbances import without_span
from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import between
from slamsim.core.types import Log, PlanarTrajectory
from slamsim.evaluate.relations import score_relations
from slamsim.io.open import read_log
from slamsim.io.text.relations import read_relations
from slamsim.slam.localise import PLACED, Localised, localise_log
from slamsim.slam.mapping.saved_map import SavedMap
from slamsim.slam.session import map_log

pytestmark = [pytest.mark.slow, needs_radish]


@cache
def halves(name: str) -> tuple[Log, Log]:
    log = read_log(radish(name)[0])
    scans = list(log.scans)
    middle = len(scans) // 2
    first, second = (ScanList(part) for part in (scans[:middle], scans[middle:]))
    return replace(log, scans=first), replace(log, scans=second)


@cache
def mapped(name: str) -> SavedMap:
    return map_log(halves(name)[0], SlamConfig())[1]


@cache
def localised(name: str) -> Localised:
    return localise_log(halves(name)[1], SlamConfig(), mapped(name))


def placed_pairs_m(found: Localised, relations_file: Path) -> tuple[float, int]:
    """Mean error of the relations between scans that are said to be placed, and their number."""
    relations = read_relations(relations_file)
    placed_ns = found.stamps_ns[found.states == PLACED]
    ends_ns = (relations.from_ns, relations.to_ns)
    both = np.logical_and(*(np.isin(ns, placed_ns) for ns in ends_ns))
    track = PlanarTrajectory(found.stamps_ns[found.known], found.poses[found.known])
    scores = score_relations(
        track, relations.from_ns[both], relations.to_ns[both], relations.planar[both]
    )
    return scores.all.translation_mean_m, int(both.sum())


@pytest.mark.parametrize(("name", "most_m"), [("fr079", 0.035), ("intel", 0.015)])
def test_scans_that_are_said_to_be_placed_are_right(name: str, most_m: float) -> None:
    found = localised(name)
    error_m, pairs = placed_pairs_m(found, radish(name)[1])
    assert error_m <= most_m and pairs > 300
    assert np.mean(found.states == PLACED) > 0.6 and found.known.all()


def test_a_kidnapping_that_odometry_hides_is_found() -> None:
    """A quarter of the drive is cut out; the robot is 8 m away and turned by half a circle."""
    whole, log = localised("fr079"), halves("fr079")[1]
    stamps_ns = [scan.stamp_ns for scan in log.scans]
    start_ns, end_ns = (stamps_ns[int(share * len(stamps_ns))] for share in (0.3, 0.55))
    found = localise_log(without_span(log, start_ns, end_ns), SlamConfig(), mapped("fr079"))
    carried_ns = np.where(found.stamps_ns >= start_ns, end_ns - start_ns, 0)
    inside = found.known & (found.stamps_ns + carried_ns <= whole.stamps_ns[-1])
    track = whole.trajectory.at((found.stamps_ns + carried_ns)[inside])
    off = between(track, found.poses[inside])
    off_m = np.hypot(off[:, 0], off[:, 1])
    assert off_m.max() < 0.15 and off_m[found.states[inside] == PLACED].max() < 0.05
    assert inside.mean() > 0.95
    told_ns = [e.start_ns for e in found.slam.events if e.kind == "kidnapped"]
    assert any(abs(stamp_ns - start_ns) < 2e9 for stamp_ns in told_ns)
