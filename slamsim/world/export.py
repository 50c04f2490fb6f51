"""Exports a world: its mesh as a file, its figures as numbers."""

from __future__ import annotations

import struct

import numpy as np

from slamsim.core.types import TriangleMesh
from slamsim.world.model import World

_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_bytes(mesh: TriangleMesh) -> bytes:
    """The mesh as binary STL (3D Systems 1989), in metres."""
    corners = mesh.vertices_m[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(corners), dtype=_STL_TRIANGLE)
    records["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    records["corners"] = corners
    header = b"slamsim world, metres".ljust(80)
    return header + struct.pack("<I", len(corners)) + records.tobytes()


def world_facts(world: World) -> dict[str, object]:
    """What a person wants to know of a world before driving through it."""
    x_min, y_min, x_max, y_max = world.bounds_m
    return {
        "name": world.name,
        "seed": world.seed,
        "width_m": x_max - x_min,
        "depth_m": y_max - y_min,
        "height_m": float(world.mesh.vertices_m[:, 2].max()),
        "clearance_m": world.clearance_m,
        "places_to_visit": len(world.visit_points_m),
        "triangles": len(world.mesh.triangles),
        "floor_friction": world.floor_friction,
        "floor_patches": len(world.floor_patches),
    }
