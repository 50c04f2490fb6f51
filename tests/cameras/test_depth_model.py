"""Errors of stereo depth: as large as set, where physics puts them, on the published curve."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_data import REDWOOD_TABLE, needs
from numpy.typing import NDArray
from pydantic import ValidationError

from slamsim.cameras.depth_model import DepthModel, correlated_noise, load_redwood_table
from slamsim.cameras.depth_settings import DepthNoiseConfig
from slamsim.cameras.dots import DotPattern
from slamsim.cameras.lens import pinhole
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.numbers import BadNumbers

CAMERA = pinhole(848, 480, 87.0)
SIZE = (CAMERA.height, CAMERA.width)
EXACT: dict[str, Any] = {"disparity_noise_px": 0.0, "disparity_step_px": 0.0, "fattening_px": 0}
D435, D455 = DepthNoiseConfig(), DepthNoiseConfig(baseline_m=0.095)


def wall(depth_m: float) -> NDArray[np.float32]:
    return np.full(SIZE, depth_m, dtype=np.float32)


def measured(
    depth_m: NDArray[np.float32], settings: DepthNoiseConfig = D435, seed: int = 1, **surface: Any
) -> NDArray[np.uint16]:
    """Seen head-on, half of the light comes back, nothing is occluded, unless it is said."""
    cosine = surface.pop("cosine", np.ones_like(depth_m))
    reflectance = surface.pop("reflectance", np.full_like(depth_m, 0.5))
    occluded = surface.pop("occluded", np.zeros(depth_m.shape, dtype=np.bool_))
    model, rng = DepthModel.of(settings), np.random.default_rng(seed)
    return model.measured(depth_m, cosine, reflectance, occluded, CAMERA, rng, **surface)


@pytest.mark.parametrize("settings", [D435, D455], ids=["D435", "D455"])
@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_the_noise_is_as_large_as_it_is_set(settings: DepthNoiseConfig, depth_m: float) -> None:
    """Within 5 %, back in pixels of disparity; and it grows with the square of the depth."""
    frames = [measured(wall(depth_m), settings, seed) for seed in range(3)]
    found = np.concatenate([frame[frame > 0] for frame in frames]) * 1e-3
    scale = CAMERA.focal_px[0] * settings.baseline_m
    assert (scale / found).std() == pytest.approx(settings.disparity_noise_px, rel=0.05)
    sigma_m = DepthModel(settings).sigma_m(depth_m, CAMERA)
    assert found.std() == pytest.approx(sigma_m, rel=0.05)
    assert sigma_m == pytest.approx(DepthModel(settings).sigma_m(1.0, CAMERA) * depth_m**2)


def test_the_curve_is_the_one_published_for_the_d435() -> None:
    """Standard deviation 0.000611 + 0.003587 (z - 0.3515)^2 from 0.2 to 3.25 m, as the sensor model
    of the D435 in ANYbotics' elevation_mapping has it (realsense_d435.yaml); and Intel's data
    sheet: at 2 m at most 2 % of the depth."""
    ratios = []
    for depth_m in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.25):
        frame = measured(wall(depth_m))
        published_m = 0.000611 + 0.003587 * (depth_m - 0.3515) ** 2
        ratios.append(float(1e-3 * frame[frame > 0].std() / published_m))
    assert min(ratios) > 0.9 and max(ratios) < 1.45
    assert np.exp(np.mean(np.log(ratios))) == pytest.approx(1.1, abs=0.1)
    at_2_m = measured(wall(2.0))
    assert np.sqrt(np.mean((at_2_m[at_2_m > 0] * 1e-3 - 2.0) ** 2)) < 0.02 * 2.0


def test_disparities_come_in_steps() -> None:
    """At 6 m a 32nd of a pixel is 50 mm; only such depths are told."""
    depths_mm = np.unique(measured(wall(6.0)))[1:]
    scale = CAMERA.focal_px[0] * D435.baseline_m
    steps = 32.0 * scale / (1e-3 * depths_mm)
    assert len(depths_mm) > 5
    assert np.abs(steps - np.rint(steps)).max() < 0.02
    assert np.diff(depths_mm).min() > 30


def test_errors_of_neighbours_are_alike_within_a_window() -> None:
    """The correlation of means of overlapping windows is the share of the overlap."""
    noise = correlated_noise((400, 400), 5, np.random.default_rng(3))
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    for apart in (1, 2, 4, 5, 9):
        expected = max(1.0 - apart / 5.0, 0.0)
        for first, second in (
            (noise[:, apart:], noise[:, :-apart]),
            (noise[apart:], noise[:-apart]),
        ):
            assert np.mean(first * second) == pytest.approx(expected, abs=0.04)
    edges = np.concatenate([noise[0], noise[-1], noise[:, 0], noise[:, -1]])
    assert edges.std() == pytest.approx(1.0, abs=0.1)


def test_without_errors_depth_is_rounded_to_millimetres() -> None:
    truth = np.random.default_rng(0).uniform(1.0, 9.0, SIZE).astype(np.float32)
    truth[5, 400:420] = [np.inf, np.nan, 0.0, -1.0, 20.0] * 4
    found = measured(truth, DepthNoiseConfig(**EXACT, signal_least=0.0))
    there = np.isfinite(truth) & (truth > 0.0) & (truth < 10.0)
    scale = CAMERA.focal_px[0] * 0.05
    in_view = scale / np.where(there, truth, 1.0) <= np.arange(CAMERA.width)
    np.testing.assert_array_equal(found > 0, there & in_view)
    off_mm = found[found > 0] - 1e3 * truth[found > 0].astype(np.float64)
    assert np.abs(off_mm).max() < 0.51


def test_the_left_band_has_no_depth() -> None:
    """As wide as the disparity: what is there lies beyond the right image's left edge."""
    found = measured(wall(1.0), DepthNoiseConfig(**EXACT))
    disparity_px = CAMERA.focal_px[0] * 0.05
    assert not found[:, : int(disparity_px)].any()
    assert found[:, int(disparity_px) + 1 :].all()


