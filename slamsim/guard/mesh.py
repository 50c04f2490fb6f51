"""Triangle meshes of users: arrays are checked before an engine gets them, files before that.

Open3D and PyBullet crash on an index out of range, and take a cut file for an empty world.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import InputRefused
from slamsim.guard.limits import LIMITS


def check_mesh(vertices: NDArray[Any], triangles: NDArray[Any], path: Path) -> None:
    """Raise InputRefused unless this mesh can be handed to an engine.

    vertices: (v, 3) in metres, finite, within ``LIMITS.mesh_coordinate_m``. triangles: (t, 3)
    integers from 0 to v - 1. At least one triangle has an area.
    """
    _check_shapes(vertices, triangles, path)
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        reason = f"{np.count_nonzero(~finite):,} vertices are not finite (NaN or infinite)"
        raise InputRefused(path, reason, f"vertex {bad}")
    far = np.abs(vertices).max(axis=1) > LIMITS.mesh_coordinate_m
    if far.any():
        bad = int(np.argmax(far))
        reason = f"lies {np.abs(vertices[bad]).max():g} m out, more than "
        reason += f"{LIMITS.mesh_coordinate_m:g} m"
        raise InputRefused(path, reason, f"vertex {bad}", limit="mesh_coordinate_m")
    wrong = ((triangles < 0) | (triangles >= len(vertices))).any(axis=1)
    if wrong.any():
        bad = int(np.argmax(wrong))
        reason = f"names the vertices {triangles[bad].tolist()}, there are 0..{len(vertices) - 1}"
        raise InputRefused(path, reason, f"triangle {bad}")
    if not _has_area(np.asarray(vertices, np.float64), triangles):
        raise InputRefused(path, "all its triangles are lines or points")


def _check_shapes(vertices: NDArray[Any], triangles: NDArray[Any], path: Path) -> None:
    for name, array in (("vertices", vertices), ("triangles", triangles)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise InputRefused(path, f"its {name} have the shape {array.shape}, not (n, 3)")
    if triangles.dtype.kind not in "iu" or vertices.dtype.kind not in "fiu":
        kinds = f"{vertices.dtype} vertices, {triangles.dtype} triangles"
        raise InputRefused(path, f"has {kinds}; numbers and whole numbers are needed")
    if len(vertices) == 0 or len(triangles) == 0:
        counts = f"{len(vertices)} vertices and {len(triangles)} triangles"
        raise InputRefused(path, f"has {counts}: is it empty, cut off or not a mesh?")
    for name, count, most in (
        ("vertices", len(vertices), LIMITS.mesh_vertices),
        ("triangles", len(triangles), LIMITS.mesh_triangles),
    ):
        if count > most:
            reason = f"has {count:,} {name}, at most {most:,} are read"
            raise InputRefused(path, reason, limit=f"mesh_{name}")


def _has_area(vertices: NDArray[np.float64], triangles: NDArray[Any]) -> bool:
    block = 1 << 20
    for start in range(0, len(triangles), block):
        a, b, c = (vertices[triangles[start : start + block, k]] for k in range(3))
        if np.cross(b - a, c - a).any():
            return True
    return False
