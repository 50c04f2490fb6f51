"""Views: many scans merged into one, against all their points fitted at once."""

from __future__ import annotations

import numpy as np
from simulated import true_ranges

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry
from slamsim.slam.backend.views import MAX_PIECES, PIECE_M, ViewMaker, moved_pieces
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.matching.surfaces import (
    BEAMS,
    PIECE_FIELDS,
    SCATTER_XX,
    SCATTER_YY,
    VARIANCE,
    X,
    Y,
    surface_pieces,
)

FLASH = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.5), 541, 0, 0.1, 20.0)
ROOM = np.array(
    [
        [-3.0, -2.0, 3.0, -2.0],
        [3.0, -2.0, 3.0, 2.0],
        [3.0, 2.0, -3.0, 2.0],
        [-3.0, 2.0, -3.0, -2.0],
    ]
)


def pieces_at(pose: FloatArray, seed: int, noise_m: float = 0.01) -> FloatArray:
    here = PlanarTrajectory(np.array([0, 1]), np.stack([pose, pose]))
    ranges = true_ranges(ROOM, here, 0, FLASH)
    ranges = ranges + np.random.default_rng(seed).normal(0.0, noise_m, ranges.size)
    cloud = deskew(Scan(0, ranges.astype(np.float32), FLASH), here, 0, np.eye(4))
    return surface_pieces(cloud, noise_m, PIECE_M, 20.0)


def test_a_view_holds_all_beams_and_their_moments() -> None:
    poses = [np.array([0.02 * k, 0.01 * k, 0.01 * k]) for k in range(12)]
    scans = [pieces_at(pose, k) for k, pose in enumerate(poses)]
    maker = ViewMaker()
    for k, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        maker.add(scan, pose, between(poses[max(k - 1, 0)], pose), 0.01)
    taken, T_map_view = maker.take()
    view = taken.astype(np.float64)
    np.testing.assert_allclose(T_map_view, poses[-1], atol=1e-12)

    apart = np.concatenate(
        [moved_pieces(s, between(poses[-1], p)) for s, p in zip(scans, poses, strict=True)]
    )
    assert len(view) < 0.25 * len(apart)
    assert np.isclose(view[:, BEAMS].sum(), apart[:, BEAMS].sum())
    for field in (X, Y):
        merged, whole = (float(rows[:, BEAMS] @ rows[:, field]) for rows in (view, apart))
        assert np.isclose(merged, whole, rtol=1e-5, atol=1e-2)
    merged, whole = (
        float(
            (rows[:, SCATTER_XX] + rows[:, SCATTER_YY]).sum()
            + (rows[:, BEAMS] * (rows[:, X] ** 2 + rows[:, Y] ** 2)).sum()
        )
        for rows in (view, apart)
    )
    assert np.isclose(merged, whole, rtol=1e-5)
    assert np.median(view[:, VARIANCE]) < np.median(apart[:, VARIANCE])


def test_taking_a_view_begins_the_next() -> None:
    maker = ViewMaker()
    pose = np.array([0.5, 0.2, 0.3])
    maker.add(pieces_at(pose, 1), pose, None, 0.01)
    first, T_map_view = maker.take()
    np.testing.assert_allclose(T_map_view, pose, atol=1e-12)
    assert len(maker.take()[0]) == 0
    maker.add(pieces_at(pose, 1), pose, np.ones(3), 0.01)
    assert maker.take()[0].tobytes() == first.tobytes()
    maker.add(pieces_at(pose, 1), pose, None, 0.01)
    maker.clear()
    assert len(maker.take()[0]) == 0


def test_a_view_stands_at_the_mean_of_its_matches_carried_on_by_the_odometry() -> None:
    rng = np.random.default_rng(3)
    steps = [np.array([0.05, 0.01 * k, 0.02]) for k in range(10)]
    truth = [np.array([1.0, 0.5, 2.0])]
    for step in steps:
        truth.append(compose(truth[-1], step))
    matched = [compose(pose, rng.normal(0.0, 1e-4, 3)) for pose in truth]
    maker = ViewMaker()
    for odometry, pose in zip([None, *steps], matched, strict=True):
        maker.add(pieces_at(np.zeros(3), 2), pose, odometry, 0.01)
    view, T_map_view = maker.take()
    carried = [compose(m, between(t, truth[-1])) for m, t in zip(matched, truth, strict=True)]
    np.testing.assert_allclose(T_map_view, np.mean(carried, axis=0), atol=1e-6)

    seen = [moved_pieces(pieces_at(np.zeros(3), 2), between(T_map_view, pose)) for pose in matched]
    expected = np.concatenate(seen)
    pooled = view.astype(np.float64)
    assert np.isclose(pooled[:, BEAMS] @ pooled[:, X], expected[:, BEAMS] @ expected[:, X], 1e-3)


def test_where_odometry_is_silent_a_view_stands_where_the_last_match_puts_it() -> None:
    maker = ViewMaker()
    for pose in (np.zeros(3), np.array([0.3, 0.1, 0.2])):
        maker.add(pieces_at(pose, 4), pose, None, 0.01)
    np.testing.assert_allclose(maker.take()[1], [0.3, 0.1, 0.2], atol=1e-12)


def test_a_view_never_grows_beyond_its_table() -> None:
    rng = np.random.default_rng(0)
    maker = ViewMaker()
    for _ in range(20):
        rows = np.zeros((100, PIECE_FIELDS))
        rows[:, [X, Y]] = rng.uniform(-30.0, 30.0, (100, 2))
        rows[:, 2], rows[:, BEAMS], rows[:, SCATTER_YY] = 1.0, 5.0, 0.01
        maker.add(rows, np.zeros(3), None, 0.01)
    assert len(maker.take()[0]) == MAX_PIECES
