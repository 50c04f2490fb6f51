"""One wrong stamp costs one scan."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slamsim.core.types import Scan, ScanGeometry
from slamsim.slam.frontend.scan_order import InOrder

GEOMETRY = ScanGeometry(0.0, 0.1, 3, 0, 0.1, 10.0)


def scans(stamps_ns: list[int]) -> list[Scan]:
    return [Scan(stamp_ns, np.ones(3, np.float32), GEOMETRY) for stamp_ns in stamps_ns]


def stamps(order: InOrder) -> list[int]:
    return [scan.stamp_ns for scan in order]


@given(count=st.integers(3, 30), at=st.integers(0, 28), ahead=st.integers(2, 10**12))
def test_a_stamp_in_the_future_costs_the_scan_that_has_it(count: int, at: int, ahead: int) -> None:
    healthy = list(range(1, count + 1))
    at = min(at, count - 2)
    wrong = healthy.copy()
    wrong[at] += ahead
    order = InOrder(scans(wrong))
    assert stamps(order) == healthy[:at] + healthy[at + 1 :]
    assert order.left_out == 1 and "1 scans left out" in order.warnings()[0]


@given(late=st.lists(st.integers(1, 20), max_size=5))
def test_scans_that_come_late_are_left_to_the_session_and_the_rest_is_untouched(
    late: list[int],
) -> None:
    order = InOrder(scans([*range(1, 21), *late, 21, 22]))
    assert stamps(order) == [*range(1, 21), *late, 21, 22]
    assert order.left_out == 0 and order.warnings() == ()
