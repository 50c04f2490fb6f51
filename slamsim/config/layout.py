"""Where the walls of a world run (a maze, rooms, a drawn plan, an image or a mesh), and how it
looks to cameras: materials, posters, tags, panes and lamps.

Lidars measure the same whatever is said of the looks: only cameras look at them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from slamsim.config.base import Config

MAX_CELLS = 40_000

Algorithm = Literal[
    "backtracker",
    "wilson",
    "aldous_broder",
    "prim",
    "kruskal",
    "eller",
    "hunt_and_kill",
    "growing_tree",
    "recursive_division",
    "binary_tree",
    "sidewinder",
]


def ascending(pair: tuple[Any, Any]) -> tuple[Any, Any]:
    """The pair itself; ValueError if its first value is the larger one."""
    if pair[0] > pair[1]:
        raise ValueError(f"the smaller value comes first, not [{pair[0]}, {pair[1]}]")
    return pair


Share = Annotated[float, Field(ge=0.0, le=1.0)]
Size = Annotated[float, Field(gt=0.0, le=100.0)]
SizeRange = Annotated[tuple[Size, Size], Field(strict=False), AfterValidator(ascending)]
CellCount = Annotated[int, Field(ge=1, le=100)]
CellRange = Annotated[tuple[CellCount, CellCount], Field(strict=False), AfterValidator(ascending)]
CellSize = Annotated[float, Field(gt=0.2, le=50.0)]


class MazeLayout(Config):
    """A labyrinth grown from the seed on a grid of square cells."""

    rows: int = Field(default=8, ge=1, le=400)
    """Number of cells in y."""
    columns: int = Field(default=8, ge=1, le=400)
    """Number of cells in x."""
    cell_m: CellSize = 2.0
    """Distance from one wall's centre line to the next, in metres."""
    algorithm: Algorithm = "backtracker"
    """How the labyrinth grows: backtracker (long winding ways), wilson and aldous_broder (every
    labyrinth equally likely), prim, kruskal, eller, hunt_and_kill, growing_tree,
    recursive_division (long straight walls), binary_tree or sidewinder (a bias in direction)."""
    dead_ends_opened: Share = 0.6
    """Share of the dead ends that get a second way out, which makes loops."""
    walls_removed: Share = 0.05
    """Share of the inner walls left after that which are taken away, which makes more loops."""
    halls: int = Field(default=0, ge=0, le=1000)
    """Number of rectangles of cells whose inner walls are taken away."""
    hall_cells: CellRange = (2, 2)
    """Smallest and largest side of such a rectangle, in cells."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (cells := self.rows * self.columns) > MAX_CELLS:
            raise ValueError(f"rows x columns = {cells} cells; at most {MAX_CELLS} are built")
        if self.halls and self.hall_cells[0] > min(self.rows, self.columns):
            raise ValueError(
                f"hall_cells begins at {self.hall_cells[0]}, the maze has only {self.rows} x "
                f"{self.columns} cells: make halls smaller, or set halls to 0"
            )
        return self


class RoomsLayout(Config):
    """An office grown from the seed: a straight corridor with rooms on both sides."""

    cell_m: CellSize = 1.5
    """Side of the square cells that rooms are made of, in metres."""
    length_cells: int = Field(default=14, ge=1, le=400)
    """Length of the corridor."""
    corridor_cells: int = Field(default=1, ge=1, le=20)
    """Width of the corridor."""
    depth_cells: int = Field(default=3, ge=1, le=50)
    """Depth of the rooms, away from the corridor."""
    room_cells: CellRange = (2, 4)
    """Smallest and largest width of a room, along the corridor; the last room of a row may be
    narrower."""
    linked: Share = 0.3
    """Share of the neighbouring rooms that have a door between them, which makes loops."""


class PlanLayout(Config):
    """A floor plan drawn in characters."""

    cell_m: CellSize = 2.0
    """Side of one drawn cell, in metres."""
    drawing: str = Field(min_length=1, max_length=1_000_000)
    """Lines of text, the first at the largest y. A corner is +, a wall -- or |, a door D, an open
    side is blank; a cell is two blanks, or ## where there is none, or S in the start cell."""


class ImageLayout(Config):
    """The occupied cells of a ROS map_server map, extruded to the height of the walls."""

    file: str = Field(min_length=1, max_length=1000)
    """The map's YAML file; a relative path starts at the folder of the file that says so."""
    unknown: Literal["solid", "open"] = "solid"
    """What the map's unknown cells are made of: solid keeps the robot in the known part."""
    visit_spacing_m: float = Field(default=2.0, gt=0.0, le=1000.0)
    """A tour comes by one place in each square of this side, in metres."""


