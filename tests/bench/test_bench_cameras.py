"""Figures of cameras that do not depend on the machine."""

from __future__ import annotations

from slamsim.bench.cameras.flow import flow_error_px


def test_flow_is_within_a_hundredth_of_a_pixel_of_homographies() -> None:
    assert 0.0 < flow_error_px() < 0.01
