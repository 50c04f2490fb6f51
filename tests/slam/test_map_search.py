"""A key frame sought in all of a map: found where only one place is like it, else nowhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from closure_scene import keyframes, straight
from simulated import box

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.estimate import Estimate
from slamsim.slam.closures.candidates import CandidateIndex
from slamsim.slam.closures.closure import Closure, ClosureFinder
from slamsim.slam.closures.rejoin import MapSearch
from slamsim.slam.closures.relocalise import QUICK
from slamsim.slam.closures.submaps import Submap, Surfaces, make_submap

LENGTH_M, SPACING_M, SUBMAP = 80.0, 0.5, 7
"""Of a corridor, between key frames, and key frames in a submap; each submap overlaps the next."""

QUERY_FROM_M, QUERY_M = 51.0, 24.0
DRIFT = np.array([17.0, -4.0, 0.15])


def corridor(doors_m: FloatArray) -> FloatArray:
    """A corridor along x, 2.4 m wide, with doors set back by 0.2 m: (n, 2) where one begins and
    on which side (+1, -1)."""
    walls = [box(-5.0, -1.2, LENGTH_M + 5.0, 1.2)[[1, 3]]]
    for side in (-1.0, 1.0):
        begins_m = np.sort(doors_m[doors_m[:, 1] == side, 0])
        x_m = np.concatenate([[-5.0], np.repeat(begins_m, 4), [LENGTH_M + 5.0]])
        x_m[1:-1] += np.tile([0.0, 0.0, 0.9, 0.9], len(begins_m))
        y_m = side * (
            1.2 + np.concatenate([[0.0], np.tile([0.0, 0.2, 0.2, 0.0], len(begins_m)), [0.0]])
        )
        walls.append(np.column_stack([x_m[:-1], y_m[:-1], x_m[1:], y_m[1:]]))
    return np.concatenate(walls)


def irregular(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    rows = []
    for side in (-1.0, 1.0):
        begins_m = np.cumsum(rng.uniform(2.0, 5.0, 40))
        rows += [(x_m, side) for x_m in begins_m if x_m < LENGTH_M]
    return np.array(rows)


def regular() -> FloatArray:
    return np.array([(x_m, side) for x_m in np.arange(0.0, LENGTH_M, 3.0) for side in (-1.0, 1.0)])


def revisited(walls: FloatArray) -> tuple[Submap, dict[int, Submap], FloatArray]:
    """A query, driven the other way along a part of the corridor, the submaps of all of it, and
    poses (n, 3), true but for those of the query, which drifted."""
    there = straight(np.zeros(3), LENGTH_M, round(LENGTH_M / SPACING_M) + 1)
    start = np.array([QUERY_FROM_M, 0.2, np.pi])
    back = straight(start, QUERY_M, round(QUERY_M / SPACING_M) + 1)
    frames, scratch = keyframes(walls, there), Surfaces()
    begins = range(0, len(frames) - SUBMAP + 1, SUBMAP // 2)
    cut = [make_submap(frames[k : k + SUBMAP], SUBMAP // 2, scratch, 0.01) for k in begins]
    first, path_m = len(frames), frames[-1].path_m + SPACING_M
    seen = [
        replace(one, index=one.index + first, path_m=one.path_m + path_m)
        for one in keyframes(walls, back, first)
    ]
    query = make_submap(seen, len(seen) - 1, scratch, 0.01)
    return query, dict(enumerate(cut)), np.concatenate([there, compose(DRIFT, back)])


@cache
def along(seed: int) -> tuple[Submap, dict[int, Submap], FloatArray]:
    """``revisited``, of a corridor whose doors are unlike those of another seed."""
    return revisited(corridor(irregular(seed)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_stretch_of_a_corridor_is_found_again_by_its_doors(seed: int) -> None:
    query, submaps, poses = along(seed)
    found = MapSearch(BackEndConfig(), QUICK).look(query, submaps, poses, 0.4)
    assert found
    back = np.array([QUERY_FROM_M - QUERY_M, 0.2, np.pi])
    for number, T_submap_query in found:
        off = between(compose(poses[submaps[number].anchor], T_submap_query), back)
        assert np.hypot(off[0], off[1]) < 0.1 and abs(off[2]) < 0.02


def test_what_looks_alike_everywhere_is_found_nowhere() -> None:
    query, submaps, poses = revisited(corridor(regular()))
    search = MapSearch(BackEndConfig(), QUICK)
    assert search.look(query, submaps, poses, 0.4) == []
    assert not search.due(query.to_path_m) and search.due(query.to_path_m + 2.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_not_in_the_map_is_found_nowhere(seed: int) -> None:
    query, _, poses = along(seed)
    _, submaps, _ = along(seed % 3 + 1)
    assert MapSearch(BackEndConfig(), QUICK).look(query, submaps, poses, 0.4) == []


def test_a_heading_that_cannot_be_is_not_searched() -> None:
    query, submaps, poses = along(1)
    turned = poses.copy()
    turned[query.anchor, 2] += 1.5
    assert MapSearch(BackEndConfig(), QUICK).look(query, submaps, turned, 0.4) == []
    assert MapSearch(BackEndConfig(), QUICK).look(query, submaps, turned, np.pi)


def test_what_was_found_counts_unless_walls_stand_where_there_is_free_space_or_nothing() -> None:
    query, submaps, poses = along(1)
    number, T_submap_query = MapSearch(BackEndConfig(), QUICK).look(query, submaps, poses, 0.4)[0]
    finder, anchor = ClosureFinder(BackEndConfig()), submaps[number].anchor
    frames = {one.index: one for submap in submaps.values() for one in submap.members}
    near = [one for k, one in sorted(frames.items()) if abs(k - anchor) * SPACING_M <= QUERY_M]
    at = [one.index for one in near].index(anchor)
    around = make_submap(near, at, Surfaces(), 0.01)
    closure = finder.placed(query, number, around, T_submap_query)
    assert isinstance(closure, Closure) and not closure.expected
    aside = compose(T_submap_query, np.array([0.0, 0.0, 0.15]))
    assert finder.placed(query, number, around, aside) in ("overlap", "contradiction")


def test_submaps_are_sought_near_the_estimate_or_anywhere_never_both() -> None:
    query, submaps, poses = along(1)
    config, estimate = BackEndConfig().closures, Estimate()
    index = CandidateIndex(config)
    for submap in submaps.values():
        index.add(submap)
    estimate.begin(poses[0])
    sure = np.diag([1e-4, 1e-4, 2e-5])
    for k in range(1, len(poses)):
        covariance = sure if k < query.first else 400.0 * sure
        T = between(poses[k - 1], poses[k])
        estimate.extend(GraphEdge(k - 1, k, T, covariance, "match"))
    near = index.of(query, estimate, -np.inf)
    anywhere = index.anywhere(query, estimate, -np.inf)
    assert anywhere and not set(near) & set(anywhere)