class MeshLayout(Config):
    """A triangle mesh, closed or open; its own floor may stay in it."""

    file: str = Field(min_length=1, max_length=1000)
    """An STL, OBJ, PLY or GLB file; a relative path starts at the folder of the file that says
    so."""
    scale: float = Field(default=1.0, gt=0.0, le=1e6)
    """Metres per unit of the file: 0.001 for millimetres."""
    up: Literal["auto", "z", "y"] = "auto"
    """Which axis of the file points up: auto is y for GLB, as its standard has it, else z."""
    floor_m: float = Field(default=0.0, ge=-1e4, le=1e4)
    """Height in the file, in metres and after scaling, at which the robot's floor lies."""
    visit_spacing_m: float = Field(default=2.0, gt=0.0, le=1000.0)
    """A tour comes by one place in each square of this side, in metres."""


TagFamily = Literal[
    "apriltag_36h11",
    "aruco_4x4_50",
    "aruco_4x4_100",
    "aruco_4x4_250",
    "aruco_4x4_1000",
    "aruco_5x5_50",
    "aruco_5x5_100",
    "aruco_5x5_250",
    "aruco_5x5_1000",
    "aruco_6x6_50",
    "aruco_6x6_100",
    "aruco_6x6_250",
    "aruco_6x6_1000",
    "aruco_original",
]

_OTHER_COUNTS = {"apriltag_36h11": 587, "aruco_original": 1024}


def tags_in(family: TagFamily) -> int:
    """Different tags that a family has, as ``cv2.aruco`` knows them."""
    return _OTHER_COUNTS.get(family) or int(family.rpartition("_")[2])


Count = Annotated[int, Field(ge=0, le=1000)]


class TagsConfig(Config):
    """Square marks on walls that cameras recognise, each with its own number."""

    count: Count = 0
    """How many hang on walls beside free floor; those that find no room are left out."""
    family: TagFamily = "apriltag_36h11"
    """Which marks: AprilTag 36h11, or a dictionary of ArUco."""
    first_id: int = Field(default=0, ge=0, le=1023)
    """Number of the first tag; the next ones count up."""
    size_m: SizeRange = (0.16, 0.16)
    """Smallest and largest side of the black square, in metres, without the white border around."""
    height_m: SizeRange = (0.25, 0.7)
    """Lowest and highest middle above the floor, in metres."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        there = tags_in(self.family)
        if self.first_id + self.count > there:
            raise ValueError(
                f"{self.count} tags from first_id {self.first_id} are more than the {there} of "
                f"{self.family}"
            )
        return self


class PostersConfig(Config):
    """Printed sheets on walls: what makes places look different from each other."""

    count: Count = 24
    """How many hang on walls beside free floor, times ``texture``; those that find no room are
    left out."""
    size_m: SizeRange = (0.3, 0.7)
    """Smallest and largest width, in metres; sheets are up to 1.4 times as high, or as low."""
    height_m: SizeRange = (0.3, 1.4)
    """Lowest and highest middle above the floor, in metres."""


class PanesConfig(Config):
    """Sheets of glass and mirrors on walls, the hard cases of cameras.

    They hang flat on the wall's mesh; lidars see that wall, unless ``meets_panes`` of theirs is on.
    """

    glass: Count = 0
    """How many panes of glass, behind which the wall is dark."""
    mirrors: Count = 0
    """How many mirrors."""
    size_m: SizeRange = (0.4, 0.9)
    """Smallest and largest side, in metres."""


class LampsConfig(Config):
    """Lamps above free floor, and the light that comes from everywhere."""

    spacing_m: float = Field(default=3.5, ge=0.5, le=100.0)
    """Smallest distance between two lamps, in metres; there are as many as then find room."""
    height_m: float = Field(default=2.6, ge=0.2, le=50.0)
    """Height above the floor, in metres."""
    reach_m: float = Field(default=6.0, ge=0.5, le=200.0)
    """From here on a lamp gives no light, in metres; it fades smoothly until there."""
    brightness: float = Field(default=0.8, ge=0.0, le=100.0)
    """Light of one lamp on the floor right below it; 1 makes a white surface as bright as 1."""
    ambient: float = Field(default=0.25, ge=0.0, le=100.0)
    """Light from everywhere, in the same unit: what shadows are lit by."""
    shadowing: int = Field(default=4, ge=1, le=16)
    """Each point is lit by so many lamps at most, those that light it best."""


Family = Literal["mixed", "office", "workshop", "bricks", "home"]
Split = Literal["train", "test"]


class LooksConfig(Config):
    """How the world looks to cameras."""

    family: Family = "mixed"
    """Materials of walls, floor and clutter: office (paint, plaster, linoleum), workshop
    (concrete), bricks (masonry, tiles), home (wood, fabric), or mixed: each surface of any."""
    split: Split = "train"
    """train or test: no texture, colour or poster of the one is ever in the other."""
    texture: Share = 1.0
    """From 0 (all is painted in one colour, and no poster hangs) to 1 (full contrast)."""
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    """Seed of the looks alone; without one, the seed of the world."""
    posters: PostersConfig = PostersConfig()
    """Printed sheets on walls."""
    tags: TagsConfig = TagsConfig()
    """Marks on walls that cameras recognise."""
    panes: PanesConfig = PanesConfig()
    """Glass and mirrors."""
    lamps: LampsConfig = LampsConfig()
    """Light."""
