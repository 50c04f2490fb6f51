"""What a world file may say.

Exactly one of ``maze``, ``rooms``, ``plan``, ``image`` and ``mesh`` tells where the walls run;
a file that names none gets a maze. The other sections dress the walls of the first three.
The map frame has its origin at the outer corner of the cell with the smallest x and y, on the
centre lines of the walls.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from slamsim.config.base import Config
from slamsim.config.layout import (
    ImageLayout,
    LooksConfig,
    MazeLayout,
    MeshLayout,
    PlanLayout,
    RoomsLayout,
    Share,
    Size,
    SizeRange,
    ascending,
)

ClutterShape = Literal["box", "cylinder", "table", "chair", "l_shape", "panel"]
LAYOUTS = ("maze", "rooms", "plan", "image", "mesh")
FARTHEST_M = 1e5
"""Single-precision coordinates are 8 mm apart there."""
Place = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
PlaceRange = Annotated[tuple[Place, Place], Field(strict=False), AfterValidator(ascending)]


class WallsConfig(Config):
    """The walls of a maze, of rooms or of a plan, and the height of an image's."""

    thickness_m: float = Field(default=0.15, ge=0.01, le=10.0)
    """Thickness, in metres."""
    thickness_jitter_m: float = Field(default=0.0, ge=0.0, le=5.0)
    """Each wall is up to so much thicker or thinner, in metres."""
    height_m: float = Field(default=1.0, ge=0.05, le=20.0)
    """Height above the floor, in metres; a lidar at 0.3 m does not see lower ones."""
    height_jitter_m: float = Field(default=0.0, ge=0.0, le=10.0)
    """Each wall is up to so much higher or lower, in metres."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        for what in ("thickness", "height"):
            size, jitter = getattr(self, f"{what}_m"), getattr(self, f"{what}_jitter_m")
            if jitter > 0.8 * size:
                raise ValueError(
                    f"{what}_jitter_m {jitter} must not exceed 0.8 of {what}_m {size}: "
                    "walls would vanish"
                )
        return self


class DoorsConfig(Config):
    """Narrowed passages with a frame around them."""

    share: Share = 0.15
    """Share of a maze's passages that are doors; rooms and plans have their doors anyway."""
    width_m: Size = 0.9
    """Clear width between the door posts, in metres."""
    height_m: Size = 2.0
    """Height of the opening, in metres; higher walls close above it."""
    offset_m: float = Field(default=0.15, ge=0.0, le=10.0)
    """A door stands up to so much off the middle of its wall, in metres."""
    frame_m: float = Field(default=0.05, ge=0.0, le=1.0)
    """Width of the door posts, and how far they stand out of the wall on both sides, in metres;
    0 for no posts."""


class PillarsConfig(Config):
    """Pillars at the corners of cells."""

    share: Share = 0.2
    """Share of the corners with a wall that carry a pillar; corners without one never do."""
    size_m: SizeRange = (0.25, 0.4)
    """Smallest and largest side or diameter, in metres; every other pillar is round by chance."""


class DentsConfig(Config):
    """Niches and bumps in the faces of walls."""

    share: Share = 0.35
    """Share of the walls that have one."""
    depth_m: SizeRange = (0.04, 0.08)
    """Smallest and largest depth into the wall, or out of it, in metres."""
    width_m: SizeRange = (0.2, 0.6)
    """Smallest and largest width along the wall, in metres."""


class ClutterConfig(Config):
    """Things that stand about, always clear of the robot's way."""

    per_cell: float = Field(default=0.4, ge=0.0, le=20.0)
    """Number of things per cell; one that finds no room in 30 tries is left out."""
    shapes: Annotated[tuple[ClutterShape, ...], Field(strict=False, min_length=1)] = (
        "box",
        "cylinder",
        "table",
        "chair",
        "l_shape",
        "panel",
    )
    """Which things, all equally likely: box, cylinder, table (four legs and a top), chair (four
    legs, seat and back), l_shape, panel (a board that leans over)."""
    size_m: SizeRange = (0.15, 0.6)
    """Smallest and largest side on the floor, in metres; tables and chairs keep to theirs."""
    height_m: SizeRange = (0.15, 1.2)
    """Smallest and largest height, in metres; what is low is felt by the robot but not seen by a
    lidar above it."""


