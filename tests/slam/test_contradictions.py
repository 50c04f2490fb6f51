"""A run of key frames held against the map from before it, in rooms that are drawn here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from slamsim.config.back_end import GraphConfig, SubmapConfig
from slamsim.config.slam import SlamConfig
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend import back_end
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.backend.solution import Solution
from slamsim.slam.closures.closure import Expected
from slamsim.slam.closures.submaps import Submap
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.frontend.parts import Parts
from slamsim.slam.mapping.health import Usual, contradicts_what_was_before, follows_on
from slamsim.slam.matching.surfaces import (
    BEAMS,
    HALF_LENGTH,
    NORMAL_X,
    NORMAL_Y,
    PIECE_FIELDS,
    X,
    Y,
)

WIDE, DEEP = (6.0, 3.0), (3.0, 6.0)
"""Rooms: half of their extents, as seen from the middle."""

TIGHT = np.diag([1e-4, 1e-4, 1e-4])


@dataclass
class Look:
    origin_m: FloatArray
    beams_m: FloatArray


@dataclass
class Placed:
    T_map_base: FloatArray


class AsUsual(Usual):
    """What contradicts itself no more than so much is usual here. rough: key frames after which it
    does as nowhere else."""

    def __init__(self, share: float, rough: tuple[int, ...] = ()) -> None:
        self._share, self._rough = share, rough

    def is_usual(self, share: float) -> bool:
        return share <= self._share

    def is_carried_to(self, number: int) -> bool:
        return number in self._rough


def room(half_m: tuple[float, float], number: int, path_m: float) -> Submap:
    """What is seen of the walls from the middle of a room."""
    angle = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    far_m = (np.array(half_m) / np.maximum(np.abs(direction), 1e-9)).min(axis=1)
    ends_m = direction * far_m[:, None]
    across = np.abs(np.abs(ends_m) - half_m).argmin(axis=1)
    surfaces = np.zeros((len(ends_m), PIECE_FIELDS))
    surfaces[:, [X, Y]], surfaces[:, BEAMS], surfaces[:, HALF_LENGTH] = ends_m, 1.0, 0.01
    surfaces[:, NORMAL_X], surfaces[:, NORMAL_Y] = across == 0, across == 1
    look = cast(Keyframe, Look(np.zeros(2), ends_m.astype(np.float32)))
    return Submap(
        number, number, number, surfaces, np.zeros(2), (look,), np.zeros((1, 3)), path_m, path_m
    )


@pytest.mark.parametrize(
    ("seen", "usual", "contradicts"), [(WIDE, 0.0, False), (DEEP, 0.0, True), (DEEP, 0.99, False)]
)
def test_a_run_is_held_against_the_map_where_odometry_has_it(
    seen: tuple[float, float], usual: float, contradicts: bool
) -> None:
    size, poses = SubmapConfig(), np.zeros((6, 3))
    before = [room(WIDE, 0, 0.0), room(DEEP, 4, 40.0)]  # the second is of the run itself
    found = contradicts_what_was_before(
        lambda number: room(seen, number, 20.0 + number),
        *(before, poses, size, AsUsual(usual), range(2, 6), lambda *_: True),
    )
    assert found == contradicts


@pytest.mark.parametrize(("held", "contradicts"), [([(0, 1), (4, 0)], False), ([(1, 4)], True)])
def test_a_run_that_may_have_drifted_across_a_wall_contradicts_nothing(
    held: list[tuple[int, int]], contradicts: bool
) -> None:
    before, poses = [room(WIDE, 0, 0.0), room(WIDE, 1, 5.0)], np.zeros((6, 3))
    found = contradicts_what_was_before(
        lambda number: room(DEEP, number, 20.0 + number),
        *(before, poses, SubmapConfig(), AsUsual(0.0), range(2, 6)),
        lambda *pair: pair in held,
    )
    assert found == contradicts


def test_a_map_that_knows_nothing_of_the_place_contradicts_nothing() -> None:
    size, poses = SubmapConfig(), np.zeros((6, 3))
    poses[2:, 0] = 100.0
    query = room(DEEP, 2, 20.0)
    for before in ([], [room(WIDE, 0, 0.0)]):
        run = range(2, 6)
        assert not contradicts_what_was_before(
            lambda _: query, before, poses, size, AsUsual(0.0), run, lambda *_: True
        )


@pytest.mark.parametrize(
    ("strange", "seen", "follows"),
    [(1, 16, True), (2, 16, True), (3, 16, False), (16, 16, False), (1, 8, True), (0, 7, False)],
)
def test_metres_that_show_what_was_seen_before_follow_on(
    strange: int, seen: int, follows: bool
) -> None:
    """A few scans among people contradict it; and what shows nothing of it says nothing."""
    begin = 4
    keyframes = [Placed(np.array([0.0 if k < begin + seen else 100.0, 0, 0])) for k in range(30)]

    def around(number: int) -> Submap:
        return room(DEEP if begin <= number < begin + strange else WIDE, number, float(number))

    assert follows_on(around, cast(list[Keyframe], keyframes), begin, SubmapConfig()) is follows


@pytest.mark.parametrize("followed", [False, True])
def test_what_follows_on_is_not_taken_elsewhere_by_a_place_that_looks_alike(followed: bool) -> None:
    """Of two doubts before the closure, the one that is none stays where odometry has it; and a
    closure across that one alone is no more believed than without it."""
    steps = [GraphEdge(k, k + 1, np.array([1.0, 0, 0]), TIGHT, "match") for k in range(8)]
    solution = Solution(GraphConfig())
    solution.begin(np.zeros(3))
    for edge in steps:
        solution.extend(edge, apart=edge.target in (3, 6), linked=True)
    if followed:
        solution.parts.follow(3)
    elsewhere = np.array([500.0, 0, 0])
    assert solution.may_be(GraphEdge(0, 4, elsewhere, TIGHT, "closure")) is not followed
    assert solution.may_be(GraphEdge(0, 8, elsewhere, TIGHT, "closure"))
    solution.enter(GraphEdge(0, 8, elsewhere, TIGHT, "closure"))
    assert solution.parts.carried_to == ((6,) if followed else (3, 6))
    assert solution.parts.open_between(0, 8) == ([3] if followed else [])


def test_a_run_ends_where_the_next_begins() -> None:
    parts = Parts()
    parts.begin(4, linked=True)
    parts.begin(9)
    assert [parts.end(begin, 20) for begin in (0, 4, 9)] == [4, 9, 20]


class Joined:
    """What ``BackEnd`` asks of its solution: all key frames in one place."""

    def __init__(self, parts: Parts, count: int, sigma_m: float = 0.0) -> None:
        self.parts, self.poses, self.solved = parts, np.zeros((count, 3)), 0
        self.sigma_m = sigma_m

    def expected(self, anchor: int, index: int) -> Expected:
        """The map from before is unsure, and the last run as well."""
        unsure = anchor < 4 or index >= 12
        return Expected(np.zeros(3), unsure * self.sigma_m**2 * np.eye(3))

    def loosen(self, begin: int) -> None:
        self.parts.confirm(begin)

    def solve(self) -> None:
        self.solved += 1


@dataclass
class Plain:
    suspect: bool = False


@pytest.mark.parametrize(
    ("rooms", "near", "sigma_m", "carried_to"),
    [
        ((WIDE, WIDE, WIDE), True, 0.05, ()),
        # odometry has the last run where it has the one before
        ((WIDE, DEEP, DEEP), True, 0.05, (4,)),
        ((WIDE, WIDE, DEEP), True, 0.05, (9,)),
        ((WIDE, DEEP, DEEP), False, 0.05, ()),  # it has drifted across the map from before
        ((WIDE, DEEP, DEEP), True, 0.11, ()),  # or may have
    ],
)
def test_a_run_after_one_that_was_carried_to_is_not_held_against_the_map_from_before_both(
    rooms: tuple[tuple[float, float], ...],
    near: bool,
    sigma_m: float,
    carried_to: tuple[int, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count, runs = 14, (0,) * 4 + (1,) * 5 + (2,) * 5
    end, parts = BackEnd(SlamConfig()), Parts()
    for begin in (4, 9):
        parts.begin(begin, linked=True)
    solution = Joined(parts, count, sigma_m)
    monkeypatch.setattr(end, "_solution", solution)
    monkeypatch.setattr(end, "_around", lambda k: room(rooms[runs[k]], k, 20.0 * runs[k]))
    monkeypatch.setattr(end._cutter, "keyframes", [Plain()] * count)
    before = [room(rooms[0], 0, 0.0)]
    monkeypatch.setattr(end._search, "within_reach", lambda _: before if near else [])
    monkeypatch.setattr(back_end, "Usual", lambda *_: AsUsual(0.0))
    end._settle()
    assert parts.carried_to == carried_to
    assert parts.withdrawn == {4, 9} - set(carried_to)
    assert solution.solved == bool(carried_to)


@pytest.mark.parametrize("held", [0, 2])
def test_a_run_on_new_ground_stays_where_odometry_has_it_though_the_robot_may_have_been_carried(
    held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a slope, where scans contradict those of just before: that is told all the same. Where
    it lies in a map that is held is unknown."""
    end, parts = BackEnd(SlamConfig()), Parts()
    monkeypatch.setattr(end, "_held", held)
    for begin in (4, 9):
        parts.begin(begin, linked=True)
    monkeypatch.setattr(end, "_solution", Joined(parts, 14))
    monkeypatch.setattr(end, "_around", lambda k: room(WIDE, k, 0.0))
    monkeypatch.setattr(end._cutter, "keyframes", [Plain()] * 14)
    monkeypatch.setattr(end._search, "within_reach", lambda _: [])
    monkeypatch.setattr(back_end, "Usual", lambda *_: AsUsual(0.0, rough=(9,)))
    end._settle()
    assert parts.carried_to == ((9,) if held else ())
    assert parts.loose == (1 if held else 0)
    assert parts.withdrawn == {4}
