"""Free space for the robot's centre: clearance on the true map and shortest paths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import BadNumbers, require_finite, require_number, require_size

if TYPE_CHECKING:
    from slamsim.world.model import World

_Number = TypeVar("_Number", np.float64, np.int32)

MAX_OPEN_CELLS = 4_000_000
AVOIDANCE = 4.0
"""A step along a wall costs this much more than one in the middle, as a share of its length."""


class NoWay(SlamsimError):
    """The robot is too wide for a place where it is to be."""


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """The cells of the true map.

    room_m: (rows, cols) radius of the largest disc about a cell's centre that is surely free.
    origin_m: centre of cell (0, 0). needed_m: the radius that the robot needs.
    """

    room_m: FloatArray
    origin_m: FloatArray
    resolution_m: float
    needed_m: float

    def __post_init__(self) -> None:
        require_finite("the room in a world", self.room_m, (None, None))
        require_finite("where a world begins", self.origin_m, (2,))
        require_size("the size of a cell in m", self.resolution_m)
        require_number("the radius that a robot needs in m", self.needed_m, 0.0)

    def cells_of(self, points_m: FloatArray) -> IntArray:
        """(n, 2) row and column of the cell under each point (n, 2), clipped to the map."""
        cells = np.rint((points_m - self.origin_m) / self.resolution_m).astype(np.int64)
        return np.clip(cells[:, ::-1], 0, np.array(self.room_m.shape) - 1)

    def centres_m(self, cells: IntArray) -> FloatArray:
        """(n, 2) x and y of cells (n, 2) given as row and column."""
        return cells[:, ::-1] * self.resolution_m + self.origin_m

    def room_at_m(self, points_m: FloatArray) -> FloatArray:
        """(n,) free radius about points (n, 2), between the cells' values; 0 off the map."""
        at = (points_m - self.origin_m) / self.resolution_m
        room = ndimage.map_coordinates(self.room_m, at[:, ::-1].T, order=1, mode="constant")
        return np.asarray(room, dtype=np.float64)


def free_space(world: World, resolution_m: float, needed_m: float) -> Space:
    """Clearance of every cell that can be reached from the start.

    The distance between cell centres less half a cell: a cell is solid if any part of it is, so
    this never promises more room than there is along a wall.
    """
    grid = world.obstacle_grid(resolution_m)
    free = np.pad(grid.occupancy == 0.0, 1)
    room_m = ndimage.distance_transform_edt(free) * resolution_m - 0.5 * resolution_m
    origin_m = np.array(grid.origin_m) - 0.5 * resolution_m
    return Space(np.maximum(room_m, 0.0), origin_m, resolution_m, needed_m)


def narrowest_on_the_way_m(space: Space, start_m: FloatArray, goal_m: FloatArray) -> float:
    """Radius of the largest disc that can go from one point to the other (bisection).

    start_m, goal_m: (2,).
    """
    ends = space.cells_of(np.stack([start_m, goal_m]))
    low, high = 0.0, float(space.room_m[tuple(ends.T)].min())
    while high - low > 0.002:
        middle = 0.5 * (low + high)
        labels, _ = ndimage.label(space.room_m >= middle, structure=np.ones((3, 3)))
        joined = labels[tuple(ends[0])] == labels[tuple(ends[1])] != 0
        low, high = (middle, high) if joined else (low, middle)
    return low


@dataclass(frozen=True, slots=True, eq=False)
class WayNet:
    """Cheapest ways between neighbouring places.

    lengths: (k, k) in cells, of the shortest way between any two places over the net. next_hop:
    (k, k) predecessor places, as scipy gives them. ways: cells (n, 2) from a to b for a < b.
    """

    lengths: FloatArray
    next_hop: IntArray
    ways: dict[tuple[int, int], IntArray]

    def cells_between(self, start: int, goal: int) -> list[IntArray]:
        """The pieces (n, 2) of the way from one place to another, through those in between."""
        stops = [goal]
        while stops[-1] != start:
            stops.append(int(self.next_hop[start, stops[-1]]))
        stops.reverse()
        return [self.ways[a, b] if a < b else self.ways[b, a][::-1] for a, b in pairwise(stops)]


