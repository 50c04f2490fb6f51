"""Configurations at the edges of what a recipe may draw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from pydantic import ValidationError

from slamsim.config.loading import validated
from slamsim.config.run import RunConfig
from slamsim.dataset.recipe.distributions import Distribution, edges
from slamsim.dataset.recipe.draw import Draft, config_tree, draw, in_order
from slamsim.dataset.recipe.model import Bases, Recipe
from slamsim.guard.errors import SlamsimError


def edge_drafts(recipe: Recipe) -> Iterator[Draft]:
    """Each value at the edge of its distribution once, the others as they usually are.

    Every world is tried with the first drive, and every drive in the first world.
    """
    usual = replace(draw(recipe, 0), world=0, drive=0, duration_s=edges(recipe.duration_s)[0])
    common = in_order("", recipe.vary)
    first_world = in_order("world.", recipe.worlds[0].vary)
    first_drive = in_order("drive.", recipe.drives[0].vary)
    for duration_s in edges(recipe.duration_s):
        yield from _edges(replace(usual, duration_s=duration_s), {}, {})
    for world, variant in enumerate(recipe.worlds):
        own = in_order("world.", variant.vary)
        yield from _edges(replace(usual, world=world), own, {**common, **first_drive})
    for drive, drive_variant in enumerate(recipe.drives):
        own = in_order("drive.", drive_variant.vary)
        yield from _edges(replace(usual, drive=drive), own, {**first_world, **common})
    yield from _edges(usual, common, {**first_world, **first_drive})


def _edges(
    draft: Draft, tried: Mapping[str, Distribution], others: Mapping[str, Distribution]
) -> Iterator[Draft]:
    every = {**others, **tried}
    usual = {key: edges(distribution)[0] for key, distribution in every.items()}
    yield replace(draft, values=usual)
    for key, distribution in tried.items():
        for edge in edges(distribution)[1:]:
            yield replace(draft, values={**usual, key: edge})


def tried(recipe: Recipe, draft: Draft, bases: Bases) -> RunConfig:
    """The configuration, checked. Raises what ``validated`` raises.

    bases: with the places that are then told.
    """
    with suppress(ValidationError, SlamsimError):
        return RunConfig.model_validate(config_tree(recipe, draft, Bases.of(recipe)).data)
    return validated(RunConfig, config_tree(recipe, draft, bases))
