"""The basin of convergence: what counts as coming home, and from where it was tried."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated import box, simulate

from slamsim.bench import matcher as bench_matcher
from slamsim.bench.matcher import (
    DISTANCES_M,
    HOME_M,
    TURNS_DEG,
    Basin,
    basin_rows,
    measure_matcher,
    random_offsets,
)
from slamsim.config.slam import SlamConfig
from slamsim.core.types import Trajectory

CLASSES = (len(DISTANCES_M) - 1) * (len(TURNS_DEG) - 1)


def test_offsets_reach_every_class_and_none_beyond() -> None:
    offsets = random_offsets(np.random.default_rng(1), 4000)
    away_m, turned = np.hypot(offsets[:, 0], offsets[:, 1]), np.rad2deg(np.abs(offsets[:, 2]))
    assert away_m.max() <= DISTANCES_M[-1] and turned.max() <= TURNS_DEG[-1]
    counted = np.histogram2d(away_m, turned, [DISTANCES_M, TURNS_DEG])[0]
    assert counted.min() > 0.4 * 4000 / CLASSES
    assert (offsets > 0.0).any(axis=0).all() and (offsets < 0.0).any(axis=0).all()


def test_a_match_comes_home_within_centimetres_and_a_degree() -> None:
    basin = Basin()
    off = np.array([0.3, 0.0, np.deg2rad(-12.0)])
    basin.add(off, np.array([HOME_M - 0.001, 0.0, 0.0]))
    basin.add(off, np.array([HOME_M + 0.001, 0.0, 0.0]))
    basin.add(off, np.array([0.0, 0.0, np.deg2rad(1.1)]))
    basin.add(off, None)
    (told,) = [one for one in basin.shares() if one["tried"]]
    assert (told["to_m"], told["to_deg"]) == (0.5, 20.0)
    assert told["tried"] == 4 and told["share"] == 0.25


def test_the_table_has_a_row_per_distance_and_a_cell_per_turn() -> None:
    basin, other = Basin(), Basin()
    basin.add(np.zeros(3), None)
    other.add(np.zeros(3), np.zeros(3))
    rows = basin_rows(basin.shares(), other.shares())
    assert len(rows) == len(DISTANCES_M)
    assert rows["up to 0.1 m"].split() == ["0/100", *["-/-"] * (len(TURNS_DEG) - 2)]


@pytest.mark.long
def test_a_matcher_finds_home_from_nearby_and_its_errors_are_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walls = np.concatenate([box(-4.0, -3.0, 4.0, 3.0), box(1.0, 0.5, 1.6, 1.4)])
    made = simulate(walls, np.array([[-3.0, -2.0], [2.5, -2.0], [2.5, 0.0]]), max_s=25.0)
    flat = np.zeros((len(made.truth), 1))
    half = 0.5 * made.truth.poses[:, 2:]
    truth = Trajectory(
        made.truth.stamps_ns,
        np.hstack([made.truth.poses[:, :2], flat]),
        np.hstack([flat, flat, np.sin(half), np.cos(half)]),
    )
    monkeypatch.setattr(bench_matcher, "read_log", lambda path: made.log)
    monkeypatch.setattr(bench_matcher, "read_truth", lambda path: truth)
    monkeypatch.setattr(bench_matcher, "SCANS", 6)
    monkeypatch.setattr(bench_matcher, "OFFSETS_PER_SCAN", 40)
    figures = measure_matcher(Path("nowhere"), SlamConfig())
    shares = [one["share"] for one in figures.searched if (one["to_m"] or 9.0) <= 0.5]
    near = [share for share in shares if share is not None]
    assert figures.reference == "truth" and np.mean(near) > 0.5
    assert sum(int(one["tried"] or 0) for one in figures.plain) >= 40
    rmse_m = figures.single["rmse_m"]
    assert isinstance(rmse_m, float) and rmse_m < 0.02
    assert "bound_m" not in figures.single  # no world lies beside this log
