"""How sure the returned key frames are: what holds the map, and what is left of single scans.

Two errors add up. The map itself is off by the noise of all views of its surfaces and of the
odometry between them: the inverse of their joint information, as in any bundle adjustment
(Triggs et al. 2000). And each pose is off in this map by what the smoothing of all scans left of
the noise of its own. Before that smoothing, odometry could not be believed between two key frames
better than the matches that placed them: covariances of the bundle adjustment alone are those of
other, shakier poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from slamsim.core.geometry import adjoint, between, compose, inverse, rotation
from slamsim.core.result import EdgeKind, GraphEdge, MapGraph
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.supernodes import Panels, add_blocks, blocks_at, empty_system
from slamsim.process.children import return_freed_memory
from slamsim.slam.backend.gauge import WholeMap
from slamsim.slam.backend.marginals import Joined
from slamsim.slam.backend.smoothing import Smoothed


class Sure(NamedTuple):
    """Covariances (n, 3, 3) of small steps of the base in its own frame, relative to the first of
    all poses, and to the map that these n make, None where they all lie in one place."""

    relative: FloatArray
    in_map: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceInformation:
    """What holds n views of a map together.

    panels: storage for a system whose unknowns are small steps of each view but the first, which is
    held fixed and stands for all that are, in its own frame. met, known: what the views of shared
    surfaces say: (m, 2) of the others, each with itself and then with those that it meets, and (m,
    3, 3). In its panels such a system takes many times the memory.
    drift: (n - 1, 3, 3) covariance of the odometry from view to view, of the later one in its own
    frame. closures: (c, 2) views that a closure joins without any surface that they share, and
    (c, 3, 3) covariance of the second ones. pairs: (p, 2) of views that share surfaces, each pair
    without the first once. poses: (n, 3) T_map_view. T_base_view: (n, 3) where each view is seen
    from its base.
    """

    panels: Panels
    met: IntArray
    known: FloatArray
    drift: FloatArray
    closures: tuple[IntArray, FloatArray]
    pairs: IntArray
    poses: FloatArray
    T_base_view: FloatArray

    @classmethod
    def of(
        cls,
        seen: tuple[Panels, FloatArray, IntArray],
        drift: FloatArray,
        closures: tuple[IntArray, FloatArray],
        poses: FloatArray,
        T_base_view: FloatArray,
    ) -> Self:
        """seen: the panels, the system in them, and the pairs."""
        panels, system, pairs = seen
        met = np.concatenate([_twice(len(poses) - 1), pairs[(pairs > 0).all(axis=1)]])
        known = blocks_at(panels, system, met - 1)
        return cls(panels, met, known, drift, closures, pairs, poses, T_base_view)

    @property
    def bases(self) -> FloatArray:
        """(n, 3) T_map_base of the views."""
        return compose(self.poses, inverse(self.T_base_view))

    def covariances(self) -> FloatArray:
        """(n, 3, 3) relative to the first pose, of small steps of the base in its own frame.

        Raises NoSolution if nothing holds some pose.
        """
        return _carried(adjoint(self.T_base_view), self._joined().covariances())

    def smoothed(self, scatter: FloatArray, first: int = 0) -> Sure:
        """Of the poses from number ``first`` on, when each is off by an error of its own besides,
        of (n, 3, 3) ``scatter``."""
        to_base, joined = adjoint(self.T_base_view), self._joined()
        poses = self.bases
        whole, shares = WholeMap.of(poses[first:]), np.zeros_like(scatter)
        if whole is not None:
            shares[first:] = whole.shares
            of_views = joined.times(np.swapaxes(to_base, 1, 2) @ shares)
            products = (to_base @ of_views + scatter @ shares)[first:]
        of_map = _carried(to_base, joined.covariances())
        return Sure(
            with_scatter(poses, of_map, scatter)[first:],
            None if whole is None else whole.covariances((of_map + scatter)[first:], products),
        )

    def blocks(self, first: int, T_map_rest: FloatArray) -> tuple[IntArray, FloatArray]:
        """What shared surfaces tell of the bases of the views from number ``first`` (at least 1)
        on: (m, 2) ordered pairs, and (m, 3, 3) of small steps of both, each in its own frame.

        The views before are one rigid rest, number 0 of the pairs, whose frame is at ``T_map_rest``
        (3,); the others follow. A step of the whole map changes nothing: that is what the rest,
        which is held fixed here, has in common with each view.
        """
        count = len(self.poses) - first
        later = (self.met >= first).all(axis=1)
        pairs, found = self.met[later] - first + 1, self.known[later]
        bases = np.concatenate([T_map_rest[None], self.bases[first:]])
        to_view = np.concatenate([np.eye(3)[None], adjoint(inverse(self.T_base_view))[first:]])
        found = np.swapaxes(to_view[pairs[:, 0]], 1, 2) @ found @ to_view[pairs[:, 1]]
        pairs = np.concatenate([pairs, pairs[count:, ::-1]])
        found = np.concatenate([found, np.swapaxes(found[count:], 1, 2)])
        with_rest = np.zeros((count + 1, 3, 3))
        moved = found @ adjoint(between(bases[pairs[:, 1]], bases[0]))
        np.subtract.at(with_rest, pairs[:, 0], moved)
        own = -np.einsum("nji,njk->ik", with_rest, adjoint(between(bases, bases[0])))
        ends = np.stack([np.arange(1, count + 1), np.zeros(count, np.int64)], axis=1)
        return (
            np.concatenate([pairs, ends, ends[:, ::-1], np.zeros((1, 2), np.int64)]),
            np.concatenate([found, with_rest[1:], np.swapaxes(with_rest[1:], 1, 2), own[None]]),
        )

    def _joined(self) -> Joined:
        count = len(self.poses)
        ends = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        return_freed_memory()
        system = empty_system(self.panels)
        add_blocks(self.panels, system, self.met - 1, self.known)
        seen = (self.panels, system, self.pairs)
        steps = (
            np.concatenate([ends, self.closures[0]]),
            np.concatenate([self.drift, self.closures[1]]),
        )
        return Joined(self.poses, 0, seen, steps)


class MapInformation(NamedTuple):
    """What holds the key frames of a drive once all scans are smoothed.

    surfaces: of all views of the map. scatter: (n, 3, 3) of what single scans leave on top. first:
    number of the view of the drive's first key frame. held: whether the views before are held
    fixed, and so are the map.
    """

    surfaces: SurfaceInformation
    scatter: FloatArray
    first: int
    held: bool

    def covariances(self) -> Sure:
        """Of the key frames of the drive."""
        sure = self.surfaces.smoothed(self.scatter, self.first)
        return sure._replace(in_map=sure.relative) if self.held else sure

    def blocks(self) -> tuple[IntArray, FloatArray]:
        """``SurfaceInformation.blocks`` of the drive's key frames, numbered from 0; -1 stands for
        an earlier map, whose frame that is."""
        if self.first:
            pairs, known = self.surfaces.blocks(self.first, np.zeros(3))
            return pairs - 1, known
        return self.surfaces.blocks(1, self.surfaces.bases[0])

    def steps(self) -> list[GraphEdge]:
        """The odometry between these key frames, and closures that no surfaces stand for.

        The way from the earlier map's frame to the first of them was not driven: it is a match.
        """
        whole, count = self.surfaces, len(self.surfaces.poses)
        chain = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        ends = np.concatenate([chain, whole.closures[0]])
        to_base = adjoint(whole.T_base_view[ends[:, 1]])
        covariances = _carried(to_base, np.concatenate([whole.drift, whole.closures[1]]))
        bases, found = whole.bases, []
        for k, (source, target) in enumerate(ends.tolist()):
            if target >= max(self.first, 1):
                before = source < self.first
                step = between(np.zeros(3) if before else bases[source], bases[target])
                covariance = _carried(rotation(step[2]), covariances[k])  # in the source's frame
                way: EdgeKind = "match" if before else "odometry"
                kind = way if k < count - 1 else "closure"
                numbers = -1 if before else source - self.first, target - self.first
                found.append(GraphEdge(*numbers, step, covariance, kind))
        return found


def smoothed_information(
    information: SurfaceInformation, graph: MapGraph, first: int, smoothed: Smoothed
) -> MapInformation:
    """Of the smoothed key frames from number ``first`` of the graph on.

    smoothed: the drive of these key frames, which alone is laid onto the truth. Where only a guess
    of the front end joins two of them, it stays as unsure as it was.
    """
    held = len(graph.keyframes) - len(information.poses)
    stamps_ns = graph.keyframes.stamps_ns[first:]
    first -= held
    guessed = {edge.target - held for edge in graph.edges if edge.kind == "odometry"}
    count = len(information.poses)
    driven = np.array([k not in guessed for k in range(first + 1, count)], dtype=np.bool_)
    drift, scatter = information.drift.copy(), np.zeros((count, 3, 3))
    to_view = adjoint(inverse(information.T_base_view[first + 1 :]))
    drift[first:][driven] = _carried(to_view, drift_between(smoothed, stamps_ns))[driven]
    scatter[first:] = smoothed.covariances[_numbers(smoothed, stamps_ns)]
    return MapInformation(replace(information, drift=drift), scatter, first, held > 0)


def drift_between(smoothed: Smoothed, stamps_ns: IntArray) -> FloatArray:
    """(k - 1, 3, 3) covariance of the odometry between scans, by their (k,) stamps, of the base at
    the later scan in its own frame."""
    at, poses = _numbers(smoothed, stamps_ns), smoothed.track.poses
    end = poses[np.repeat(at[1:], np.diff(at))]
    steps = slice(at[0], at[-1])
    carried = _carried(adjoint(between(end, poses[1:][steps])), smoothed.drift[steps])
    return np.asarray(np.add.reduceat(carried, at[:-1] - at[0], axis=0))


def with_scatter(poses: FloatArray, covariances: FloatArray, scatter: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3) relative to the first pose when each pose, the first one too, is off
    by an error of its own besides, of (n, 3, 3) ``scatter`` in its own frame."""
    from_first = adjoint(between(poses[1:], poses[0]))
    whole = covariances.copy()
    whole[1:] += scatter[1:] + _carried(from_first, scatter[0])
    return whole


def _twice(count: int) -> IntArray:
    """(count, 2): each number from 1 on, with itself."""
    return np.repeat(np.arange(1, count + 1)[:, None], 2, axis=1)


def _carried(carry: FloatArray, covariances: FloatArray) -> FloatArray:
    return np.asarray(carry @ covariances @ np.swapaxes(carry, -1, -2))


def _numbers(smoothed: Smoothed, stamps_ns: IntArray) -> IntArray:
    return np.searchsorted(smoothed.track.stamps_ns, stamps_ns)
