"""What a person sees of limits and uncertainties: plots, tables, the coloured path, ellipses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from view_example import example_run

from slamsim.console.summary import summary
from slamsim.core.types import FloatArray
from slamsim.evaluate.bound import TrajectoryBound, scan_bound
from slamsim.evaluate.budget import error_budget
from slamsim.evaluate.consistency import nees
from slamsim.report.pages.run import report_html
from slamsim.report.precision import driven_m, ellipses, held, path_and_strokes, precision_plots
from slamsim.report.run_view import RunView, report_json


def information(count: int) -> FloatArray:
    """Holds y well and x badly in the frame given, x not at all in the last quarter."""
    made = np.tile(np.diag([1e4, 1e6, 1e6]), (count, 1, 1))
    made[3 * count // 4 :, 0, 0] = 0.0
    return made


def with_precision(view: RunView) -> RunView:
    assert view.truth is not None
    truth, graph = view.truth.planar(), view.result.graph
    scans = scan_bound(truth.stamps_ns, information(len(truth)))
    return replace(
        view,
        scores=replace(
            view.scores,
            consistency=nees(graph.keyframes, graph.covariances, truth),
            budget=error_budget(
                {"prediction": view.result.odometry, "graph": graph.keyframes},
                graph.keyframes.stamps_ns,
                truth,
            ),
            bound=TrajectoryBound(0.002, 0.0005, 1e-4, scans, 0.004, 0.006),
        ),
    )


@pytest.fixture(scope="module")
def run() -> RunView:
    return with_precision(example_run())


@pytest.mark.long
def test_the_report_tells_the_limit_the_budget_and_the_doubts(run: RunView) -> None:
    page, numbers = report_html(run), report_json(run)
    assert page.count("<svg") == 7 + 1 + 4
    for text in ("Precision", "ATE / bound", "any SLAM, lower bound of the ATE", "NEES, mean"):
        assert text in page
    assert numbers["bound_ate_m"] == 0.002
    assert numbers["bound_scan_mrad"] == pytest.approx(1.0)
    ate_m = numbers["ate_rmse_m"]
    assert isinstance(ate_m, float)
    assert numbers["ate_over_bound"] == pytest.approx(ate_m / 0.002)
    assert numbers["nees_expected"] == 3
    budget = numbers["error_budget"]
    assert isinstance(budget, dict)
    assert list(budget) == ["prediction", "graph", "all_scans", "map"]
    assert budget["all_scans"]["ate_rmse_m"] == ate_m
    assert {"limit", "consistency"} <= set(summary(numbers))


def test_without_truth_the_same_keys_are_there_and_unknown() -> None:
    numbers = report_json(example_run(with_truth=False))
    known = report_json(with_precision(example_run()))
    assert set(numbers) == set(known)
    assert numbers["bound_ate_m"] is None
    assert numbers["nees_mean"] is None
    assert not {"limit", "consistency"} & set(summary(numbers))


def test_what_holds_least_is_found_in_the_map_by_truth_or_by_matches(run: RunView) -> None:
    found = held(run)
    assert found is not None
    assert found.by_truth
    quarter = len(found.stamps_ns) // 4
    np.testing.assert_allclose(found.worst_m[:quarter], 0.01, rtol=1e-3)
    np.testing.assert_allclose(found.worst_m[-quarter:], 10.0, rtol=1e-3)
    assert run.scores.trajectory is not None
    turn = run.scores.trajectory.T_truth_estimate[2]
    np.testing.assert_allclose(np.abs(np.cos(found.direction_rad + turn)), 1.0, atol=1e-6)

    trajectory = run.result.trajectory
    result = replace(run.result, match_information=information(len(trajectory)))
    by_match = held(replace(run, result=result, scores=replace(run.scores, bound=None)))
    assert by_match is not None
    assert not by_match.by_truth
    along = np.abs(np.cos(by_match.direction_rad - trajectory.poses[:, 2]))
    np.testing.assert_allclose(along, 1.0, atol=1e-6)
    assert held(example_run(with_truth=False)) is None


def test_strokes_lie_across_the_path_where_the_scan_was_taken(run: RunView) -> None:
    found = held(run)
    assert found is not None
    points, strokes = path_and_strokes(run, found, np.array([1.0, 2.0, 0.5]))
    np.testing.assert_allclose(strokes.mean(axis=1), points)
    along = strokes[:, 1] - strokes[:, 0]
    angle = np.arctan2(along[:, 1], along[:, 0])
    np.testing.assert_allclose(np.cos(angle - found.direction_rad - 0.5), 1.0, atol=1e-6)


def test_errors_are_shown_between_their_bounds(run: RunView) -> None:
    made = {plot.key: plot for plot in precision_plots(run, 1000)}
    assert set(made) == {"held", "error_forward", "error_sideways", "error_heading"}
    assert made["held"].logarithmic
    plus, minus, _ = made["error_forward"].curves
    np.testing.assert_allclose(plus.values, -minus.values)
    np.testing.assert_allclose(plus.values, 20.0)  # 2 sigma of 1e-4 m^2, in mm
    assert all(plot.along_path for plot in made.values())


def test_ellipses_are_two_sigma_wide_and_turned_with_the_robot(run: RunView) -> None:
    graph = run.result.graph
    covariance = np.diag([4e-6, 1e-6, 1e-6])
    graph = replace(graph, covariances=np.tile(covariance, (len(graph.keyframes), 1, 1)))
    enlarged, outlines = ellipses(replace(run, result=replace(run.result, graph=graph)))
    assert enlarged in (10, 100)
    poses = graph.keyframes.poses[1:]
    away = (outlines - poses[:, None, :2]) / enlarged
    distance = np.linalg.norm(away, axis=2)
    np.testing.assert_allclose(distance.max(axis=1), 0.004, rtol=0.01)
    np.testing.assert_allclose(distance.min(axis=1), 0.002, rtol=0.01)
    longest = away[np.arange(len(away)), distance.argmax(axis=1)]
    forward = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    np.testing.assert_allclose(np.abs((longest * forward).sum(axis=1)), 0.004, rtol=0.01)


def test_the_way_driven_grows_with_the_key_frames(run: RunView) -> None:
    keyframes = run.result.graph.keyframes
    driven = driven_m(run, keyframes.stamps_ns)
    assert driven[0] == 0.0
    assert driven[-1] == pytest.approx(keyframes.path_length_m())
    assert np.all(np.diff(driven_m(run, run.result.trajectory.stamps_ns)) >= 0.0)
