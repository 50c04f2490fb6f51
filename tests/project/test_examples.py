"""The examples run, and what they compute is held against slow and exact ways to do the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import floor_segmentation
import loop_closures
import numpy as np
import pytest
import scan_pairs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from short_drives import cut_drives_short

import slamsim.dataset
from slamsim.core.geometry import between, compose, inverse, wrap_angle
from slamsim.core.types import FloatArray
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.recipe.distributions import Constant
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.io.text.relations import Relations

RECIPE = Path(__file__).parents[2] / "examples" / "loop_closures.yaml"
BEARINGS = np.radians(np.arange(-135.0, 135.0, 1.0))
ROOM_M = np.array([[-3.0, -2.0], [4.0, -2.0], [4.0, 1.0], [1.5, 1.0], [1.5, 5.0], [-3.0, 5.0]])


def seen_from(pose: FloatArray, corners_m: FloatArray = ROOM_M) -> scan_pairs.View:
    """Exact ranges to the walls of a room."""
    ranges_m = np.full(BEARINGS.size, np.inf)
    for beam, angle in enumerate(BEARINGS + pose[2]):
        along = np.array([np.cos(angle), np.sin(angle)])
        for a, b in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
            matrix = np.column_stack([along, a - b])
            if abs(np.linalg.det(matrix)) > 1e-9:
                far, share = np.linalg.solve(matrix, a - pose[:2])
                if far > 0.0 and 0.0 <= share <= 1.0:
                    ranges_m[beam] = min(ranges_m[beam], far)
    view = scan_pairs.view_of(ranges_m, BEARINGS)
    assert view is not None
    return view


@settings(max_examples=10)
@given(
    st.tuples(st.floats(-1.5, 1.0), st.floats(-1.0, 0.5), st.floats(-3.1, 3.1)),
    st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-0.6, 0.6)),
)
def test_scans_of_one_room_are_laid_over_each_other(
    place: tuple[float, float, float], step: tuple[float, float, float]
) -> None:
    T_room_a = np.array(place)
    T_a_b = np.array(step)
    a, b = seen_from(T_room_a), seen_from(compose(T_room_a, T_a_b))
    shares = scan_pairs.overlap(a, b, inverse(T_a_b))
    found, rival = scan_pairs.aligned(a, b)
    error = between(inverse(T_a_b), found)
    assert min(shares) > 0.5 and 0.0 <= rival <= 1.0
    assert np.hypot(*error[:2]) < 0.15 and abs(wrap_angle(error[2:])[0]) < 0.06


def test_a_scan_agrees_with_itself_and_not_with_another_room() -> None:
    a = seen_from(np.array([0.0, 0.0, 0.3]))
    other = seen_from(np.array([0.0, 0.0, 0.3]), 1.9 * ROOM_M)
    names = scan_pairs.FEATURES
    itself, strange = scan_pairs.pair_features(a, a), scan_pairs.pair_features(a, other)
    assert itself.size == strange.size == len(names)
    assert itself[scan_pairs.SCORE] == 1.0 and strange[scan_pairs.SCORE] < 0.8
    assert itself[scan_pairs.RANGES] == 0.0 and strange[scan_pairs.RANGES] > 0.3
    assert scan_pairs.view_of(np.full(90, np.inf), BEARINGS[:90]) is None


@given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2))
def test_the_area_under_the_curve_is_the_chance_to_rank_right(
    pairs: list[tuple[int, bool]],
) -> None:
    scores = np.array([score for score, _ in pairs], dtype=np.float64)
    same = np.array([kind for _, kind in pairs])
    if same.all() or not same.any():
        return
    won = [(a > b) + 0.5 * (a == b) for a in scores[same] for b in scores[~same]]
    assert loop_closures.roc_auc(scores, same) == pytest.approx(np.mean(won))


@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_the_fit_is_where_the_penalised_likelihood_has_no_slope(seed: int) -> None:
    random = np.random.default_rng(seed)
    features = random.normal(2.0, 3.0, (60, 4))
    same = features[:, 0] + random.normal(0.0, 3.0, 60) > 2.0
    if same.all() or not same.any():
        return
    model = loop_closures.fit(loop_closures.Examples(features, same))

    def loss(weights: FloatArray) -> float:
        scores = loop_closures.Model(model.means, model.deviations, weights).scores(features)
        signs = np.where(same, 1.0, -1.0)
        penalty = 0.5 * loop_closures.PENALTY * len(features) * np.sum(weights[:-1] ** 2)
        return float(np.logaddexp(0.0, -signs * scores).sum() + penalty)

    for direction in np.eye(model.weights.size):
        assert loss(model.weights) <= loss(model.weights + 1e-3 * direction)
        assert loss(model.weights) <= loss(model.weights - 1e-3 * direction)


def test_relations_place_scans_and_tell_pairs_of_both_kinds() -> None:
    poses = np.array([[0.0, 0.0, 0.1], [4.0, 0.0, 0.5], [12.0, 1.0, -0.4], [0.3, 0.1, 0.2]])
    links = [(1, 0), (1, 2), (0, 3)]
    planar = [between(poses[a], poses[b]) for a, b in links]
    transforms = np.tile(np.eye(4), (3, 1, 1))
    for T, (x, y, yaw) in zip(transforms, planar, strict=True):
        T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        T[:2, 3] = x, y
    stamps_ns = np.array(links) * 100 * 10**9
    placed = loop_closures._placed(Relations(stamps_ns[:, 0], stamps_ns[:, 1], transforms))
    for a in range(4):
        for b in range(4):
            found = between(placed[a * 100 * 10**9], placed[b * 100 * 10**9])
            np.testing.assert_allclose(found, between(poses[a], poses[b]), atol=1e-9)


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a data set's card, which ``test_dataset_catalogue.py`` looks at, take seconds."""
    monkeypatch.setattr("slamsim.dataset.catalogue.figures.dataset_figures", lambda *_: ())


