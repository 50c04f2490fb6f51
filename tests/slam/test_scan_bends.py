"""Surfaces that bend: against dense algebra, and a round room seen by beams far apart."""

from __future__ import annotations

import numpy as np
import pytest
from scan_recording import scan_motions

from slamsim.core.types import FloatArray
from slamsim.models.line_bundle import fit_lines
from slamsim.recording import RawScans, ScanLayout
from slamsim.slam.laser.scan_bends import (
    BEND,
    INFORMATION,
    LARGEST_BEND_PER_M,
    bent_residuals,
    fit_bends,
    straightened,
)

STARTS = np.array([0, 5, 12])


def seen(seed: int, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Two points each of 12 observations of two arcs of that radius, and their weights."""
    rng = np.random.default_rng(seed)
    angle = np.repeat([0.3, 2.1], [5, 7]) + rng.uniform(-0.2, 0.2, 12) / radius_m
    ends = angle[:, None] + rng.uniform(0.02, 0.05, 12)[:, None] / radius_m * np.array([-1, 1])
    points = radius_m * np.stack([np.cos(ends), np.sin(ends)], axis=2)
    return points, rng.uniform(1e3, 1e5, 12)


@pytest.mark.parametrize("radius_m", [1.0, 4.0])
def test_an_arc_is_a_parabola_of_half_its_curvature(radius_m: float) -> None:
    points, weights = seen(1, radius_m)
    lines = fit_lines(points, weights, STARTS)
    bends = fit_bends(points, weights, STARTS, lines)
    assert np.abs(bends[:, BEND]) == pytest.approx(0.5 / radius_m, rel=0.1)
    flat, normals, _ = straightened(points, STARTS, lines, bends)
    middle, normal = np.repeat(lines, np.diff(STARTS), axis=0).reshape(12, 2, 2).swapaxes(0, 1)
    off, before = (((p - middle[:, None]) * normal[:, None]).sum(axis=2) for p in (flat, points))
    assert np.abs(off).max() < 0.1 * np.abs(before).max()
    outward = points / np.linalg.norm(points, axis=2, keepdims=True)
    across = normals[..., 0] * outward[..., 1] - normals[..., 1] * outward[..., 0]
    assert np.abs(across).max() < 0.02, "normals are those of the arc"


@pytest.mark.parametrize("seed", range(3))
def test_bends_are_those_of_dense_least_squares(seed: int) -> None:
    """Line and bend together, with the prior of the bend."""
    points, weights = seen(seed, 1.0)
    points = points + 0.01 * np.random.default_rng(seed).normal(size=points.shape)
    lines = fit_lines(points, weights, STARTS)
    bends = fit_bends(points, weights, STARTS, lines)
    for surface, (x, y, nx, ny) in enumerate(lines):
        some = slice(*STARTS[surface : surface + 2])
        off = (points[some] - [x, y]).reshape(-1, 2)
        t, across = off @ [-ny, nx], off @ [nx, ny]
        columns = np.column_stack([np.ones_like(t), t, t**2])
        weight = np.repeat(weights[some], 2)
        before = np.diag([0.0, 0.0, LARGEST_BEND_PER_M**-2])
        information = columns.T @ (weight[:, None] * columns) + before
        found = np.linalg.solve(information, columns.T @ (weight * across))
        assert bends[surface, BEND] == pytest.approx(found[2], rel=1e-9)
        left = 1.0 / np.linalg.inv(information)[2, 2]
        assert bends[surface, INFORMATION] == pytest.approx(left, rel=1e-9)
    off, told = bent_residuals(points, weights, STARTS)
    assert off.shape == (12, 2) and 5.9 < told < 6.0


RADIUS_M, BEAMS, STEP_RAD, NOISE_M = 4.0, 181, np.deg2rad(1.0), 0.008
PANELS = [
    (np.array([3.0, 1.9]), 0.6),
    (np.array([-2.6, 2.2]), 2.4),
    (np.array([0.4, -3.4]), 1.3),
    (np.array([-3.2, -1.4]), 0.2),
    (np.array([0.2, 3.1]), 2.9),
    (np.array([2.5, -2.3]), 1.9),
]
"""The middle of each flat panel in the round room and the direction that it runs in, rad."""


def cast(place: FloatArray, along: FloatArray) -> FloatArray:
    """Ranges (k,) from a place (2,) along unit vectors (k, 2) to the round wall or a panel."""
    ahead = along @ place
    ranges = -ahead + np.sqrt(np.square(ahead) + RADIUS_M**2 - place @ place)
    for middle, direction in PANELS:
        tangent = np.array([np.cos(direction), np.sin(direction)])
        normal = np.array([-tangent[1], tangent[0]])
        with np.errstate(divide="ignore"):
            to_panel = ((middle - place) @ normal) / (along @ normal)
        meets = (place + to_panel[:, None] * along - middle) @ tangent
        hit = (to_panel > 0.0) & (np.abs(meets) < 0.5)
        ranges = np.where(hit, np.minimum(ranges, to_panel), ranges)
    return ranges


def round_room(seed: int) -> RawScans:
    """A robot that goes to and fro and turns there; all beams of a scan fire at once."""
    rng = np.random.default_rng(seed)
    seconds = 0.05 * np.arange(1200)
    x, y = 1.2 * np.sin(0.31 * seconds), 0.9 * np.sin(0.23 * seconds + 1.0)
    heading = 1.9 * np.sin(0.4 * seconds) + 0.7 * np.sin(1.1 * seconds)
    bearings = STEP_RAD * (np.arange(BEAMS) - 90)
    ranges = np.array(
        [
            cast(np.array([a, b]), np.column_stack([np.cos(h + bearings), np.sin(h + bearings)]))
            for a, b, h in zip(x, y, heading, strict=True)
        ]
    )
    ranges = np.round(ranges + NOISE_M * rng.standard_normal(ranges.shape), 2)
    layout = ScanLayout(bearings[0], bearings[-1], STEP_RAD, 0.0, 0.05, 0.05, 8.0)
    return RawScans(
        topic="/scan",
        frame_ids=("laser",),
        stamps_ns=np.round(1e9 * seconds).astype(np.int64),
        received_ns=None,
        layouts=(layout,),
        layout_of=np.zeros(len(seconds), dtype=np.int32),
        ranges_m=ranges.astype(np.float32),
    )


@pytest.mark.slow
def test_a_round_room_seen_by_few_beams_is_not_taken_for_straight_walls() -> None:
    """Straight lines put the angle between beams 0.33 % off here, and ranges 240 mm."""
    motions = scan_motions(round_room(2))
    angle, offset = motions.angle_step, motions.range_offset_m
    assert not motions.contradicted[1]
    assert angle.sigma < 1e-3 and abs(angle.value - 1.0) < 1.5e-3
    assert abs(offset.value) < 0.04, "a circle looks the same with longer ranges, but larger"
