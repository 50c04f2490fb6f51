"""Loads and validates a recipe.

The files that it names are read into it. Then configurations at the edges of every distribution,
and some random ones, are checked as any other configuration is, so that a value which its key
does not take is told with the line of the recipe that says it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from slamsim.config.bundled import find_input
from slamsim.config.faults import FaultChoice
from slamsim.config.loading import SECTIONS, located, section_tree, validated, with_presets
from slamsim.config.merging import Place, Tree, mount
from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.config.world import WorldConfig
from slamsim.dataset.recipe.distributions import edges
from slamsim.dataset.recipe.draw import Draft, draw
from slamsim.dataset.recipe.model import (
    DRIVE,
    WORLD,
    Bases,
    FaultVariant,
    Recipe,
    Source,
    Vary,
    key_path,
)
from slamsim.dataset.recipe.probes import edge_drafts, tried
from slamsim.dataset.recipe.sequence import ImageFormat
from slamsim.guard.errors import NotFound, SlamsimError, shown
from slamsim.guard.yaml import KeyPath, load_yaml
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults, resolved_choice
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sim.robot.describe import describe
from slamsim.sim.robot.model import build_robot, refuse_faulty
from slamsim.world.build import check_sizes

RANDOM_PROBES = 16
"""Sequences that are drawn and checked whole, beside the edges of each distribution."""

MOST_S = 86_400.0
"""A day: no recording is longer."""

_TOP = "at the top level of the recipe"
_NOT_VARIED: dict[KeyPath, str] = {
    ("seed",): f"is every sequence's own; the recipe's seed is 'seed' {_TOP}",
    ("world", "seed"): f"is every world's own; the recipe's seed is 'seed' {_TOP}",
    ("drive", "route", "seed"): f"is every sequence's own; the recipe's seed is 'seed' {_TOP}",
    ("drive", "route", "max_duration_s"): f"is said by 'duration_s' {_TOP}",
    ("faults",): f"is said by 'faults' {_TOP}",
    ("world", "looks", "split"): "follows the split that the world is in",
    ("slam",): "is not part of a recording",
    ("mapping",): "is not part of a recording",
}


def load_recipe(name_or_path: str) -> Recipe:
    """The recipe of that file, or the bundled one of that name, with all files read into it.

    Raises NotFound and InputRefused, naming file, line and key, for whatever could not be made.
    """
    tree = mount(load_yaml(find_input("configs/datasets", name_or_path)))
    given = validated(Recipe, tree)
    _check_keys(given, tree)
    _check_duration(given, tree)
    bases = _bases(given, tree)
    recipe = _with_files(_with_faults(given, tree), bases)
    robots, worlds = set[RobotConfig](), set[WorldConfig]()
    for draft in (*edge_drafts(recipe), *(draw(recipe, index) for index in range(RANDOM_PROBES))):
        places = dict(_places(recipe, tree, draft.world, draft.drive))
        config = tried(recipe, draft, replace(bases, places=places))
        _check_formats(recipe, config, tree)
        if config.robot not in robots:
            robots.add(config.robot)
            _check_robot(config.robot, draft, tree)
        if config.world not in worlds:
            worlds.add(config.world)
            _check_world(config.world, draft, tree)
    return recipe


def _check_formats(recipe: Recipe, config: RunConfig, tree: Tree) -> None:
    """That there is a camera for what only cameras have."""
    of_images = [name for name in recipe.formats if name in get_args(ImageFormat)]
    sensors = config.sensors.additional
    if of_images and not any(isinstance(each, CameraEntry) and each.enabled for each in sensors):
        reason = f"{of_images[0]} holds images, but sensors.additional has no camera"
        raise tree.place_of(("formats",)).refusal(("formats",), reason)


def _check_robot(robot: RobotConfig, draft: Draft, tree: Tree) -> None:
    try:
        if robot.urdf_file is None:
            refuse_faulty(describe(robot), f"robot {robot.name}", robot.max_contact_gap_m)
        else:
            build_robot(robot)
    except SlamsimError as error:
        raise tree.place_of(("vary",)).refusal(
            ("vary",), f"{error}{_drawn(draft, 'robot')}"
        ) from None


def _check_world(world: WorldConfig, draft: Draft, tree: Tree) -> None:
    at: KeyPath = ("worlds", draft.world)
    try:
        check_sizes(world, draft.world_index)
    except SlamsimError as error:
        raise tree.place_of(at).refusal(at, f"{error}{_drawn(draft, 'world')}") from None


def _drawn(draft: Draft, section: str) -> str:
    """What a draft has in a section, to be told of a fault there."""
    values = [f"{key} = {value}" for key, value in draft.values.items() if key.startswith(section)]
    return f", where {', '.join(values)}" if values else ""


def _varied(recipe: Recipe) -> Iterator[tuple[KeyPath, KeyPath, Vary]]:
    """Every mapping of distributions: where it stands, and which keys it begins at."""
    yield ("vary",), (), recipe.vary
    for i, world in enumerate(recipe.worlds):
        yield ("worlds", i, "vary"), WORLD, world.vary
    for i, drive in enumerate(recipe.drives):
        yield ("drives", i, "vary"), DRIVE, drive.vary


def _check_keys(recipe: Recipe, tree: Tree) -> None:
    """That nothing varies which the recipe says elsewhere, or not at all."""
    for at, begin, vary in _varied(recipe):
        for key in vary:
            path, place = (*begin, *key_path(key)), tree.place_of((*at, key))
            for fixed, reason in _NOT_VARIED.items():
                if path[: len(fixed)] == fixed:
                    raise place.refusal((*at, key), f"cannot vary: it {reason}")
            if begin == () and path[:1] in (WORLD, DRIVE) and (path == DRIVE or path[0] != "drive"):
                reason = f"cannot vary here: list {path[0]}s under {path[0]!r}"
                raise place.refusal((*at, key), reason)
            if str(path[-1]).split("_")[-1] == "file":
                reason = "cannot vary: give each file a variant of its own"
                raise place.refusal((*at, key), reason)
    chosen_by_name = [".".join(map(str, path)) for path in SECTIONS]
    for key in recipe.presets:
        if key not in chosen_by_name:
            reason = f"is not chosen by name; {', '.join(chosen_by_name)} are"
            raise tree.place_of(("presets", key)).refusal(("presets", key), reason)


def _check_duration(recipe: Recipe, tree: Tree) -> None:
    at: KeyPath = ("duration_s",)
    for value in edges(recipe.duration_s):
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not 0.0 < value <= MOST_S
        ):
            reason = f"must be more than 0 and at most {MOST_S:g} seconds, not {shown(value)}"
            raise tree.place_of(at).refusal(at, reason)


def _bases(recipe: Recipe, tree: Tree) -> Bases:
    """Every file that the recipe names, read, each value with its place."""
    config = Tree() if recipe.config is None else _read(tree, ("config",), (), recipe.config)
    worlds = (
        _read(tree, ("worlds", i, "world"), WORLD, variant.world)
        for i, variant in enumerate(recipe.worlds)
    )
    drives = (
        _read(tree, ("drives", i, "drive"), DRIVE, variant.drive)
        for i, variant in enumerate(recipe.drives)
    )
    return Bases(config, tuple(worlds), tuple(drives), _presets(recipe, tree))


def _read(tree: Tree, source: KeyPath, at: KeyPath, given: Source) -> Tree:
    """What the recipe has, or names, at ``source``, as if it stood at ``at``."""
    place = tree.place_of(source)
    try:
        if isinstance(given, str) and not at:
            return located(with_presets(section_tree("configs", given, place, at)))
        return located(with_presets(_moved(tree, source, at, given)))
    except NotFound as error:
        raise place.refusal(source, str(error)) from None


def _moved(tree: Tree, source: KeyPath, at: KeyPath, given: Source) -> Tree:
    places = {
        (*at, *path[len(source) :]): place
        for path, place in tree.places.items()
        if path[: len(source)] == source
    }
    if isinstance(given, dict) and not at:
        return Tree(given, places)
    place = tree.place_of(source)
    return Tree(Tree().overlaid(at, given, place).data, {at: place, **places})


def _presets(recipe: Recipe, tree: Tree) -> Mapping[str, Mapping[str, Tree]]:
    """By key path and name, every section that a key may choose; those of the recipe first."""
    found: dict[str, dict[str, Tree]] = {}
    for at, begin, vary in _varied(recipe):
        for key, distribution in vary.items():
            path = (*begin, *key_path(key))
            if path not in SECTIONS:
                continue
            text = ".".join(map(str, path))
            for name in edges(distribution):
                if not isinstance(name, str):
                    continue
                own = recipe.presets.get(text, {}).get(name)
                source = (*at, key) if own is None else ("presets", text, name)
                section = _read(tree, source, path, name if own is None else own)
                found.setdefault(text, {})[name] = section
    return found


def _with_files(recipe: Recipe, bases: Bases) -> Recipe:
    """The recipe with everything in it that it named."""
    worlds = (
        one.model_copy(update={"world": _keys(base, WORLD), "name": one.name or _name(one.world)})
        for one, base in zip(recipe.worlds, bases.worlds, strict=True)
    )
    drives = (
        one.model_copy(update={"drive": _keys(base, DRIVE), "name": one.name or _name(one.drive)})
        for one, base in zip(recipe.drives, bases.drives, strict=True)
    )
    presets = {
        key: {name: _keys(base, key_path(key)) for name, base in by_name.items()}
        for key, by_name in bases.presets.items()
    }
    return recipe.model_copy(
        update={
            "config": None if recipe.config is None else bases.config.data,
            "worlds": tuple(worlds),
            "drives": tuple(drives),
            "presets": presets,
        }
    )


def _keys(tree: Tree, at: KeyPath) -> object:
    return tree.get(at) or {}


def _name(source: Source) -> str:
    """A label after the file."""
    text = Path(source).stem if isinstance(source, str) else str(source.get("name", ""))
    return re.sub(r"[^A-Za-z0-9_-]+|^[_-]+", "", text)[:64] or "own"


def _places(recipe: Recipe, tree: Tree, world: int, drive: int) -> Iterator[tuple[str, Place]]:
    """Where each key is said to vary, for one variant of world and drive."""
    for at, begin, vary in _varied(recipe):
        if at in (("vary",), ("worlds", world, "vary"), ("drives", drive, "vary")):
            for key in vary:
                yield ".".join((*map(str, begin), key)), tree.place_of((*at, key))


def _with_faults(recipe: Recipe, tree: Tree) -> Recipe:
    """With the files of faults named such that they are found from any folder.

    Raises InputRefused for a fault that there is not, or not in a size that it may get.
    """
    variants = []
    for i, variant in enumerate(recipe.faults.choice):
        at: KeyPath = ("faults", "choice", i)
        place = tree.place_of((*at, "fault"))
        place.require_own((*at, "fault"), variant.fault)
        sizes = () if variant.size is None else edges(variant.size)
        try:
            for size in sizes or (None,):
                choice = FaultChoice.model_validate({"name": variant.fault, "size": size})
                name = resolved_choice(choice, place.folder).name
        except ValidationError:
            reason = "a fault's size is a number"
            raise tree.place_of((*at, "size")).refusal((*at, "size"), reason) from None
        except SlamsimError as error:
            raise place.refusal((*at, "fault"), str(error)) from None
        variants.append(variant.model_copy(update={"fault": name}))
    if recipe.faults.every:
        named = {variant.fault for variant in variants}
        # Faults of cameras are named by the recipes that have cameras.
        others = (each for each in bundled_faults() if not isinstance(each, CameraFault))
        variants += [FaultVariant(fault=each.name) for each in others if each.name not in named]
    faults = recipe.faults.model_copy(update={"choice": tuple(variants), "every": False})
    return recipe.model_copy(update={"faults": faults})
