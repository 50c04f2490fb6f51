"""The parameters of one scenario, or of several, with the seed: from files and ``--set``.

For one scenario the keys are its own; for several each has a section of its name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from pydantic import Field, create_model

from slamsim.config.base import Config
from slamsim.config.bundled import Kind, bundled_folder, find_input
from slamsim.config.loading import SECTIONS, overridden, validated, with_presets
from slamsim.config.merging import Place, Tree, mount
from slamsim.guard.yaml import KeyPath, load_yaml

_KIND: Kind = "configs/scenarios"

Types = Mapping[str, type[Config]]
"""The model of each scenario that is to be run, by the scenario's key."""


class Seeded(Config):
    """The parameters of a run of scenarios."""

    seed: int = Field(default=0, ge=0, lt=2**63)
    """All that is random grows from this number."""


def load_scenarios(
    types: Types, config: str | None = None, overrides: Sequence[str] = (), seed: int | None = None
) -> Seeded:
    """The parameters of all of them as one model that can be saved.

    config: name or path of a file whose keys are laid over the bundled ones. What comes later
    wins: bundled files, config, overrides in their order, seed. Raises as ``load_model`` does.
    """
    several = len(types) > 1
    sections = _sections(types, several)
    tree = Tree()
    for key in types:
        path = bundled_folder(_KIND) / f"{key}.yaml"
        tree = tree.merged(mount(load_yaml(path), (key,) if several else ()))
    tree = with_presets(tree, sections)
    if config is not None:
        tree = with_presets(_laid(tree, mount(load_yaml(find_input(_KIND, config)))), sections)
    for text in overrides:
        tree = overridden(tree, text, sections)
    if seed is not None:
        tree = tree.overlaid(("seed",), seed, Place(None, option=f"--seed {seed}"))
    return validated(_whole(types, several), tree)


def parts_of(types: Types, whole: Seeded) -> dict[str, Config]:
    """The parameters of each scenario, as its own model."""
    if len(types) > 1:
        return {key: getattr(whole, key) for key in types}
    ((key, model),) = types.items()
    return {key: model(**{name: getattr(whole, name) for name in model.model_fields})}


def _sections(types: Types, several: bool) -> dict[KeyPath, Kind]:
    """Where a file's name may stand for a mapping."""
    found: dict[KeyPath, Kind] = {(key,): _KIND for key in types} if several else {}
    for key, model in types.items():
        at: KeyPath = (key,) if several else ()
        for path, kind in SECTIONS.items():
            if path[0] in model.model_fields:
                found[(*at, *path)] = kind
    return found


def _whole(types: Types, several: bool) -> type[Seeded]:
    if several:
        fields: dict[str, Any] = {key: (model, model()) for key, model in types.items()}
        return create_model("Scenarios", __base__=Seeded, **fields)
    (model,) = types.values()
    return cast(type[Seeded], create_model(model.__name__, __base__=(model, Seeded)))


def _laid(tree: Tree, top: Tree, at: KeyPath = ()) -> Tree:
    """With ``top`` laid over it key by key; what starts from a preset stands for itself."""
    value = top.get(at)
    if isinstance(value, dict) and "preset" not in value and isinstance(tree.get(at), dict):
        for key in value:
            tree = _laid(tree, top, (*at, key))
        return tree
    return tree.replaced(at, top.section(at))
