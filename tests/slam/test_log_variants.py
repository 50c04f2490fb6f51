"""Real logs as other drives: backward, mirrored, with fewer scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from log_variants import Variant
from real_logs import needs_radish, radish

from slamsim.config.slam import SlamConfig
from slamsim.core.types import Log
from slamsim.io.open import read_log
from slamsim.io.text.relations import read_relations
from slamsim.slam.session import run_slam

BACKWARD, MIRRORED = Variant(backward=True), Variant(mirrored=True)


def _alike(one: Log, other: Log) -> None:
    assert one.odometry is not None and other.odometry is not None
    np.testing.assert_array_equal(one.odometry.stamps_ns, other.odometry.stamps_ns)
    np.testing.assert_array_equal(one.odometry.poses, other.odometry.poses)
    np.testing.assert_array_equal(one.T_base_laser, other.T_base_laser)
    for a, b in zip(one.scans, other.scans, strict=True):
        assert a.stamp_ns == b.stamp_ns
        assert a.geometry.angle_min_rad == pytest.approx(b.geometry.angle_min_rad, abs=1e-12)
        assert replace(a.geometry, angle_min_rad=0.0) == replace(b.geometry, angle_min_rad=0.0)
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)


@pytest.mark.long
@needs_radish
def test_a_log_backward_or_mirrored_twice_is_the_log() -> None:
    log = read_log(radish("aces")[0])
    for variant in (BACKWARD, MIRRORED):
        once = variant.of(log)
        _alike(variant.of(once), log)
        assert once.odometry is not None and log.odometry is not None
        assert not np.array_equal(once.odometry.poses, log.odometry.poses)


@pytest.mark.slow
@needs_radish
@pytest.mark.parametrize(
    ("name", "variant", "most_m"),
    [
        ("fr079", BACKWARD, 0.035),
        ("aces", MIRRORED, 0.045),
        ("intel", Variant(keep=4), 0.06),
        ("fr-clinic", BACKWARD, 1.0),  # 14 m with what a slope contradicts set apart
    ],
)
def test_a_real_log_as_another_drive_is_mapped_as_well(
    name: str, variant: Variant, most_m: float
) -> None:
    path, relations_path = radish(name)
    log = read_log(path)
    slam = run_slam(variant.of(log), SlamConfig())
    scores = variant.scores(slam, log, read_relations(relations_path))
    assert scores.all.translation_mean_m < most_m
    assert not slam.failed
