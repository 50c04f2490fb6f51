"""A map looked at without the truth: does it contradict itself?"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from slamsim.config.back_end import SubmapConfig
from slamsim.core.components import runs_of
from slamsim.core.geometry import between, transform_points
from slamsim.core.result import Event, MapGraph
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.closures.submaps import FREE, UNKNOWN, SpaceGrid, Submap, space_grid
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.mapping.joints import closures_agree

MIN_KNOWN_SHARE = 0.1
MIN_KNOWN = 20
"""Points of one piece of map that the other must know of before the two can be compared."""

CARRIED_SHARE = 0.25
"""Key frames one after the other that contradict each other more than this do not belong together.
Measured: at most 0.15 on real logs, 0.20 among three people; at least 0.26 where a robot was
carried from one corridor of a labyrinth to one that looks alike."""

TORN_SHARE = 0.36
"""Contradiction of what was seen at different times, as an average over a few metres. At the worst
place: 0.21 and 0.28 on two real logs that are whole, 0.33 among three people in a small labyrinth;
0.67 and more with the last 30, 50 or 70 % of either log moved by 0.36 m, at most 0.35 moved by
0.2 m, which is within ``WALL_MARGIN_M``. On fr-clinic, where it is 0.37 to 0.86 at twelve places,
relations verified by hand have the map off by 0.2 to 2 m at each place that they cover."""

AFTERWARDS = 16
TORN_HERE = (
    "scans fitted badly all of a sudden, and what was seen from there on contradicts what was seen "
    "before: the robot may have been carried, and the map be torn there"
)

USUAL_SAMPLES = 100
"""Places, for each suspicion, at which the usual contradiction is measured: that one of the
suspicions contradicts itself more than all of them has, in a recording that looks the same
everywhere, a chance of one in a hundred. With 100 for all 35 suspicions of fr-clinic (outdoors,
trees, people) four passed for a robot that was carried, and its map fell in pieces."""

HARMLESS = 0.15
"""Where one of two shares is smaller, the other is not computed: usual contradictions of whole maps
are larger."""
EVERY_KEYFRAMES = 2
MAX_PAIRS = 3
NEAR_M = 4.0
APART_M = 4.0
"""Pieces of the map are held against each other if they are this near in space and this far apart
in path: about the reach over which both saw the same walls."""
SMOOTHED = 3


def carried(before: Submap, now: Submap, T_before_now: FloatArray, size: SubmapConfig) -> bool:
    """Whether what is seen now cannot have been seen from beside where the robot just was.

    T_before_now: (3,).
    """
    space = space_grid(before, size.resolution_m, size.radius_m)
    return contradiction(before, space, now, T_before_now, size) > CARRIED_SHARE


def follows_on(
    query_of: Callable[[int], Submap],
    keyframes: Sequence[Keyframe],
    number: int,
    size: SubmapConfig,
) -> bool:
    """Whether what was seen on the metres after a key frame is what was seen before it: a single
    scan among people, or of few beams, contradicted that, and the robot was not carried."""
    poses = [keyframe.T_map_base for keyframe in keyframes]
    shares = np.array(list(_afterwards(query_of, poses, number, size)))
    known = shares[np.isfinite(shares)]
    return known.size >= AFTERWARDS // 2 and float(known.mean()) <= HARMLESS


class Usual:
    """How much what is seen on some metres contradicts what was seen before, where nothing is
    suspected: among trees, on ramps, in a crowd it is more than between walls.

    query_of: what was seen about a key frame, given its number.
    """

    def __init__(
        self,
        query_of: Callable[[int], Submap],
        keyframes: Sequence[Keyframe],
        doubts: Sequence[int],
        size: SubmapConfig,
    ) -> None:
        self._query_of, self._keyframes = query_of, keyframes
        self._doubts, self._size = doubts, size
        self._left, self._looked_at = self._plain(), list[tuple[float, float]]()

    def _samples(self) -> Iterator[tuple[float, float]]:
        """(mean, largest) contradiction of the metres after each plain place; looked at once, when
        asked for."""
        yield from self._looked_at
        for number in self._left:
            if shares := self._shares(number):
                self._looked_at.append((float(np.mean(shares)), max(shares)))
                yield self._looked_at[-1]

    def _plain(self) -> Iterator[int]:
        """Key frames away from all doubts: some all over the recording, then more in between."""
        rounds = max(len(self._doubts), 1)
        steps = np.linspace(1, len(self._keyframes) - 1, USUAL_SAMPLES * rounds).astype(int)
        numbers = np.unique(steps)
        for number in itertools.chain(*(numbers[k::rounds].tolist() for k in range(rounds))):
            if not any(number <= doubt <= number + AFTERWARDS for doubt in self._doubts):
                yield number

    def is_usual(self, share: float) -> bool:
        """Whether what is seen within some metres contradicts itself as much somewhere."""
        some = itertools.islice(self._samples(), USUAL_SAMPLES)
        return any(share <= largest for _, largest in some)

    def is_carried_to(self, number: int) -> bool:
        """Whether what was seen on the metres after a key frame contradicts what was seen before
        it as it does nowhere else."""
        return self.is_carried_by(self._shares(number))

    def is_carried_by(self, shares: Sequence[float]) -> bool:
        """The same, of the contradictions of these metres."""
        share = float(np.mean(shares)) if shares else 0.0
        return share > CARRIED_SHARE and all(share > mean for mean, _ in self._samples())

    def _shares(self, number: int) -> list[float]:
        poses = [keyframe.T_map_base for keyframe in self._keyframes]
        return _known(_afterwards(self._query_of, poses, number, self._size))


def _afterwards(
    query_of: Callable[[int], Submap],
    poses: Sequence[FloatArray] | FloatArray,
    number: int,
    size: SubmapConfig,
) -> Iterator[float]:
    """How much what was seen on the metres after a key frame contradicts what was seen before it,
    with the key frames at these poses; nan where too little of both is known."""
    before = query_of(number - 1)
    space = space_grid(before, size.resolution_m, size.radius_m)
    for later in range(number, min(number + AFTERWARDS, len(poses))):
        now = query_of(later)
        if now.first >= number:
            T = between(poses[before.anchor], poses[later])
            yield contradiction(before, space, now, T, size)


def _known(shares: Iterable[float]) -> list[float]:
    """Contradictions: where too little is known of both there is none."""
    return [0.0 if np.isnan(share) else share for share in shares]


def _torn_unnoticed(
    query_of: Callable[[int], Submap],
    doubts: Sequence[int],
    graph: MapGraph,
    size: SubmapConfig,
    usual: Usual,
) -> Iterator[Event]:
    """Key frames that followed on scans that fitted badly, where what was seen on the next metres
    contradicts what was seen before, and no loop tells that the robot came there as it seems."""
    keyframes = graph.keyframes
    for number in doubts:
        shares = _known(_afterwards(query_of, keyframes.poses, number, size))
        if usual.is_carried_by(shares) and not closures_agree(graph, number):
            x, y = keyframes.poses[number, :2]
            start_ns, end_ns = keyframes.stamps_ns[[number - 1, number]].tolist()
            yield Event(start_ns, end_ns, "torn", f"near ({x:.1f}, {y:.1f}) m {TORN_HERE}")


def contradiction(
    a: Submap, space_a: SpaceGrid, b: Submap, T_a_b: FloatArray, size: SubmapConfig
) -> float:
    """Share of what each of two pieces of map has seen that stands where the other saw free space:
    the smaller of both shares, or less than HARMLESS; nan where they know too little of each other.

    T_a_b: (3,).
    """
    there = _share_in_the_open(space_a, b, T_a_b)
    if not there >= HARMLESS:
        return there
    space_b = space_grid(b, size.resolution_m, size.radius_m)
    back = _share_in_the_open(space_b, a, between(T_a_b, np.zeros(3)))
    return float(np.minimum(there, back))


def _share_in_the_open(space: SpaceGrid, other: Submap, T_space_other: FloatArray) -> float:
    seen = space.at(transform_points(T_space_other, other.points_m))
    known = np.count_nonzero(seen != UNKNOWN)
    if known < max(MIN_KNOWN, MIN_KNOWN_SHARE * len(seen)):
        return np.nan
    return float(np.count_nonzero(seen == FREE) / known)


def tears(
    query_of: Callable[[int], Submap],
    submaps: Sequence[Submap],
    graph: MapGraph,
    size: SubmapConfig,
    doubts: Sequence[int],
    usual: Usual,
    first: int = 0,
) -> Iterator[Event]:
    """Stretches of the path from which was seen what contradicts the map of other times.

    query_of: what was seen about a key frame. graph: the final one. doubts: the
    numbers of those to which scans led that fitted badly. usual: how much contradiction is
    no sign of anything here. first: number of the first key frame from which to look.
    """
    keyframes = graph.keyframes
    yield from _torn_unnoticed(query_of, doubts, graph, size, usual)
    seen_from = range(first, len(keyframes), EVERY_KEYFRAMES)
    numbers, smooth = _contradictions(query_of, submaps, keyframes.poses, size, seen_from)
    strange = np.array([_is_strange(share, usual) for share in smooth.tolist()], dtype=np.bool_)
    for first_torn, last_torn in runs_of(strange):
        at = first_torn + int(np.argmax(smooth[first_torn : last_torn + 1]))
        x, y = keyframes.poses[numbers[at], :2]
        words = (
            f"the map is torn near ({x:.1f}, {y:.1f}) m: {smooth[at]:.0%} of what was seen from "
            "there stands where there was free space at another time"
        )
        start_ns, end_ns = keyframes.stamps_ns[numbers[[first_torn, last_torn]]].tolist()
        yield Event(start_ns, end_ns, "torn", words)


def contradicts_what_was_before(
    query_of: Callable[[int], Submap],
    submaps: Sequence[Submap],
    poses: FloatArray,
    size: SubmapConfig,
    usual: Usual,
    run: range,
    sure: Callable[[int, int], bool],
) -> bool:
    """Whether what was seen from a run of key frames contradicts the map from before it, as one
    that is torn does: odometry alone has the run where it is, and no closure found it there.

    query_of, submaps, size, usual: as for ``tears``. poses: (n, 3) T_map_base of all key frames.
    sure: whether two of them are where the poses have them, as seen from each other, if the robot
    was not carried.
    """
    before = [submap for submap in submaps if submap.last < run.start]
    _, smooth = _contradictions(query_of, before, poses, size, run, sure)
    return any(_is_strange(share, usual) for share in smooth.tolist())


def _is_strange(share: float, usual: Usual) -> bool:
    return share > TORN_SHARE and not usual.is_usual(share)


def _contradictions(
    query_of: Callable[[int], Submap],
    submaps: Sequence[Submap],
    poses: FloatArray,
    size: SubmapConfig,
    seen_from: Sequence[int],
    sure: Callable[[int, int], bool] = lambda *_: True,
) -> tuple[IntArray, FloatArray]:
    """(k,) numbers of key frames about which the map of other times knows something, and (k,) how
    much it contradicts what was seen from there, averaged over neighbours."""
    worst: dict[int, list[float]] = {}
    for submap, queries in _pairs(query_of, submaps, poses, seen_from, sure):
        space = space_grid(submap, size.resolution_m, size.radius_m)
        for query in queries:
            T = between(poses[submap.anchor], poses[query.anchor])
            share = contradiction(submap, space, query, T, size)
            worst.setdefault(query.anchor, []).extend(_known([share]))
    numbers = np.array(sorted(worst), dtype=np.int64)
    mean = np.array([np.mean(worst[number]) for number in numbers.tolist()], dtype=np.float64)
    return numbers, uniform_filter1d(mean, SMOOTHED, mode="nearest") if len(mean) else mean


def _pairs(
    query_of: Callable[[int], Submap],
    submaps: Sequence[Submap],
    poses: FloatArray,
    seen_from: Sequence[int],
    sure: Callable[[int, int], bool],
) -> list[tuple[Submap, list[Submap]]]:
    """Submaps, and what was seen near by, about some key frames, at other times."""
    if not submaps:
        return []
    middles_m = np.array([transform_points(poses[one.anchor], one.middle_m) for one in submaps])
    from_m = np.array([one.from_path_m for one in submaps])
    to_m = np.array([one.to_path_m for one in submaps])
    queries: list[list[Submap]] = [[] for _ in submaps]
    for number in seen_from:
        query = query_of(number)
        here_m = transform_points(poses[number], query.middle_m)
        distance_m = np.hypot(*(middles_m - here_m).T)
        other_time = (to_m < query.from_path_m - APART_M) | (from_m > query.to_path_m + APART_M)
        near = np.flatnonzero(other_time & (distance_m < NEAR_M))
        nearest = near[np.argsort(distance_m[near], kind="stable")].tolist()
        placed = (k for k in nearest if sure(submaps[k].anchor, number))
        for k in itertools.islice(placed, MAX_PAIRS):
            queries[k].append(query)
    return [(one, there) for one, there in zip(submaps, queries, strict=True) if there]
