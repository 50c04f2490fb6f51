"""The world model that all other stages use; a world as a mesh file and as numbers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, Grid, TriangleMesh
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite, require_number
from slamsim.world.parts import Parts
from slamsim.world.prism import Solids
from slamsim.world.raster import Raster, rasterise

Bounds = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max in metres in the map frame."""

MAX_GRID_CELLS = 64_000_000

BODY_LOW_M, BODY_HIGH_M = 0.01, 0.5
"""What lies between these heights a robot's body could touch."""


@dataclass(frozen=True, slots=True)
class FloorPatch:
    """A rectangle of floor with its own Coulomb friction; a later patch covers earlier ones."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float
    friction: float

    def __post_init__(self) -> None:
        for border_m in (self.x_min_m, self.y_min_m, self.x_max_m, self.y_max_m):
            require_number("a border of a patch of floor in m", border_m)
        require_number("a friction coefficient", self.friction, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Where a robot drives. The floor is the plane z = 0 and no part of the mesh.

    mesh: all solids in the map frame; those of mazes, rooms, plans and images are closed
    surfaces, counter-clockwise seen from outside. parts: what each triangle belongs to.
    start_pose: ``T_map_base`` (3,) as x_m, y_m, yaw_rad. bounds_m: of everything solid, and of a
    map's image. visit_points_m: (k, 2) places that a tour of the whole world must come by; a disc
    of diameter clearance_m can go from the start to each of them.
    """

    name: str
    seed: int
    mesh: TriangleMesh
    parts: Parts
    solids: Solids
    floor_friction: float
    floor_patches: tuple[FloorPatch, ...]
    start_pose: FloatArray
    bounds_m: Bounds
    visit_points_m: FloatArray
    clearance_m: float

    def __post_init__(self) -> None:
        require_finite("the start of a world", self.start_pose, (3,))
        require_finite("the places of a world", self.visit_points_m, (None, 2))
        for border_m in self.bounds_m:
            require_number("a border of a world in m", border_m)
        require_number("the friction of a world's floor", self.floor_friction, 0.0)
        require_number("the clearance of a world in m", self.clearance_m, 0.0)

    def grid(self, resolution_m: float, height_m: float) -> Grid:
        """The true occupancy at a height.

        A cell is 1 if any part of it is solid there, 0 if it is free and joined to the start by
        free cells that share sides, ``nan`` if it is free but out of reach. Cell borders lie on
        whole multiples of the resolution. Raises SlamsimError if the start is not free.
        """
        require_number("a height in m", height_m)
        return self._grid(self.solids.section(height_m), resolution_m, f"at {height_m:g} m")

    def obstacle_grid(
        self, resolution_m: float, low_m: float = BODY_LOW_M, high_m: float = BODY_HIGH_M
    ) -> Grid:
        """As ``grid``, but 1 wherever anything stands between two heights above the floor: what a
        robot's body could touch, low things included that a lidar does not see."""
        return self._grid(self.solids.shadow(low_m, high_m), resolution_m, "at the robot's height")

    def _grid(self, outline: FloatArray, resolution_m: float, where: str) -> Grid:
        raster = Raster.covering(self.bounds_m, resolution_m)
        if raster.rows * raster.columns > MAX_GRID_CELLS:
            raise SlamsimError(
                f"a grid of {raster.rows} x {raster.columns} cells is too large (at most "
                f"{MAX_GRID_CELLS}): {resolution_m:g} m is too fine for this world"
            )
        solid = rasterise(outline, raster)
        occupancy = np.where(_reachable(solid, raster, self.start_pose, where), 0.0, np.nan)
        occupancy[solid] = 1.0
        return Grid(occupancy.astype(np.float32), resolution_m, raster.origin_m)


def _reachable(solid: BoolArray, raster: Raster, start: FloatArray, where: str) -> BoolArray:
    """The free cells that hang together with the one of the start."""
    row, column = raster.cell_of(start[None, :2])[0].tolist()
    if not (0 <= row < raster.rows and 0 <= column < raster.columns) or solid[row, column]:
        raise SlamsimError(
            f"the start ({start[0]:g}, {start[1]:g}) is not free {where} in cells of "
            f"{raster.resolution_m:g} m"
        )
    from scipy import ndimage  # not at the top: the process that drives gets a world as well

    labels, _ = ndimage.label(~solid)
    return np.asarray(labels == labels[row, column])


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