def test_the_least_distance_follows_from_the_search() -> None:
    """0.18 m of a D435 at 848 x 480 (data sheet: 0.195), and half of it at half the size."""
    nearest_m = DepthModel(D435).depth_min_m(CAMERA)
    assert nearest_m == pytest.approx(0.195, rel=0.1)
    assert DepthModel(D435).depth_min_m(pinhole(424, 240, 87.0)) == pytest.approx(nearest_m / 2)
    exact = DepthNoiseConfig(**EXACT)
    assert measured(wall(0.98 * nearest_m), exact).max() == 0
    assert measured(wall(1.02 * nearest_m), exact).max() > 0
    later = DepthNoiseConfig(**EXACT, depth_min_m=0.5)
    assert measured(wall(0.49), later).max() == 0 and measured(wall(0.51), later).max() > 0


def step(column: int) -> NDArray[np.float32]:
    """A wall at 3 m, before the right part of which there is another at 1 m."""
    truth = wall(3.0)
    truth[:, column:] = 1.0
    return truth


def test_what_is_near_grows_over_its_edge() -> None:
    settings = DepthNoiseConfig(**EXACT | {"fattening_px": 3})
    found = measured(step(400), settings)
    assert set(np.unique(found[:, 300:])) == {1000, 3000}
    np.testing.assert_array_equal((found[50] == 1000)[390:], np.arange(390, 848) >= 397)


def test_what_the_right_camera_does_not_see_has_no_depth_but_beside_what_hides_it() -> None:
    occluded = np.zeros(SIZE, dtype=np.bool_)
    occluded[:, 385:400] = True
    found = measured(step(400), DepthNoiseConfig(**EXACT | {"fattening_px": 3}), occluded=occluded)
    row = found[50]
    assert (row[300:385] == 3000).all() and (row[385:397] == 0).all() and (row[397:] == 1000).all()


def test_dark_and_grazed_surfaces_are_noisy_and_then_lost() -> None:
    def share_and_noise(**surface: Any) -> tuple[float, float]:
        frame = measured(wall(2.0), **surface)[:, 30:]
        return float((frame > 0).mean()), float(frame[frame > 0].std()) if frame.any() else 0.0

    bright = share_and_noise()
    for dim, gone in (
        ({"reflectance": wall(0.1)}, {"reflectance": wall(0.01)}),
        ({"cosine": wall(0.2)}, {"cosine": wall(0.03)}),
    ):
        share, noise = share_and_noise(**dim)
        assert share > 0.99
        assert noise == pytest.approx(bright[1] * np.sqrt(3.0), rel=0.05)
        assert share_and_noise(**gone)[0] < 0.02
    half = share_and_noise(reflectance=wall(D435.signal_least))[0]
    assert half == pytest.approx(0.5, abs=0.05)


def test_mirrors_have_no_depth() -> None:
    rough, smooth = wall(0.9), wall(0.01)
    np.testing.assert_array_equal(measured(wall(2.0), roughness=rough), measured(wall(2.0)))
    tilted: dict[str, Any] = {"cosine": wall(0.8)}
    assert (measured(wall(2.0), roughness=smooth, **tilted) > 0).mean() < 0.2
    assert measured(wall(2.0), roughness=smooth).max() == 0
    matt = DepthNoiseConfig(shiny_below_roughness=0.0)
    assert (measured(wall(2.0), matt, roughness=smooth) > 0).mean() > 0.95


def test_a_hole_in_a_surface_is_not_filled_by_it() -> None:
    reflectance = wall(0.5)
    reflectance[200:203, 300:303] = 0.0
    found = measured(
        wall(2.0), DepthNoiseConfig(**EXACT | {"fattening_px": 3}), reflectance=reflectance
    )
    assert not found[200:203, 300:303].any() and (found[:, 30:] == 0).sum() == 9


