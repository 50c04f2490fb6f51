"""Views: many scans merged into one, against all their points fitted at once."""

from __future__ import annotations

import numpy as np
from simulated import true_ranges

from slamsim.geometry import between, compose
from slamsim.slam.deskew import deskew
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
from slamsim.slam.views import MAX_PIECES, PIECE_M, ViewMaker, moved_pieces
from slamsim.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry

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
    for scan, pose in zip(scans, poses, strict=True):
        maker.add(scan, pose, 0.01)
    view = maker.take(poses[-1]).astype(np.float64)

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
    maker.add(pieces_at(pose, 1), pose, 0.01)
    first = maker.take(pose)
    assert len(maker.take(pose)) == 0
    maker.add(pieces_at(pose, 1), pose, 0.01)
    assert maker.take(pose).tobytes() == first.tobytes()
    maker.add(pieces_at(pose, 1), pose, 0.01)
    maker.clear()
    assert len(maker.take(pose)) == 0


def test_a_view_is_seen_from_where_it_is_taken() -> None:
    maker, before = ViewMaker(), np.array([1.0, 0.5, 2.0])
    step = np.array([0.1, -0.05, 0.2])
    scan = pieces_at(np.zeros(3), 2)
    maker.add(scan, before, 0.01)
    view = maker.take(compose(before, step)).astype(np.float64)
    expected = moved_pieces(scan, between(step, np.zeros(3)))
    assert np.isclose(view[:, BEAMS] @ view[:, X], expected[:, BEAMS] @ expected[:, X], rtol=1e-4)


def test_a_view_never_grows_beyond_its_table() -> None:
    rng = np.random.default_rng(0)
    maker = ViewMaker()
    for _ in range(20):
        rows = np.zeros((100, PIECE_FIELDS))
        rows[:, [X, Y]] = rng.uniform(-30.0, 30.0, (100, 2))
        rows[:, 2], rows[:, BEAMS], rows[:, SCATTER_YY] = 1.0, 5.0, 0.01
        maker.add(rows, np.zeros(3), 0.01)
    assert len(maker.take(np.zeros(3))) == MAX_PIECES
