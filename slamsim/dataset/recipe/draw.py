"""Draws a sequence from a recipe and an index, independently of the size of the data set."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import gcd

from pydantic import ValidationError

from slamsim.config.explain import refusal
from slamsim.config.faults import FaultChoice
from slamsim.config.merging import Place, Tree
from slamsim.config.run import RunConfig
from slamsim.core.randomness import random_bits, random_share
from slamsim.dataset.recipe.distributions import Distribution, Listed, pick
from slamsim.dataset.recipe.model import (
    DRAWN,
    PARTS,
    Bases,
    FaultMix,
    FaultVariant,
    Recipe,
    Splits,
    composed,
    shares_to_parts,
)
from slamsim.dataset.recipe.sequence import SPLITS, Cell, SequenceSpec, Split
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import load_fault

Names = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Draft:
    """What the recipe draws for one index.

    world and drive: places of the variants in the recipe. values: by key path of a run
    configuration, in the order in which they are laid over one another.
    """

    index: int
    world_index: int
    split: Split
    world: int
    drive: int
    duration_s: object
    faults: tuple[FaultChoice, ...]
    values: Mapping[str, object]


def sequence_spec(recipe: Recipe, index: int, count: int) -> SequenceSpec:
    """The sequence of this index in a data set of ``count``; only ``index`` shapes it.

    recipe: as ``load_recipe`` gives it. Raises SlamsimError where what was drawn does not fit
    together, and ValueError for an index that the data set does not have.
    """
    if not 0 <= index < count:
        raise ValueError(f"there is no sequence {index} among {count}")
    draft = draw(recipe, index)
    return SequenceSpec(
        index=index,
        name=f"{draft.split}/{index:06d}",
        split=draft.split,
        world_index=draft.world_index,
        config=_config(recipe, draft),
        formats=recipe.formats,
        drawn=drawn_cells(recipe, draft),
    )


def draw(recipe: Recipe, index: int) -> Draft:
    """What is drawn for one index, each thing from random numbers of its own."""
    world_index = index // recipe.sequences_per_world
    of_world, of_sequence = ("world", str(world_index)), ("sequence", str(index))
    seed = recipe.seed
    world = pick(
        tuple(variant.weight for variant in recipe.worlds), _share(seed, (*of_world, "which"))
    )
    drive = pick(
        tuple(variant.weight for variant in recipe.drives), _share(seed, (*of_sequence, "drive"))
    )
    values = {
        **_values(seed, of_world, "world.", recipe.worlds[world].vary),
        **_values(seed, of_sequence, "", recipe.vary),
        **_values(seed, of_sequence, "drive.", recipe.drives[drive].vary),
    }
    return Draft(
        index=index,
        world_index=world_index,
        split=split_of(recipe.splits, world_index),
        world=world,
        drive=drive,
        duration_s=_value(seed, (*of_sequence, "duration_s"), recipe.duration_s),
        faults=_faults(recipe.faults, seed, of_sequence),
        values=values,
    )


def drawn_cells(recipe: Recipe, draft: Draft) -> dict[str, Cell]:
    """What was drawn, by key path, lists place by place."""
    cells: dict[str, Cell] = {
        "world": recipe.worlds[draft.world].name,
        "drive": recipe.drives[draft.drive].name,
        "duration_s": _as_float(draft.duration_s),
    }
    for key, value in draft.values.items():
        cells.update(_cells(key, value))
    return cells


def split_of(splits: Splits, world_index: int) -> Split:
    """The split of a world.

    Among the first n worlds, for every n, each split has its share to within 3/4 of a world
    (Tijdeman 1980, the chairman assignment problem).
    """
    order = _split_order(shares_to_parts(splits.shares))
    return SPLITS[order[world_index % len(order)]]


def split_counts(recipe: Recipe, count: int) -> dict[Split, int]:
    """How many of the first ``count`` sequences are in each split."""
    order = _split_order(shares_to_parts(recipe.splits.shares))
    per_world = recipe.sequences_per_world
    rounds, rest = divmod(count, per_world * len(order))
    numbers = {split: rounds * per_world * order.count(i) for i, split in enumerate(SPLITS)}
    for world in range(-(-rest // per_world)):
        numbers[SPLITS[order[world]]] += min(per_world, rest - world * per_world)
    return numbers


@lru_cache(maxsize=16)
def _split_order(parts: tuple[int, ...]) -> tuple[int, ...]:
    """Which split each world of one period goes to."""
    used = [which for which, part in enumerate(parts) if part > 0]
    spare = PARTS / (2 * len(used) - 2) if len(used) > 1 else 0.0
    given, order = dict.fromkeys(used, 0), list[int]()
    for number in range(1, PARTS // gcd(*parts) + 1):
        behind = {which: parts[which] * number - PARTS * given[which] for which in used}
        chosen = min(
            (which for which in used if behind[which] >= spare),
            key=lambda which: (PARTS - spare - behind[which]) / parts[which],
        )
        given[chosen] += 1
        order.append(chosen)
    return tuple(order)


def _share(seed: int, names: Names) -> float:
    return random_share(seed, "dataset", *names)


def _value(seed: int, names: Names, distribution: Distribution) -> object:
    if isinstance(distribution, Listed):
        return [
            _value(seed, (*names, str(place)), inner)
            for place, inner in enumerate(distribution.listed)
        ]
    return distribution.value(_share(seed, names))


def _values(
    seed: int, names: Names, prefix: str, vary: Mapping[str, Distribution]
) -> dict[str, object]:
    return {
        key: _value(seed, (*names, key), distribution)
        for key, distribution in in_order(prefix, vary).items()
    }


def in_order(prefix: str, vary: Mapping[str, Distribution]) -> dict[str, Distribution]:
    """By key path of a run configuration; a section comes before its keys."""
    keys = sorted(vary, key=lambda key: (key.count("."), key))
    return {f"{prefix}{key}": vary[key] for key in keys}


def _faults(mix: FaultMix, seed: int, names: Names) -> tuple[FaultChoice, ...]:
    """Such that each of them can be told beside the others."""
    chosen: list[FaultVariant] = []
    for place in range(_fault_count(mix, seed, names)):
        apart = [variant for variant in mix.choice if _joins(variant, chosen)]
        if not any(variant.weight > 0.0 for variant in apart):
            break
        weights = tuple(variant.weight for variant in apart)
        chosen.append(apart[pick(weights, _share(seed, (*names, "fault", str(place))))])
    return tuple(
        FaultChoice(name=variant.fault, size=_size(variant, seed, names)) for variant in chosen
    )


def _fault_count(mix: FaultMix, seed: int, names: Names) -> int:
    several = pick((1.0,) * (mix.most - 1), _share(seed, (*names, "several"))) + 2
    shares = (mix.none, mix.one, mix.several)
    return (0, 1, several)[pick(shares, _share(seed, (*names, "faults")))]


def _joins(variant: FaultVariant, chosen: Iterable[FaultVariant]) -> bool:
    return all(
        variant is not other and _fault(variant.fault).told_apart(_fault(other.fault))
        for other in chosen
    )


def _size(variant: FaultVariant, seed: int, names: Names) -> float | None:
    if variant.size is None:
        return _fault(variant.fault).size
    size = _value(seed, (*names, "size", variant.fault), variant.size)
    return _as_float(size)


@lru_cache(maxsize=1000)
def _fault(name: str) -> Fault:
    return load_fault(name)


def _config(recipe: Recipe, draft: Draft) -> RunConfig:
    tree = config_tree(recipe, draft, Bases.of(recipe))
    try:
        return RunConfig.model_validate(tree.data)
    except ValidationError as error:
        place = Place(None, option=f"sequence {draft.index} of {recipe.name}")
        raise refusal(RunConfig, Tree(tree.data, {(): place}), error) from None


def config_tree(recipe: Recipe, draft: Draft, bases: Bases) -> Tree:
    """The configuration of a draft, not yet checked, with seeds, length, faults, and textures of
    its split."""
    tree = composed(bases, draft.world, draft.drive, draft.values)
    of_sequence = ("dataset", "sequence", str(draft.index))
    of_world = ("dataset", "world", str(draft.world_index))
    for path, value in (
        (("seed",), random_bits(recipe.seed, *of_sequence) >> 1),
        (("world", "seed"), random_bits(recipe.seed, *of_world) >> 1),
        (("drive", "route", "seed"), random_bits(recipe.seed, *of_sequence, "route") >> 1),
        (("faults",), [choice.model_dump() for choice in draft.faults]),
        (("drive", "route", "max_duration_s"), draft.duration_s),
        (("world", "looks", "split"), "test" if draft.split == "test" else "train"),
    ):
        tree = tree.overlaid(path, value, DRAWN)
    return tree


def _as_float(value: object) -> float:
    assert isinstance(value, int | float)  # held by the loading
    return float(value)


def _cells(key: str, value: object) -> Iterator[tuple[str, Cell]]:
    if isinstance(value, list | tuple):
        for place, inner in enumerate(value):
            yield from _cells(f"{key}[{place}]", inner)
    elif value is None or isinstance(value, str | int | float | bool):
        yield key, value
    else:
        yield key, json.dumps(value, sort_keys=True)
