"""Figures of cameras that do not depend on the machine."""

from __future__ import annotations

from slamsim.bench.cameras.command import flow_error_px
from slamsim.bench.cameras.halls import TAGS, ate_m, hall, mapped
from slamsim.core.landmarks import NO_TAGS


def test_flow_is_within_a_hundredth_of_a_pixel_of_homographies() -> None:
    assert 0.0 < flow_error_px() < 0.01


def test_tags_hold_a_robot_whose_lidar_sees_nothing() -> None:
    true, log, tags = hall(0, 60.0)  # half as long as those that bench measures against 20 mm
    held = mapped(log, tags)
    assert ate_m(held, true) < 0.02 * 2.0**0.5  # half as many images
    assert len(held.landmarks) == TAGS
    assert ate_m(mapped(log, NO_TAGS), true) > 10.0 * ate_m(held, true)
