"""Frames and their parents as a graph, which may have cycles and several parents, and as an
outline."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.guard.errors import nearest_name
from slamsim.guard.numbers import is_sound
from slamsim.recording import TransformEdge
from slamsim.recording.frames import BASE_FRAMES, unqualified

_FIXED_TOLERANCE = 1e-3
"""In metres and of a quaternion: what a published mount changes by rounding."""


class FrameGraph:
    """The directed graph parent -> child of all published transforms."""

    def __init__(self, edges: Iterable[TransformEdge]) -> None:
        self._edges = tuple(edges)
        self._neighbours: dict[str, set[str]] = {}
        self._above: dict[str, list[TransformEdge]] = {}
        for edge in self._edges:
            self._neighbours.setdefault(edge.parent, set()).add(edge.child)
            self._neighbours.setdefault(edge.child, set()).add(edge.parent)
            self._above.setdefault(edge.child, []).append(edge)

    def __contains__(self, frame: str) -> bool:
        return frame in self._neighbours

    def base(self, candidates: Sequence[str]) -> str:
        """The robot's base: of these, else of the usual names, the first that is there;
        else one with a namespace before it."""
        wanted = (*candidates, *BASE_FRAMES)
        known = next((frame for frame in wanted if frame in self), "")
        usual = (f for f in sorted(self._neighbours) if unqualified(f) in BASE_FRAMES)
        return known or next(usual, wanted[0])

    def nearest(self, frame: str) -> str:
        """The known frame with the most similar name, empty if none is."""
        return nearest_name(frame, sorted(self._neighbours), 0.5)

    def reached(self, frame: str) -> set[str]:
        """All frames that transforms join to this one, itself included."""
        found, waiting = {frame}, [frame]
        while waiting:
            fresh = self._neighbours.get(waiting.pop(), set()) - found
            found |= fresh
            waiting += fresh
        return found

    def connects(self, one: str, other: str) -> bool:
        return other in self.reached(one)

    def listed(self, frame: str) -> str:
        """The other frames that are joined to this one, in words."""
        others = sorted(self.reached(frame) - {frame})
        return ", ".join(others[:8]) + (", ..." if len(others) > 8 else "") if others else "nothing"

    def with_two_parents(self) -> dict[str, list[TransformEdge]]:
        """Frames to which transforms lead from more than one parent, the busiest edge first."""
        return {
            child: sorted(edges, key=lambda edge: -edge.stamps_ns.size)
            for child, edges in self._above.items()
            if len({edge.parent for edge in edges}) > 1
        }

    def loops(self) -> list[tuple[str, ...]]:
        """Each circle of parents once, beginning with its alphabetically first frame."""
        circles: set[tuple[str, ...]] = set()
        for start in self._above:
            path = [start]
            while (edges := self._above.get(path[-1])) and (above := edges[0].parent) not in path:
                path.append(above)
            if edges:
                circle = path[path.index(edges[0].parent) :]
                first = circle.index(min(circle))
                circles.add(tuple(reversed(circle[first + 1 :] + circle[: first + 1])))
        return sorted(circles)

    def moving_above(self, frames: Iterable[str]) -> list[TransformEdge]:
        """Edges that are not latched on the ways from these frames up to their roots."""
        found: dict[tuple[str, str], TransformEdge] = {}
        for start in frames:
            frame, seen = start, set[str]()
            while frame in self._above and frame not in seen:
                seen.add(frame)
                edge = self._above[frame][0]
                if not edge.is_static:
                    found[edge.parent, edge.child] = edge
                frame = edge.parent
        return list(found.values())

    def between(self, target: str, source: str) -> FloatArray | None:
        """4 x 4 ``T_target_source`` over transforms that do not move, None if they do not join."""
        found, waiting = {source: np.eye(4)}, [source]
        while waiting:
            frame = waiting.pop()
            for other, T_other_frame in self._steps(frame):
                if other not in found:
                    found[other] = T_other_frame @ found[frame]
                    waiting.append(other)
        return found.get(target)

    def _steps(self, frame: str) -> Iterator[tuple[str, FloatArray]]:
        """(neighbour, T_neighbour_frame) for each fixed transform that touches the frame."""
        for edge in self._edges:
            if frame in (edge.parent, edge.child):
                T_parent_child = _fixed(edge)
                if T_parent_child is not None and edge.child == frame:
                    yield edge.parent, T_parent_child
                elif T_parent_child is not None:
                    yield edge.child, np.asarray(np.linalg.inv(T_parent_child))


def _fixed(edge: TransformEdge) -> FloatArray | None:
    """4 x 4 T_parent_child of an edge that never moves, else None."""
    norm = np.linalg.norm(edge.quats_xyzw, axis=1)
    sound = is_sound(edge.positions_m) & (np.abs(norm - 1.0) < 0.1)
    if not sound.any():
        return None
    positions_m, quats_xyzw = edge.positions_m[sound], edge.quats_xyzw[sound]
    turned = 1.0 - np.abs(quats_xyzw @ quats_xyzw[0]).min()
    moved = np.ptp(positions_m, axis=0).max()
    if not edge.is_static and max(moved, turned) > _FIXED_TOLERANCE:
        return None
    rotation = matrix_from_xyzw(quats_xyzw[0] / np.linalg.norm(quats_xyzw[0]))
    return se3_from_parts(rotation, positions_m[0])


_LEAST_M, _LEAST_DEG = 5e-4, 0.05
"""Smaller numbers are 0 in what is shown."""


@dataclass(frozen=True, slots=True)
class FramePlace:
    """One frame of the tree. depth: 0 for a root. parent: empty for a root.

    about: how it is placed on its parent, in words. is_last: of its parent's children.
    """

    name: str
    parent: str
    depth: int
    about: str = ""
    is_fixed: bool = True
    is_last: bool = True


def outline(edges: Iterable[TransformEdge]) -> list[FramePlace]:
    """All frames, parents before children, every frame once.

    A frame with several parents stands below the one that most transforms name; of a circle of
    parents the alphabetically first frame is taken for the root.
    """
    joined = [edge for edge in edges if edge.parent != edge.child]
    above: dict[str, TransformEdge] = {}
    for edge in sorted(joined, key=lambda each: (-each.stamps_ns.size, each.name)):
        above.setdefault(edge.child, edge)
    below: dict[str, list[str]] = {}
    for child, edge in sorted(above.items()):
        below.setdefault(edge.parent, []).append(child)
    places: list[FramePlace] = []
    seen: set[str] = set()
    roots = {edge.parent for edge in joined} - above.keys()
    for root in (*sorted(roots), *sorted(above)):
        waiting = [] if root in seen else [FramePlace(root, "", 0)]
        seen.add(root)
        while waiting:
            place = waiting.pop()
            places.append(place)
            children = [child for child in below.get(place.name, ()) if child not in seen]
            seen.update(children)
            for child in reversed(children):
                edge, is_last = above[child], child == children[-1]
                told = _placed(edge), edge.is_static, is_last
                waiting.append(FramePlace(child, place.name, place.depth + 1, *told))
    return places


def drawn(places: Iterable[FramePlace]) -> list[str]:
    """The tree in lines of text."""
    lines, open_levels = [], dict[int, bool]()
    for place in places:
        levels = range(1, place.depth)
        bars = "".join("│  " if open_levels.get(level) else "   " for level in levels)
        branch = ("└─ " if place.is_last else "├─ ") if place.depth else ""
        open_levels[place.depth] = not place.is_last
        lines.append(f"{bars}{branch}{place.name}" + (f"  ({place.about})" if place.about else ""))
    return lines


def _placed(edge: TransformEdge) -> str:
    """Where a fixed frame is, or how often a moving one is published."""
    if not edge.is_static:
        return f"moves, {edge.topic}" if _moves(edge) else f"at rest, {edge.topic}"
    if not edge.stamps_ns.size or not np.isfinite(edge.quats_xyzw[0]).all():
        return "fixed"
    norm = float(np.linalg.norm(edge.quats_xyzw[0])) or 1.0
    rotation = matrix_from_xyzw(edge.quats_xyzw[0] / norm)
    axes = zip("xyz", edge.positions_m[0].tolist(), strict=True)
    words = [f"{axis} {value:.3g} m" for axis, value in axes if abs(value) >= _LEAST_M]
    yaw_deg = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
    tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, float(rotation[2, 2])))))
    words += [f"yaw {yaw_deg:.3g}°"] if abs(yaw_deg) >= _LEAST_DEG else []
    words += [f"tilted by {tilt_deg:.3g}°"] if tilt_deg >= _LEAST_DEG else []
    return ", ".join(["fixed", *words])


def _moves(edge: TransformEdge) -> bool:
    poses = np.hstack([edge.positions_m, edge.quats_xyzw])
    return bool(len(poses) > 1 and np.ptp(poses, axis=0).max() > _LEAST_M)
