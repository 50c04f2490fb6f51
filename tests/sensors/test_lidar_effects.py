"""Every way in which a lidar errs does what it says, alone, and leaves the others alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sensing_example import (
    PERFECT_LIDAR,
    Robot,
    figure_eight,
    joined_meshes,
    prism,
    rectangle,
    room,
    scan,
    standing,
)

from slamsim.config.lidar import LidarConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Float32Array, TriangleMesh
from slamsim.sensors.lidar import scan_geometry
from slamsim.sensors.rig import SensorRig

SCANS = 40


def with_effect(**changes: Any) -> LidarConfig:
    """A perfect lidar but for these settings; nested ones as dictionaries."""
    data = PERFECT_LIDAR.model_dump()
    for name, value in changes.items():
        data[name] = {**data[name], **value} if isinstance(value, dict) else value
    return LidarConfig.model_validate(data)


def standing_scans(config: LidarConfig, mesh: TriangleMesh, seed: int = 0) -> Float32Array:
    return scan(config, mesh, standing(1.5), scans=SCANS, seed=seed)


def wall_ahead(distance_m: float, half_width_m: float = 200.0) -> TriangleMesh:
    """One straight wall across x = distance, seen head-on by the middle beam."""
    outline = rectangle(distance_m, -half_width_m, distance_m + 1.0, half_width_m)
    return prism(outline)


def incidence_on_wall_rad(config: LidarConfig) -> np.ndarray:
    return np.abs(scan_geometry(config).angles_rad())


def test_a_perfect_lidar_repeats_itself() -> None:
    ranges = standing_scans(PERFECT_LIDAR, room())
    assert np.isfinite(ranges).all()
    assert (ranges == ranges[0]).all()


def test_constant_noise_has_its_standard_deviation_everywhere() -> None:
    clean = standing_scans(PERFECT_LIDAR, room())
    for sigma in (0.01, 0.05):
        config = with_effect(noise={"constant_m": sigma})
        error = standing_scans(config, room()) - clean
        assert error.std() == pytest.approx(sigma, rel=0.02)
        assert abs(error.mean()) < 4 * sigma / np.sqrt(error.size)


def test_proportional_noise_grows_with_the_range() -> None:
    config = with_effect(noise={"proportional": 0.01})
    relative = standing_scans(config, room()) / standing_scans(PERFECT_LIDAR, room()) - 1.0
    assert relative.std() == pytest.approx(0.01, rel=0.02)


def test_spot_noise_grows_with_the_tangent_of_incidence() -> None:
    config = with_effect(noise={"spot_mrad": 2.0}, beam_count=361, angle_min_deg=-45.0)
    clean = standing_scans(with_effect(beam_count=361, angle_min_deg=-45.0), wall_ahead(4.0))
    error = standing_scans(config, wall_ahead(4.0)) - clean
    incidence = incidence_on_wall_rad(config)
    slanted = incidence > np.radians(30)
    expected = 0.002 * clean[0, slanted] * np.tan(incidence[slanted])
    assert (error[:, slanted] / expected).std() == pytest.approx(1.0, rel=0.03)
    assert np.abs(error[:, 180]).max() < 1e-5  # head-on: no spread at all


def test_the_parts_of_the_noise_add_as_variances() -> None:
    config = with_effect(noise={"constant_m": 0.03, "proportional": 0.02}, beam_count=1)
    config = config.model_copy(update={"angle_min_deg": 0.0, "rate_hz": 900.0})
    ranges = scan(config, wall_ahead(2.0), standing(2.0), scans=1500)
    assert ranges.std() == pytest.approx(0.05, rel=0.06)


def test_resolution_makes_readings_whole_multiples() -> None:
    ranges = standing_scans(with_effect(resolution_m=0.25), room())[0].astype(np.float64)
    steps = ranges / 0.25
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-5)
    clean = standing_scans(PERFECT_LIDAR, room())[0]
    assert 0.1 < np.abs(ranges - clean).max() <= 0.125 + 1e-5


def test_below_the_minimum_is_invalid_and_above_the_maximum_is_no_return() -> None:
    clean = standing_scans(PERFECT_LIDAR, room())[0]
    ranges = standing_scans(with_effect(range_min_m=3.5, range_max_m=4.5), room())[0]
    np.testing.assert_array_equal(np.isnan(ranges), clean < 3.5)
    np.testing.assert_array_equal(np.isinf(ranges), clean > 4.5)
    between = np.isfinite(ranges)
    np.testing.assert_array_equal(ranges[between], clean[between])


def test_dropout_takes_its_share() -> None:
    ranges = standing_scans(with_effect(dropout={"probability": 0.2}), room())
    assert np.isinf(ranges).mean() == pytest.approx(0.2, abs=0.01)


def test_dropout_grows_with_the_square_of_the_range() -> None:
    config = with_effect(dropout={"at_max_range": 0.8}, range_max_m=8.0)
    lost = np.isinf(standing_scans(config, room()))
    clean = standing_scans(PERFECT_LIDAR, room())
    for low, high in ((3.0, 3.5), (4.0, 4.9)):
        ring = (clean > low) & (clean < high)
        expected = 0.8 * (clean[ring] / 8.0) ** 2
        assert lost[ring].mean() == pytest.approx(expected.mean(), abs=0.02)


def test_dropout_grows_with_the_slant() -> None:
    config = with_effect(dropout={"at_grazing": 0.9}, range_max_m=300.0)
    lost = np.isinf(standing_scans(config, wall_ahead(4.0)))
    incidence = incidence_on_wall_rad(config)
    for low, high in ((0, 20), (50, 60), (75, 85)):
        band = (incidence > np.radians(low)) & (incidence < np.radians(high))
        expected = 0.9 * (1 - np.cos(incidence[band]))
        assert lost[:, band].mean() == pytest.approx(expected.mean(), abs=0.02)


def test_surfaces_that_slant_too_far_give_no_return() -> None:
    config = with_effect(max_incidence_deg=70.0)
    lost = np.isinf(standing_scans(config, wall_ahead(4.0)))[0]
    incidence = np.degrees(incidence_on_wall_rad(config))
    assert lost[incidence > 70.1].all()
    assert not lost[incidence < 69.9].any()
    clean = standing_scans(with_effect(range_max_m=300.0), wall_ahead(4.0))[0]
    assert np.isfinite(clean[(incidence > 70.1) & (incidence < 85.0)]).all()


def step_world() -> TriangleMesh:
    """A wall at 5 m, and 1 m before it a second one that covers only the left half."""
    return joined_meshes([wall_ahead(5.0), prism(rectangle(4.0, 0.0, 4.2, 50.0))])


def test_beams_on_an_edge_mix_both_surfaces_and_no_others_do() -> None:
    thin = standing_scans(PERFECT_LIDAR, step_world())[0]
    config = with_effect(mixed={"divergence_mrad": 8.0, "probability": 1.0})
    wide = standing_scans(config, step_world())[0]
    changed = np.flatnonzero(~np.isclose(wide, thin, rtol=0.0, atol=1e-4))
    assert 1 <= changed.size <= 3
    assert np.abs(changed - 540).max() <= 2  # the edge lies straight ahead
    assert ((wide[changed] > 4.0) & (wide[changed] < 5.0)).all()


def test_mixing_probability_gap_and_width_act() -> None:
    def mixed_share(**mixed: float) -> float:
        config = with_effect(mixed={"divergence_mrad": 8.0, **mixed})
        ranges = scan(config, step_world(), standing(6.0), scans=200)[:, 538:543]
        return float(((ranges > 4.1) & (ranges < 4.9)).mean())

    always = mixed_share(probability=1.0)
    assert always > 0.15
    assert mixed_share(probability=0.5) == pytest.approx(0.5 * always, abs=0.06)
    assert mixed_share(probability=0.0) == 0.0
    assert mixed_share(probability=1.0, max_gap_m=0.9) == 0.0  # a metre apart: never mixed
    assert mixed_share(probability=1.0, min_gap_m=1.2) == 0.0  # counts as one surface
    assert mixed_share(probability=1.0, divergence_mrad=0.0) == 0.0


def test_a_corner_without_a_jump_does_not_mix() -> None:
    config = with_effect(mixed={"divergence_mrad": 8.0, "probability": 1.0})
    np.testing.assert_array_equal(
        standing_scans(config, room()), standing_scans(PERFECT_LIDAR, room())
    )


def test_intensities_follow_incidence_and_range() -> None:
    config = SensorsConfig(lidar=with_effect(intensities=True, range_max_m=4.5))
    batch = SensorRig(room(), Robot(), config, seed=0).sense(standing(0.2)).scans
    assert batch.intensities is not None
    centre = 540  # the wall 4 m before the origin, 3.9 m before the laser
    assert batch.intensities[0, centre] == pytest.approx(1 / 3.9**2, rel=1e-3)
    assert (batch.intensities[np.isinf(batch.ranges_m)] == 0).all()
    assert (batch.intensities[np.isfinite(batch.ranges_m)] > 0).all()
    plain = SensorsConfig(lidar=PERFECT_LIDAR)
    assert SensorRig(room(), Robot(), plain, seed=0).sense(standing(0.2)).scans.intensities is None


ALL_ON: dict[str, Any] = {
    "noise": {"constant_m": 0.01},
    "dropout": {"probability": 0.1},
    "mixed": {"divergence_mrad": 8.0, "probability": 0.5},
}


def test_the_seed_decides() -> None:
    config = with_effect(**ALL_ON)
    first, again = standing_scans(config, room(), 5), standing_scans(config, room(), 5)
    np.testing.assert_array_equal(first, again)
    assert (first != standing_scans(config, room(), 6)).mean() > 0.5


@pytest.mark.parametrize("off", sorted(ALL_ON))
def test_switching_one_effect_off_leaves_the_draws_of_the_others(off: str) -> None:
    world = step_world()
    drive = figure_eight(2.0)
    all_on = scan(with_effect(**ALL_ON), world, drive, scans=SCANS)
    without = scan(
        with_effect(**{name: value for name, value in ALL_ON.items() if name != off}),
        world,
        drive,
        scans=SCANS,
    )
    both = np.isfinite(all_on) & np.isfinite(without)
    if off == "noise":
        np.testing.assert_array_equal(np.isinf(all_on), np.isinf(without))
        assert (all_on[both] != without[both]).mean() > 0.99
    elif off == "dropout":
        np.testing.assert_array_equal(all_on[both], without[both])
        assert np.isinf(all_on).sum() > 1.05 * np.isinf(without).sum()
    else:
        same = all_on[both] == without[both]
        assert 0.98 < same.mean() < 1.0
