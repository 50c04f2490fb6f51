"""What held the scans along a corridor is gone from one scan to the next: when that is told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from simulated import box, true_ranges

from slamsim.core.result import Event
from slamsim.core.types import Cloud, FloatArray, PlanarTrajectory, ScanGeometry
from slamsim.slam.frontend.kidnap_detection import KIDNAP_WITHIN_NS
from slamsim.slam.frontend.lost_holds import HELD_SCANS, LostHolds
from slamsim.slam.matching.base import Match

FLASH = ScanGeometry(-np.pi, np.deg2rad(1.0), 360, 0, 0.1, 10.0)
TICK_NS = 100_000_000
END_NEAR, END_FAR = box(-20.0, -1.0, 4.0, 1.0), box(-20.0, -1.0, 16.0, 1.0)
"""A corridor 2 m wide, whose end a lidar at the origin sees or not."""

HELD, FREE = np.diag([1e5, 1e5, 1e5]), np.diag([1.0, 1e5, 1e5])


def cloud(walls: FloatArray, stamp_ns: int) -> Cloud:
    still = PlanarTrajectory(np.array([0, 10**12]), np.zeros((2, 3)))
    ranges_m = true_ranges(walls, still, 0, FLASH)
    angles, hit = FLASH.angles_rad(), np.isfinite(ranges_m)
    reach_m = np.where(hit, ranges_m, FLASH.range_max_m)
    points_m = reach_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return Cloud(stamp_ns, points_m, np.zeros_like(points_m), hit)


def told(walls: Sequence[FloatArray], held: Sequence[FloatArray], last_ns: int = 0) -> list[Event]:
    """What is told of scans of these walls that were matched at the origin with this information;
    the last one comes so much later."""
    holds, events = LostHolds(), []
    for number, (seen, information) in enumerate(zip(walls, held, strict=True)):
        stamp_ns = number * TICK_NS + last_ns * (number == len(walls) - 1)
        match = Match(np.zeros(3), information, 1.0, 1.0, np.zeros((0, 3)))
        events.append(holds.see(cloud(seen, stamp_ns), match))
    return [event for event in events if event is not None]


BEFORE = [END_NEAR] * HELD_SCANS
ALL_HELD = [HELD] * HELD_SCANS


def test_an_end_of_a_corridor_that_is_gone_is_told_with_its_time() -> None:
    (event,) = told([*BEFORE, END_FAR, END_FAR], [*ALL_HELD, FREE, FREE])

    assert event.kind == "torn"
    assert (event.start_ns, event.end_ns) == ((HELD_SCANS - 1) * TICK_NS, HELD_SCANS * TICK_NS)


@pytest.mark.parametrize(
    ("walls", "held", "last_ns"),
    [
        pytest.param([*BEFORE, END_NEAR], [*ALL_HELD, FREE], 0, id="nothing is gone"),
        pytest.param([*BEFORE, END_FAR], [*ALL_HELD, HELD], 0, id="something else holds"),
        pytest.param([END_FAR] * 3 + [END_NEAR], [*ALL_HELD, FREE], 0, id="a thing came nearer"),
        pytest.param([*BEFORE, END_FAR], [HELD, FREE, HELD, FREE], 0, id="held by chance before"),
        pytest.param([*BEFORE[1:], END_FAR], [*ALL_HELD[1:], FREE], 0, id="too few scans"),
        pytest.param([*BEFORE, END_FAR], [*ALL_HELD, FREE], KIDNAP_WITHIN_NS, id="a long time"),
    ],
)
def test_other_scans_that_are_held_less_are_not_told(
    walls: list[FloatArray], held: list[FloatArray], last_ns: int
) -> None:
    assert told(walls, held, last_ns) == []
