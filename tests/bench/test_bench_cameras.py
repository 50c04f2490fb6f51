"""Figures of cameras that do not depend on the machine."""

from __future__ import annotations

from slamsim.bench.cameras.command import flow_error_px
from slamsim.bench.cameras.tags import TAGS, ate_m, hall, mapped


def test_flow_is_within_a_hundredth_of_a_pixel_of_homographies() -> None:
    assert 0.0 < flow_error_px() < 0.01


def test_tags_hold_a_robot_whose_lidar_sees_nothing() -> None:
    true, track, odometry = hall(0, 30.0)
    found = mapped(track, odometry)
    assert ate_m(found, true) < 0.02
    assert len(found.tags) == TAGS
