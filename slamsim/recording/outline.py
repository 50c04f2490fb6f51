"""The transform tree of a recording as an outline: each frame below its parent."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw
from slamsim.recording import TransformEdge

_LEAST_M, _LEAST_DEG = 5e-4, 0.05


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