class FloorPatchConfig(Config):
    """A rectangle of floor with its own friction; where patches overlap, the last one counts."""

    x_m: PlaceRange
    """Smallest and largest x, in metres in the map frame."""
    y_m: PlaceRange
    """Smallest and largest y, in metres in the map frame."""
    friction: float = Field(ge=0.0, le=10.0)
    """Coulomb friction coefficient."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.x_m[0] == self.x_m[1] or self.y_m[0] == self.y_m[1]:
            raise ValueError(f"the patch is empty: x_m {list(self.x_m)}, y_m {list(self.y_m)}")
        return self


class FloorConfig(Config):
    """The floor, a plane at z = 0."""

    friction: float = Field(default=0.8, ge=0.0, le=10.0)
    """Coulomb friction coefficient of the floor."""
    patches: Annotated[tuple[FloorPatchConfig, ...], Field(strict=False, max_length=1000)] = ()
    """Rectangles with a friction of their own."""


class StartConfig(Config):
    """Where the robot starts."""

    x_m: Place
    """Position in the map frame, in metres."""
    y_m: Place
    """Position in the map frame, in metres."""
    yaw_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Heading in degrees, counter-clockwise from the x axis."""


class WorldConfig(Config):
    """A world: where walls run, how they are dressed, and where the robot starts."""

    name: str = Field(default="world", min_length=1, max_length=200)
    """What reports call this world."""
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    """Seed of this world alone; without one, the seed of the run."""
    maze: MazeLayout | None = None
    """A labyrinth grown from the seed."""
    rooms: RoomsLayout | None = None
    """An office grown from the seed."""
    plan: PlanLayout | None = None
    """A floor plan drawn in characters."""
    image: ImageLayout | None = None
    """A ROS map_server map."""
    mesh: MeshLayout | None = None
    """A triangle mesh."""
    walls: WallsConfig = WallsConfig()
    """How thick and high walls are."""
    doors: DoorsConfig = DoorsConfig()
    """How wide doors are, and where they stand."""
    pillars: PillarsConfig = PillarsConfig()
    """Pillars at the corners of cells."""
    dents: DentsConfig = DentsConfig()
    """Niches and bumps in walls."""
    clutter: ClutterConfig = ClutterConfig()
    """Things that stand about."""
    floor: FloorConfig = FloorConfig()
    """What the wheels roll on."""
    looks: LooksConfig = LooksConfig()
    """What cameras see: materials, posters, tags, lamps."""
    start: StartConfig | None = None
    """Without one, the robot starts in the first cell, facing the first way out."""
    clearance_m: float = Field(default=0.6, gt=0.0, le=20.0)
    """Everything up to this width is sure to pass everywhere it must go, in metres: the robot's
    diameter and a margin for its controller."""

    @model_validator(mode="before")
    @classmethod
    def _default_layout(cls, data: object) -> object:
        if isinstance(data, dict) and all(data.get(name) is None for name in LAYOUTS):
            return {**data, "maze": MazeLayout()}
        return data

    @model_validator(mode="after")
    def _one_layout(self) -> Self:
        given = [name for name in LAYOUTS if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"a world has one layout, this one has {len(given)}: {given}")
        return self

    @property
    def layout(self) -> MazeLayout | RoomsLayout | PlanLayout | ImageLayout | MeshLayout:
        """The one layout that is given."""
        layouts = (self.maze, self.rooms, self.plan, self.image, self.mesh)
        return next(layout for layout in layouts if layout is not None)
