"""The examples run, and what they compute is held against slow and exact ways to do the same."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import loop_closures
import numpy as np
import pytest
import scan_pairs
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.geometry import between, compose, inverse, wrap_angle
from slamsim.core.types import FloatArray
from slamsim.dataset.make.engines.local import LocalEngine
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


@settings(max_examples=25)
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


def test_the_example_learns_from_a_small_data_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = load_recipe(str(RECIPE)).model_copy(update={"duration_s": Constant(constant=60.0)})
    make_dataset(recipe, 3, str(tmp_path / "loops"), LocalEngine(1))
    loop_closures.main([str(tmp_path / "loops"), "--pairs", "6"])
    told = capsys.readouterr().out.splitlines()
    assert told[1].startswith("simulated, test split") and len(told) == 2 + len(scan_pairs.FEATURES)


NOTEBOOKS = sorted(RECIPE.parent.glob("*.ipynb"))


def code_cells(notebook: Path) -> list[str]:
    cells = json.loads(notebook.read_text())["cells"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: str(path.stem))
def test_a_notebook_runs_from_top_to_bottom_twice(notebook: Path, tmp_path: Path) -> None:
    cells = "\n".join(code_cells(notebook))
    done = subprocess.run(
        [sys.executable, "-c", f"{cells}\n{cells}"],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for spread in re.findall(r"spread (\d\.\d+)", done.stdout):
        assert 0.9 < float(spread) < 1.1  # what was learnt holds in worlds that were not used
    assert ("spread" in done.stdout) == ("learn" in notebook.stem)