def connect_places(space: Space, places_m: FloatArray, preferred_m: float) -> WayNet:
    """The net of ways between places (k, 2), the first of which is the start.

    One search from all places at once gives each its region; where regions meet, the cheapest
    crossing becomes a way (Mehlhorn 1988). Raises NoWay if a place is out of reach,
    and BadNumbers for no place, or one that is none.
    """
    require_finite("places", places_m, (None, 2))
    if not len(places_m):
        raise BadNumbers("a net of ways has at least one place, the start")
    open_cells = reachable_cells(space, places_m[0])
    cells = np.argwhere(open_cells)
    if len(cells) > MAX_OPEN_CELLS:
        raise SlamsimError(
            f"the way is to be searched on {len(cells)} cells of {space.resolution_m:g} m, at most "
            f"{MAX_OPEN_CELLS} fit into memory: make drive.route.resolution_m larger"
        )
    number = np.full(open_cells.shape, -1, dtype=np.int32)
    number[open_cells] = np.arange(len(cells), dtype=np.int32)
    graph = _cell_graph(space, number, preferred_m)
    seeds = number[tuple(_standing_cells(space, open_cells, places_m).T)]
    roots, place_of_root = np.unique(seeds, return_index=True)
    distances, before, root = csgraph.dijkstra(
        graph, indices=roots, min_only=True, return_predecessors=True
    )
    owner = place_of_root[np.searchsorted(roots, root)]
    crossings = _crossings(graph, distances, owner)
    ways = {
        (int(owner[i]), int(owner[j])): cells[
            [*_back(before, int(i))[::-1], *_back(before, int(j))]
        ]
        for i, j in crossings
    }
    # Places on one and the same cell are joined by a way of no length.
    for place, twin in enumerate(place_of_root[np.searchsorted(roots, seeds)].tolist()):
        if twin != place:
            ways[twin, place] = cells[seeds[[place]]]
    return _net(ways, len(places_m))


def reachable_cells(space: Space, start_m: FloatArray) -> BoolArray:
    """(rows, cols) where the robot's middle may come to. Raises NoWay if it does not fit at its
    start."""
    wide = space.room_m >= space.needed_m
    start = tuple(space.cells_of(start_m[None])[0])
    if not wide[start]:
        raise NoWay(
            f"the robot does not fit at its start ({start_m[0]:.2f}, {start_m[1]:.2f}): there is "
            f"room for a radius of {space.room_m[start]:.3f} m, it needs {space.needed_m:.3f} m"
        )
    labels, _ = ndimage.label(wide, structure=np.ones((3, 3)))
    return np.asarray(labels == labels[start])


def _standing_cells(space: Space, open_cells: BoolArray, places_m: FloatArray) -> IntArray:
    """(k, 2) open cell nearest to each place; raises NoWay if one is not at the place."""
    _, nearest = ndimage.distance_transform_edt(~open_cells, return_indices=True)
    wanted = space.cells_of(places_m)
    standing = nearest[:, wanted[:, 0], wanted[:, 1]].T.astype(np.int64)
    off_m = np.linalg.norm(space.centres_m(standing) - places_m, axis=1)
    if off_m.max() > 0.5 * space.needed_m + space.resolution_m:
        place = places_m[int(off_m.argmax())]
        narrowest_m = narrowest_on_the_way_m(space, places_m[0], place)
        raise NoWay(
            f"there is no route for the robot from ({places_m[0, 0]:.2f}, {places_m[0, 1]:.2f}) to "
            f"({place[0]:.2f}, {place[1]:.2f}): the widest one narrows to {2 * narrowest_m:.2f} m, "
            f"the robot and its clearance need {2 * space.needed_m:.2f} m"
        )
    return standing


