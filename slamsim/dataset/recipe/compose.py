"""Composes a run configuration from base, world, drive and drawn values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from slamsim.config.layers import Place, Tree
from slamsim.config.loading import SECTIONS
from slamsim.dataset.recipe.model import Recipe, Source
from slamsim.guard.yaml import KeyPath

WORLD: KeyPath = ("world",)
DRIVE: KeyPath = ("drive",)
DRAWN = Place(None, option="the recipe")


@dataclass(frozen=True, slots=True)
class Bases:
    """What a recipe starts from, with the places where it was written as far as they are known.

    config: of every sequence. worlds and drives: of each variant, at ``world`` and ``drive``.
    presets: by key path and name. places: of the keys that vary, by key path.
    """

    config: Tree
    worlds: tuple[Tree, ...]
    drives: tuple[Tree, ...]
    presets: Mapping[str, Mapping[str, Tree]]
    places: Mapping[str, Place] = field(default_factory=dict)

    @classmethod
    def of(cls, recipe: Recipe) -> Self:
        """Of a recipe that names no files."""
        return cls(
            config=Tree(_keys(recipe.config or {})),
            worlds=tuple(Tree({"world": _keys(variant.world)}) for variant in recipe.worlds),
            drives=tuple(Tree({"drive": _keys(variant.drive)}) for variant in recipe.drives),
            presets={
                key: {
                    name: Tree().overlaid(key_path(key), data, DRAWN) for name, data in by.items()
                }
                for key, by in recipe.presets.items()
            },
        )


def composed(bases: Bases, world: int, drive: int, values: Mapping[str, object]) -> Tree:
    """The configuration of one sequence; later values are laid over earlier ones."""
    tree = bases.config.replaced(WORLD, bases.worlds[world]).merged(bases.drives[drive])
    for key, value in values.items():
        place = bases.places.get(key, DRAWN)
        if isinstance(value, str) and key_path(key) in SECTIONS:
            tree = tree.replaced(key_path(key), bases.presets[key][value])
        else:
            tree = tree.overlaid(tree.with_indices(tuple(key.split(".")), place), value, place)
    return tree


def key_path(key: str) -> KeyPath:
    """``"robot.lidar"`` as a path."""
    return tuple(key.split("."))


def _keys(source: Source) -> dict[str, Any]:
    if isinstance(source, str):
        raise ValueError(f"the recipe still names the file {source!r}: load it with load_recipe")
    return source