def test_a_frame_follows_from_its_generator_alone_and_effects_from_their_own() -> None:
    truth = step(400)
    np.testing.assert_array_equal(measured(truth, seed=4), measured(truth, seed=4))
    assert (measured(truth, seed=4) != measured(truth, seed=5)).any()
    lossy, never = D435, D435.model_copy(update={"signal_least": 0.0})
    dim: dict[str, Any] = {"reflectance": wall(0.05)}
    first, second = measured(truth, lossy, **dim), measured(truth, never, **dim)
    both = (first > 0) & (second > 0)
    both[:, 390:410] = False  # where a loss changes what grows over the edge
    np.testing.assert_array_equal(first[both], second[both])


@needs(REDWOOD_TABLE)
def test_the_table_of_redwood_bends_depth() -> None:
    """As simdepth.py of Redwood does, pixel by pixel in plain Python."""
    table = load_redwood_table(REDWOOD_TABLE)
    settings = DepthNoiseConfig(**EXACT, distortion_table=REDWOOD_TABLE)
    for depth_m in (1.0, 2.7, 6.2):
        found = measured(wall(depth_m), settings)
        for row, column in ((0, 847), (100, 300), (240, 424), (479, 200), (300, 700)):
            upper = int((depth_m + 1) / 2)
            share = (depth_m - (2 * (upper - 1) + 1)) / 2
            y, x = row * 80 // 480, column * 80 // 848
            low, high = (table[y, x, min(max(k, 0), 4)] for k in (upper - 1, upper))
            factor = (1 - share) * low + share * high
            expected = 1e3 * depth_m / factor if factor > 1e-5 else 0.0
            assert abs(float(found[row, column]) - expected) <= 1.0


@pytest.mark.parametrize("kind", ["missing", "text", "shape", "nan", "object"])
def test_a_wrong_table_is_refused(kind: str, tmp_path: Path) -> None:
    path, data = tmp_path / "table.npy", io.BytesIO()
    table: Any = {
        "shape": np.ones((80, 399), np.float32),
        "nan": np.full((80, 400), np.nan, np.float32),
        "object": np.array([{}], dtype=object),
    }.get(kind)
    if kind == "text":
        path.write_text("1 2 3")
    elif table is not None:
        np.save(data, table, allow_pickle=True)
        path.write_bytes(data.getvalue())
    with pytest.raises(NotFound if kind == "missing" else InputRefused):
        DepthModel.of(DepthNoiseConfig(distortion_table=path))


def test_images_of_another_size_and_settings_that_are_none_are_refused() -> None:
    small = np.ones((4, 4), np.float32)
    with pytest.raises(BadNumbers, match="480"):
        measured(small)
    with pytest.raises(BadNumbers, match="480"):
        measured(wall(2.0), reflectance=small)
    for wrong in ({"baseline_m": 0.0}, {"window_px": 0}, {"baseline": 0.05}):
        with pytest.raises(ValidationError):
            DepthNoiseConfig.model_validate(wrong)


def directions(count: int = 300) -> NDArray[np.float64]:
    """A dense square of 0.3 by 0.3 at distance one."""
    steps = np.linspace(-0.15, 0.15, count)
    x, y = np.meshgrid(steps, steps)
    return np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])


def test_there_are_as_many_dots_as_the_projector_has() -> None:
    """Peaks of a fine picture, by looking at their neighbours."""
    pattern = DotPattern(3)
    picture = pattern.intensity(directions(600), np.zeros(600 * 600)).reshape(600, 600)
    middle = picture[1:-1, 1:-1]
    around = [picture[1 + i : 599 + i, 1 + j : 599 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    peaks = int(((middle >= np.max(around, axis=0)) & (middle > 0.5)).sum())
    assert peaks == pytest.approx((0.3 / pattern.cell) ** 2, rel=0.15)
    assert picture.max() > 0.95 and np.median(picture) < 0.01
    assert picture.mean() == pytest.approx(pattern.mean, rel=0.1)


def test_dots_seen_by_large_pixels_are_what_small_pixels_see_on_average() -> None:
    pattern, factor = DotPattern(7), 10
    fine = pattern.intensity(directions(), np.zeros(300 * 300))
    averaged = fine.reshape(30, factor, 30, factor).mean(axis=(1, 3))
    pixel = 0.3 / 299 * factor
    centres = directions().reshape(30, factor, 30, factor, 3).mean(axis=(1, 3)).reshape(-1, 3)
    coarse = pattern.intensity(centres, np.full(900, pixel)).reshape(30, 30)
    assert coarse.sum() == pytest.approx(averaged.sum(), rel=0.05)
    # The blur of a square pixel is taken for a Gaussian of the same variance.
    assert np.corrcoef(coarse.ravel(), averaged.ravel())[0, 1] > 0.9


def test_the_pattern_is_in_the_projector_s_field_and_the_same_for_a_seed() -> None:
    outside = np.array([[0.0, 0.0, -1.0], [1.1, 0.0, 1.0], [0.0, -0.7, 1.0], [1.0, 0.0, 0.0]])
    assert not DotPattern(1).intensity(outside, np.full(4, 0.01)).any()
    inside = directions(60)
    first, again, other = (
        DotPattern(seed).intensity(2.5 * inside, np.full(len(inside), 1e-3)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    np.testing.assert_allclose(
        DotPattern(1).intensity(inside, np.full(len(inside), 1e-3)), first, atol=1e-6
    )
