"""Frames and who is whose parent, faults included: nothing here assumes a tree."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from slamsim.recording import TransformEdge

_BASE_FRAMES = ("base_footprint", "base_link", "base")


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
        """The robot's base: of these, else of the usual names, the first that is there."""
        wanted = (*candidates, *_BASE_FRAMES)
        return next((frame for frame in wanted if frame in self), wanted[0])

    def nearest(self, frame: str) -> str:
        """The known frame with the most similar name, empty if none is."""
        return next(iter(difflib.get_close_matches(frame, sorted(self._neighbours), 1, 0.5)), "")

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