@pytest.mark.long
@pytest.mark.usefixtures("without_figures")
def test_the_example_learns_from_a_small_data_set(
    one_worker: WorkEngine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = load_recipe(str(RECIPE)).model_copy(update={"duration_s": Constant(constant=60.0)})
    make_dataset(recipe, 3, str(tmp_path / "loops"), one_worker)
    loop_closures.main([str(tmp_path / "loops"), "--pairs", "6"])
    told = capsys.readouterr().out.splitlines()
    assert told[1].startswith("simulated, test split") and len(told) == 2 + len(scan_pairs.FEATURES)


NOTEBOOKS = sorted(RECIPE.parent.glob("*.ipynb"))


def code_cells(notebook: Path) -> list[str]:
    cells = json.loads(notebook.read_text())["cells"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.long
@pytest.mark.usefixtures("drives_here", "undrawn_figures", "made_by_one_worker")
@pytest.mark.parametrize("times", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: str(path.stem))
def test_a_notebook_runs_from_top_to_bottom(
    notebook: Path,
    times: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    cut_drives_short(monkeypatch)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr("matplotlib.pyplot.show", lambda: None)
    names: dict[str, object] = {"__name__": "__main__"}
    for _ in range(times):
        for cell in code_cells(notebook):
            exec(compile(cell, notebook.name, "exec"), names)
    told = capsys.readouterr().out
    for spread in re.findall(r"spread (\d\.\d+)", told):
        assert 0.9 < float(spread) < 1.1  # what was learnt holds in worlds that were not used
    assert ("spread" in told) == ("learn" in notebook.stem)


def test_slopes_of_the_network_are_those_of_its_loss() -> None:
    random = np.random.default_rng(3)
    features = random.normal(size=(40, 5)).astype(np.float32)
    floor = random.random(40) > 0.5
    network = floor_segmentation.Network(features, random)

    def loss() -> float:
        scores = network.scores(features).astype(float)
        return float(np.mean(np.logaddexp(0.0, scores) - floor * scores))

    for numbers, slopes in zip(
        [*network.weights, *network.offsets], network.slopes(features, floor), strict=True
    ):
        at = tuple(size // 2 for size in numbers.shape)
        before, losses = numbers[at], []
        for step in (2e-3, -2e-3):
            numbers[at] = before + step
            losses.append(loss())
        numbers[at] = before
        assert (losses[0] - losses[1]) / 4e-3 == pytest.approx(slopes[at], abs=3e-4, rel=0.05)


def test_the_network_learns_what_no_line_divides() -> None:
    random = np.random.default_rng(5)
    features = random.uniform(-1.0, 1.0, (20_000, 3)).astype(np.float32)
    floor = features[:, 0] * features[:, 1] > 0.0
    network = floor_segmentation.train(features[:10_000], floor[:10_000], random)
    assert np.mean((network.scores(features[10_000:]) > 0.0) == floor[10_000:]) > 0.97


@pytest.mark.parametrize("pitch_deg", [0.0, 20.0])
def test_heights_above_a_floor_are_those_of_the_scene(pitch_deg: float) -> None:
    """A camera 0.5 m above a floor that ends at a wall 3 m ahead."""
    K = np.array([[300.0, 0.0, 211.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
    v, u = np.mgrid[0:240, 0:424]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=2)
    sine, cosine = np.sin(np.radians(pitch_deg)), np.cos(np.radians(pitch_deg))
    down = rays @ np.array([0.0, cosine, sine])
    ahead = rays @ np.array([0.0, -sine, cosine])
    with np.errstate(divide="ignore"):
        to_floor = np.where(down > 0.0, 0.5 / down, np.inf)
        depth_m = np.minimum(to_floor, 3.0 / ahead).astype(np.float32)
    colour = np.full((240, 424, 3), 128, np.uint8)
    found = floor_segmentation.features_of(colour, depth_m, K)
    height_m, faces_up = found[..., 14], found[..., 15]
    is_floor = cv2_nearest(to_floor < 3.0 / ahead, found.shape[:2])
    inside = (slice(3, -3), slice(3, -3))
    assert np.median(np.abs(height_m[inside][is_floor[inside]])) < 0.06
    assert np.median(faces_up[inside][is_floor[inside]]) > 0.99
    assert np.median(height_m[inside][~is_floor[inside]]) > 0.2
    assert np.median(faces_up[inside][~is_floor[inside]]) < 0.1


def cv2_nearest(cells: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    rows = (np.arange(shape[0]) + 0.5) * cells.shape[0] / shape[0]
    columns = (np.arange(shape[1]) + 0.5) * cells.shape[1] / shape[1]
    return np.asarray(cells[np.ix_(rows.astype(int), columns.astype(int))])


@pytest.mark.long
@pytest.mark.usefixtures("without_figures")
def test_the_floor_is_asked_of_a_few_images(one_worker: WorkEngine, tmp_path: Path) -> None:
    """Far too few to learn anything: that the experiment runs to its end."""
    recipe = load_recipe("diverse_rgbd")
    assert recipe.config is not None and isinstance(recipe.config, dict)
    camera = recipe.config["sensors"]["additional"][0]
    for name in ("color", "depth"):
        camera["imagers"][name]["lens"] |= {"width": 106, "height": 60}
    splits = recipe.splits.model_copy(update={"train": 0.5, "val": 0.0, "test": 0.5})
    short = {"duration_s": Constant(constant=4.0), "formats": ("parquet",), "splits": splits}
    make_dataset(recipe.model_copy(update=short), 2, str(tmp_path / "rooms"), one_worker)
    reached = floor_segmentation.main([str(tmp_path / "rooms"), "--out", str(tmp_path)])
    assert 0.0 < reached < 1.0
    assert (tmp_path / "floor_test.png").read_bytes().startswith(b"\x89PNG")


def test_floor_segmentation_needs_both_splits(
    small_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = slamsim.dataset.open(small_set)
    empty = next(name for name in ("train", "test") if not len(whole.split(name)))
    with pytest.raises(SystemExit):
        floor_segmentation.main([str(small_set)])
    assert f"has no sequence in the split {empty}" in capsys.readouterr().err
