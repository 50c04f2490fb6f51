"""What a data set is made of: distributions over worlds, robots, sensors, drives and faults; run
configurations composed of base, world, drive and drawn values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from slamsim.config.base import Config
from slamsim.config.loading import SECTIONS
from slamsim.config.merging import Place, Tree
from slamsim.dataset.recipe.distributions import Constant, Distribution, Weight
from slamsim.dataset.recipe.sequence import SPLITS, FormatName, Split
from slamsim.guard.errors import shown
from slamsim.guard.yaml import KeyPath

PARTS = 10_000
"""Shares are whole multiples of one part in so many."""
OWN_LICENCE = "LicenseRef-"
"""With this SPDX begins the names of licences that it does not know."""


def _as_label(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ValueError(
            f"{shown(name)} is not a valid name: letters, digits, - and _, not - or _ first"
        )
    return name


def _as_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError(f"{shown(text)} is not one line of text")
    return text


def _as_licence(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]*", name):
        raise ValueError(
            f"{shown(name)} is not an SPDX identifier, such as CC-BY-4.0; a licence of your own is "
            f"named {OWN_LICENCE}NAME"
        )
    return name


def _some_weigh(variants: tuple[Any, ...]) -> tuple[Any, ...]:
    if not any(variant.weight > 0.0 for variant in variants):
        raise ValueError("all weights are zero: nothing could be chosen")
    return variants


def _no_twins(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise ValueError(f"one is named twice: {', '.join(names)}")
    return names


Label = Annotated[str, Field(max_length=64), AfterValidator(_as_label)]
Line = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_as_line)]
Licence = Annotated[str, Field(max_length=100), AfterValidator(_as_licence)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Source = str | dict[str, Any]
"""Name or path of a file, or what would stand in it."""
Vary = dict[str, Distribution]


def shares_to_parts(shares: dict[Any, float]) -> tuple[int, ...]:
    """The shares in ten-thousandths. ValueError if they are not whole ones, or not 1 in sum."""
    named = ", ".join(f"{name} {share:g}" for name, share in shares.items())
    if abs(sum(shares.values()) - 1.0) > 1e-9:
        raise ValueError(f"the shares must be 1 in sum, not {sum(shares.values()):g} ({named})")
    parts = tuple(round(share * PARTS) for share in shares.values())
    if any(
        abs(part - share * PARTS) > 1e-6 for part, share in zip(parts, shares.values(), strict=True)
    ):
        raise ValueError(f"a share has at most four decimals ({named})")
    return parts


class WorldVariant(Config):
    """A sort of world."""

    world: Source
    """Name or path of a world, or its keys."""
    name: Label | None = None
    """What the catalogue calls it; without one, the name of the file."""
    weight: Weight = 1.0
    """How often it is chosen, relative to the others."""
    vary: Vary = Field(default_factory=dict)
    """What differs from world to world: keys of the world, such as ``maze.rows``."""


class DriveVariant(Config):
    """A sort of drive."""

    drive: Source = "tour"
    """Name or path of a drive, or its keys; laid over those of ``config``."""
    name: Label | None = None
    """What the catalogue calls it; without one, the name of the file."""
    weight: Weight = 1.0
    """How often it is chosen, relative to the others."""
    vary: Vary = Field(default_factory=dict)
    """What differs from sequence to sequence: keys of the drive, such as
    ``limits.max_speed_m_s``."""


class FaultVariant(Config):
    """A fault that recordings may have."""

    fault: str = Field(min_length=1, max_length=4096)
    """Name of a bundled fault, or path of a file that describes one."""
    weight: Weight = 1.0
    """How often it is chosen, relative to the others."""
    size: Distribution | None = None
    """How large, in the unit of the fault's own size; without it, clearly harmful."""


class FaultMix(Config):
    """How many faults a recording has, and which."""

    none: Share = 1.0
    """Share of the recordings that are healthy."""
    one: Share = 0.0
    """Share with one fault."""
    several: Share = 0.0
    """Share with two or more that can be told apart."""
    most: int = Field(default=2, ge=2, le=10)
    """How many several are at most; each number is as likely as the others."""
    choice: Annotated[tuple[FaultVariant, ...], Field(strict=False)] = ()
    """The faults there are."""
    every: bool = False
    """All other bundled faults too, with weight 1 and clearly harmful."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        shares_to_parts({"none": self.none, "one": self.one, "several": self.several})
        named = sum(variant.weight > 0.0 for variant in self.choice)
        if self.none < 1.0 and not (named or self.every):
            raise ValueError("some recordings are to have faults, but choice names none")
        if self.several > 0.0 and named < 2 and not self.every:
            raise ValueError("some recordings are to have several faults, but choice names one")
        names = [variant.fault for variant in self.choice]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"the fault {twice[0]!r} is named twice")
        return self


class Splits(Config):
    """Shares of the worlds for each use; all sequences of a world are in one split."""

    train: Share = 0.8
    """To learn from."""
    val: Share = 0.1
    """To choose settings with."""
    test: Share = 0.1
    """To judge the result with."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        shares_to_parts(self.shares)
        return self

    @property
    def shares(self) -> dict[Split, float]:
        """By name, in the order of ``SPLITS``."""
        return {split: float(getattr(self, split)) for split in SPLITS}


class Recipe(Config):
    """A data set, as far as it is planned; how many sequences are made of it is said later.

    A recipe that was loaded names no files any more: worlds, drives, configuration and presets
    stand in it as they were read, so that it means the same on every machine.
    """

    name: Label
    """What the data set is called."""
    title: Line
    """What it is, in one line; heads the data card."""
    licence: Licence = "CC-BY-4.0"
    """Under which licence the data are given away, as SPDX names it; LicenseRef-NAME for others."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """All that is drawn grows from this number."""
    duration_s: Distribution = Constant(constant=60.0)
    """Length of a recording, in seconds; a route that ends earlier ends it earlier."""
    sequences_per_world: int = Field(default=1, ge=1, le=100_000)
    """How many drives there are through each world."""
    splits: Splits = Splits()
    """Which share of the worlds is for what."""
    formats: Annotated[
        tuple[FormatName, ...], Field(strict=False, min_length=1), AfterValidator(_no_twins)
    ] = (
        "mcap",
        "parquet",
    )
    """What is written of each sequence: mcap (rosbag2), parquet, tum, kitti, carmen; of its cameras
    tum_rgbd, euroc."""
    shard_sequences: int = Field(default=20, ge=1, le=10_000)
    """So many sequences are made one after the other by one worker."""
    config: Source | None = None
    """Name or path of a run configuration from which every sequence starts, or its keys."""
    worlds: Annotated[
        tuple[WorldVariant, ...], Field(strict=False, min_length=1), AfterValidator(_some_weigh)
    ]
    """The sorts of worlds."""
    drives: Annotated[
        tuple[DriveVariant, ...], Field(strict=False, min_length=1), AfterValidator(_some_weigh)
    ] = (DriveVariant(),)
    """The sorts of drives."""
    vary: Vary = Field(default_factory=dict)
    """What differs from sequence to sequence: keys of a run configuration, such as
    ``sensors.lidar`` (a preset's name) or ``robot.lidar.mount.x_m``."""
    presets: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    """Presets that ``vary`` chooses by name, beside the bundled ones: by key path, then name."""
    faults: FaultMix = FaultMix()
    """What is wrong with the recordings on purpose."""


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
