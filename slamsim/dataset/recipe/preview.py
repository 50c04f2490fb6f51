"""A contact sheet: worlds of a recipe from above, with their planned routes."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from slamsim.core.progress import Progress, silent
from slamsim.core.types import FloatArray
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import Cell, SequenceSpec, Split
from slamsim.guard.errors import SlamsimError
from slamsim.guard.quantities import with_unit, words_of
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.pilot import stop_at_s
from slamsim.sim.drive.route import plan_route
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world
from slamsim.world.model import World
from slamsim.world.preview import Colour, Image, Way, encoded_png, top_view, write_text

MOST_WAYS = 3
"""So many sequences of each world are drawn and told."""

_SPLIT: Mapping[Split, Colour] = {
    "train": (196, 156, 82),
    "val": (72, 160, 236),
    "test": (110, 176, 92),
}
_WAYS: tuple[Colour, ...] = ((200, 90, 20), (30, 130, 220), (60, 150, 60))
_WHITE: Colour = (255, 255, 255)
_LATER: Colour = (225, 215, 205)
_PICTURE_PX, _TILE_PX, _BAND_PX, _GAP_PX = 360, 400, 22, 10
_LINE_PX, _LETTERS, _LINES, _SCALE = 15, 62, 10, 0.38
"""Of the text below a tile: height of a line, letters in it, lines, and scale of the font."""
_SECTION = r"^world\.(maze\.|rooms\.)?"
_CREEP_M_S = 0.05
"""Least speed that a planned path is taken to be driven with, so that its end is reached."""


def contact_sheet(recipe: Recipe, worlds: int, progress: Progress = silent) -> bytes:
    """The first worlds of a recipe as one PNG; a world that cannot be built is told in words.

    In colour what is driven in the time of the sequence, pale what the route has beyond. The band
    above a world names its split. All worlds have one scale, which a bar in each shows.
    """
    sequences = [_sequences(recipe, world_index) for world_index in range(worlds)]
    built = [_world_of(specs[0]) for specs in sequences]
    longest_m = max((_longest_m(one) for one in built if isinstance(one, World)), default=1.0)
    tiles = []
    for done, (specs, world) in enumerate(zip(sequences, built, strict=True)):
        tiles.append(_tile(specs, world, longest_m))
        progress(done + 1, worlds)
    columns = min(max(round((worlds * 1.4) ** 0.5), 1), worlds)
    missing = -worlds % columns
    blank = np.full_like(tiles[0], 255)
    rows = np.array([*tiles, *[blank] * missing]).reshape(-1, columns, *blank.shape)
    sheet = np.vstack([np.hstack(list(row)) for row in rows])
    return encoded_png(sheet)


def _sequences(recipe: Recipe, world_index: int) -> list[SequenceSpec]:
    """Those of one world that are drawn."""
    first, count = world_index * recipe.sequences_per_world, recipe.sequences_per_world
    indices = range(first, first + min(count, MOST_WAYS))
    return [sequence_spec(recipe, index, first + count) for index in indices]


def _world_of(spec: SequenceSpec) -> World | SlamsimError:
    try:
        return build_world(spec.config.world, spec.config.seed)
    except SlamsimError as error:
        return error


def _longest_m(world: World) -> float:
    x_min, y_min, x_max, y_max = world.bounds_m
    return max(x_max - x_min, y_max - y_min)


def _tile(specs: Sequence[SequenceSpec], world: World | SlamsimError, longest_m: float) -> Image:
    height = _BAND_PX + _PICTURE_PX + _LINES * _LINE_PX + 2 * _GAP_PX
    tile: Image = np.full((height, _TILE_PX, 3), 255, dtype=np.uint8)
    first = specs[0]
    tile[:_BAND_PX, : _TILE_PX - _GAP_PX] = _SPLIT[first.split]
    title = f"{first.split}   world {first.world_index}   {_in_words(first.drawn['world'])}"
    write_text(tile, title, (6, _BAND_PX - 7), 0.45)
    words = [(text, _WHITE) for text in _told(first)]
    try:
        if isinstance(world, SlamsimError):
            raise world
        picture = _picture(specs, world, longest_m)
    except SlamsimError as error:
        words = [(text, _WHITE) for text in textwrap.wrap(str(error), _LETTERS)]
    else:
        rows, columns = picture.shape[:2]
        x, y = (_TILE_PX - _GAP_PX - columns) // 2, _BAND_PX + (_PICTURE_PX - rows) // 2
        tile[y : y + rows, x : x + columns] = picture
        _scale_bar(tile, longest_m)
    captions = [
        line
        for spec, colour in zip(specs, _WAYS, strict=False)
        for line in zip(_caption(spec), (colour, _WHITE), strict=False)
    ]
    words = [*words[: _LINES - len(captions)], *captions]
    for line, (text, colour) in enumerate(words):
        y = _BAND_PX + _PICTURE_PX + 22 + line * _LINE_PX
        tile[y - 6 : y - 2, 4:16] = colour
        write_text(tile, text, (4 if colour == _WHITE else 22, y), _SCALE)
    return tile


def _scale_bar(tile: Image, longest_m: float) -> None:
    """A round number of metres, about a sixth of the picture."""
    power = 10.0 ** np.floor(np.log10(longest_m / 6.0))
    metres = power * max(n for n in (1, 2, 5) if n * power <= longest_m / 6.0)
    length = round((_PICTURE_PX - 10) * metres / longest_m)
    y = _BAND_PX + _PICTURE_PX + 4
    tile[y : y + 2, 4 : 4 + length] = 60
    write_text(tile, f"{metres:g} m", (8 + length, y + 5), _SCALE)


def _picture(specs: Sequence[SequenceSpec], world: World, longest_m: float) -> Image:
    later, now = list[Way](), list[Way]()
    for spec, colour in zip(specs, _WAYS, strict=False):
        robot, drive = build_robot(spec.config.robot), spec.config.drive
        route = plan_route(world, robot, drive)
        if not route.legs:
            continue
        line_m, driven = _driven(route, stop_at_s(drive) - drive.follow.standstill_s)
        later.append(Way(line_m, _LATER))
        now.append(Way(line_m[:driven], colour, 2))
    return top_view(world, _PICTURE_PX - 10, [*later, *now], longest_m)


def _driven(route: Route, time_s: float) -> tuple[FloatArray, int]:
    """The line (n, 2) of a route, and how many of its points are passed in so much driving."""
    line_m, times_s = list[FloatArray](), list[FloatArray]()
    for leg in route.legs:
        steps_m = np.linalg.norm(np.diff(leg.points_m, axis=0, prepend=leg.points_m[:1]), axis=1)
        step_s = steps_m / np.maximum(leg.speeds_m_s, _CREEP_M_S)
        step_s[-1] += leg.rest_s
        line_m.append(leg.points_m)
        times_s.append(step_s)
    passed_s = np.cumsum(np.concatenate(times_s))
    return np.concatenate(line_m), max(int(np.searchsorted(passed_s, time_s)), 1)


def _told(spec: SequenceSpec) -> list[str]:
    """What the world was drawn with, in words, no number apart from its unit."""
    drawn = {key: cell for key, cell in spec.drawn.items() if key.startswith("world.")}
    parts = (
        " ".join(with_unit(re.sub(_SECTION, "", key).replace(".", "_"), _in_words(cell)))
        for key, cell in drawn.items()
    )
    kept_whole = ", ".join(part.replace(" ", "\N{NO-BREAK SPACE}") for part in parts)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(kept_whole, _LETTERS)]


def _in_words(cell: Cell) -> Cell:
    return words_of(cell) if isinstance(cell, str) else cell


def _caption(spec: SequenceSpec) -> list[str]:
    """A line on the drive, and one on the faults if there are any."""
    named = (str(spec.drawn[key]) for key in ("robot", "sensors.lidar") if key in spec.drawn)
    duration = f"{spec.config.drive.route.max_duration_s:g} s"
    drive = _in_words(spec.drawn["drive"])
    lines = [f"{spec.index:06d} {', '.join((str(drive), duration, *named))}"]
    if spec.config.faults:
        lines.append(f"       {' + '.join(choice.name for choice in spec.config.faults)}")
    return [line[:_LETTERS] for line in lines]
