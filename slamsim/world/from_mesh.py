"""Solids from a triangle mesh file, closed or open."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from slamsim.config.layout import MeshLayout
from slamsim.core.types import TriangleMesh
from slamsim.guard.errors import InputRefused
from slamsim.guard.mesh import check_mesh
from slamsim.guard.mesh_file import check_mesh_file


def read_mesh(layout: MeshLayout) -> TriangleMesh:
    """The file's triangles in metres, z up, the floor at z = 0.

    Raises NotFound, or InputRefused for a file that is damaged, empty or lies under the floor.
    """
    path = Path(layout.file)
    check_mesh_file(path)
    import trimesh

    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numbers that are not finite, which are refused
            loaded = trimesh.load_scene(path, process=False, skip_materials=True).to_mesh()
    except Exception as error:  # trimesh raises whatever a damaged file makes its parsers raise
        raise InputRefused(path, f"cannot be read as a mesh ({error!r:.200})") from None
    vertices = np.array(loaded.vertices, dtype=np.float64) * layout.scale
    triangles = np.array(loaded.faces, dtype=np.int64)
    check_mesh(vertices, triangles, path)
    if layout.up == "y" or (layout.up == "auto" and path.suffix.lower() == ".glb"):
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
    vertices[:, 2] -= layout.floor_m
    if vertices[:, 2].max() <= 0.0:
        top = vertices[:, 2].max()
        raise InputRefused(path, f"ends {-top:g} m below the floor (mesh.floor_m, mesh.up)")
    return TriangleMesh(vertices, triangles.astype(np.int32))