def _cell_graph(space: Space, number: NDArray[np.int32], preferred_m: float) -> sparse.csr_array:
    """Eight neighbours; a step costs its length, more beside walls."""
    reach_m = max(preferred_m, 1e-9)
    spare_m = np.clip(space.room_m - space.needed_m, 0.0, reach_m)
    price = 1.0 + AVOIDANCE * (1.0 - spare_m / reach_m) ** 2
    sources, targets, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        i, j = _neighbours(number, down, right)
        here, there = _neighbours(price, down, right)
        both = (i >= 0) & (j >= 0)
        length_m = space.resolution_m * np.hypot(down, right)
        sources.append(i[both])
        targets.append(j[both])
        costs.append(length_m * 0.5 * (here[both] + there[both]))
    i, j, cost = np.concatenate(sources), np.concatenate(targets), np.concatenate(costs)
    size = int(number.max()) + 1
    one_way = sparse.csr_array((cost, (i, j)), shape=(size, size))
    return sparse.csr_array(one_way + one_way.T)


def _neighbours(
    field: NDArray[_Number], down: int, right: int
) -> tuple[NDArray[_Number], NDArray[_Number]]:
    """The values of all pairs of cells that lie (down, right) from one another."""
    rows, cols = field.shape
    left, shift = max(-right, 0), max(right, 0)
    here = field[: rows - down, left : cols - shift]
    there = field[down:, left + right : cols - shift + right]
    return here.ravel(), there.ravel()


def _crossings(graph: sparse.csr_array, distances: FloatArray, owner: IntArray) -> IntArray:
    """(m, 2) cells i and j: for each two regions that touch, the cheapest step between them."""
    i = np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr))
    border = np.flatnonzero(owner[i] < owner[graph.indices])
    i, j = i[border], graph.indices[border].astype(np.int64)
    cost = distances[i] + graph.data[border] + distances[j]
    order = np.lexsort((cost, owner[j], owner[i]))
    i, j = i[order], j[order]
    pairs = np.stack([owner[i], owner[j]])
    first = np.ones(i.size, dtype=bool)
    first[1:] = np.any(pairs[:, 1:] != pairs[:, :-1], axis=0)
    return np.column_stack([i[first], j[first]])


def _back(before: NDArray[np.int32], cell: int) -> list[int]:
    """From a cell back to the place of its region, both included."""
    walk = [cell]
    while before[walk[-1]] >= 0:
        walk.append(int(before[walk[-1]]))
    return walk


def _net(ways: dict[tuple[int, int], IntArray], places: int) -> WayNet:
    pairs = np.array(list(ways), dtype=np.int64).reshape(-1, 2)
    lengths = [1e-9 + np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in ways.values()]
    net = sparse.csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(places, places))
    shortest, next_hop = csgraph.dijkstra(net, directed=False, return_predecessors=True)
    return WayNet(shortest, next_hop.astype(np.int64), ways)


def cheapest_way(
    space: Space, start_m: FloatArray, targets: BoolArray, preferred_m: float
) -> IntArray | None:
    """(n, 2) cells from a point to the target that is reached at the least cost; None for none.

    targets: (rows, cols). Raises NoWay if the robot does not fit at its start.
    """
    open_cells = reachable_cells(space, start_m)
    cells = np.argwhere(open_cells)
    number = np.full(open_cells.shape, -1, dtype=np.int32)
    number[open_cells] = np.arange(len(cells), dtype=np.int32)
    wanted = number[targets & open_cells]
    if not wanted.size:
        return None
    start = int(number[tuple(space.cells_of(start_m[None])[0])])
    costs, before, _ = csgraph.dijkstra(
        _cell_graph(space, number, preferred_m),
        indices=[start],
        min_only=True,
        return_predecessors=True,
    )
    nearest = int(wanted[np.argmin(costs[wanted])])
    return np.asarray(cells[_back(before, nearest)[::-1]])
