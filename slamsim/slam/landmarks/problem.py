"""What ties the poses of a map and its tags, and how they are numbered for the solution."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.geometry import compose, inverse
from slamsim.core.landmarks import CameraErrors, KnownTag, TagsSeen
from slamsim.core.result import GraphEdge
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.slam.landmarks.joint import SHARED, JointSolver, Ties
from slamsim.slam.landmarks.nodes import Nodes
from slamsim.slam.landmarks.views import TagView
from slamsim.slam.landmarks.wheels import wheel_slopes


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """poses: (m, 3): the origin of the survey or the earlier map if base is 1, nodes from number
    base on, then tags by number. fixed: edges that are no views of tags; views: those that are.
    keyframes: (k,)."""

    poses: FloatArray
    base: int
    keyframes: IntArray
    numbers: Mapping[int, int]
    fixed: tuple[GraphEdge, ...]
    blind: BoolArray
    wheels: FloatArray
    views: tuple[GraphEdge, ...]
    seen: tuple[TagView, ...]
    cameras: Mapping[str, CameraErrors]
    surfaces: tuple[IntArray, FloatArray]
    known: frozenset[int]
    warnings: tuple[str, ...]
    continues: bool
    joined: bool
    family: str

    @staticmethod
    def of(nodes: Nodes, views: Sequence[TagView], tags: TagsSeen) -> Problem:
        track = nodes.track.poses
        first = _places(track, views)
        seen = sorted(first)
        known = [each for each in tags.known if each.number in first]
        base = 1 if known or tags.continues else 0
        numbers = {tag: base + len(track) + k for k, tag in enumerate(seen)}
        poses = np.concatenate([track, [first[tag] for tag in seen]])
        fixed = [replace(e, source=base + e.source, target=base + e.target) for e in nodes.edges]
        if known and not tags.continues:
            anchor = known[0]
            poses = compose(compose(anchor.T_map_tag, inverse(first[anchor.number])), poses)
        if base:
            poses = np.concatenate([np.zeros((1, 3)), poses])
        # Tags of an earlier map share its errors, and those of the camera that saw them there. With
        # variances so many times as large they are right however they hang together (Julier &
        # Uhlmann 1997).
        unsure = len(known) if tags.continues else 1
        fixed += [
            GraphEdge(0, numbers[each.number], each.T_map_tag, unsure * each.covariance, "match")
            for each in known
        ]
        return Problem(
            poses,
            base,
            base + nodes.keyframes,
            numbers,
            tuple(fixed),
            np.append(nodes.blind, np.zeros(len(known), np.bool_)),
            nodes.wheels,
            tuple(replace(v.edge, source=base + v.node, target=numbers[v.number]) for v in views),
            tuple(views),
            tags.cameras,
            (base + nodes.surfaces[0], nodes.surfaces[1]),
            frozenset(each.number for each in known),
            () if tags.continues else _missing(tags.known, known),
            tags.continues,
            tags.joined,
            tags.family,
        )

    def fitting(self, solver: JointSolver) -> dict[int, list[bool]]:
        """Of each tag by its number, whether its views count."""
        found: dict[int, list[bool]] = {tag: [] for tag in self.numbers}
        for view, weight in zip(self.seen, solver.weights[len(self.fixed) :], strict=True):
            found[view.number].append(bool(weight > 0.0))
        return found

    def ties(self) -> Ties:
        """The wheels count as the last of the cameras: they have errors in common as well."""
        names = {name: k for k, name in enumerate(self.cameras)}
        driven, none = self.blind.tolist(), np.zeros((3, SHARED))
        slopes = [
            wheel_slopes(edge) if by_wheels else none
            for edge, by_wheels in zip(self.fixed, driven, strict=True)
        ]
        return Ties(
            (*self.fixed, *self.views),
            np.array(
                [len(names) if by_wheels else -1 for by_wheels in driven]
                + [names.get(view.camera, -1) for view in self.seen]
            ),
            np.array([*slopes, *(view.slopes for view in self.seen)]),
            np.array([*(each.sigmas for each in self.cameras.values()), self.wheels]),
            self.surfaces,
            self.poses,
        )


def _places(track: FloatArray, views: Sequence[TagView]) -> dict[int, FloatArray]:
    """Of each tag by its number, (3,) that place of all in which nodes saw it which is nearest to
    the others: one view may be of another tag."""
    told: dict[int, list[FloatArray]] = defaultdict(list)
    for view in views:
        told[view.number].append(compose(track[view.node], view.edge.T_source_target))
    found = {}
    for number, poses in told.items():
        places = np.array(poses)
        # Row by row: a tag may be in view from thousands of nodes.
        apart = [np.linalg.norm(place[:2] - places[:, :2], axis=1).sum() for place in places]
        found[number] = places[int(np.argmin(apart))]
    return found


def _missing(known: Sequence[KnownTag], seen: Sequence[KnownTag]) -> tuple[str, ...]:
    if not known or seen:
        return ()
    return (
        f"none of the {len(known)} surveyed tags was seen: the map begins at its first key frame",
    )
