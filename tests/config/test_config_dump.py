"""A configuration written out explains itself and reads back bit for bit."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.bundled import bundled_names
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.loading import load_model, load_run_config
from slamsim.config.run import RunConfig
from slamsim.guard.yaml import parse_yaml


class Colour(Enum):
    RED = "red"
    BLUE = "no"


class Inner(Config):
    """What an inner thing is."""

    share: float = 0.5
    """A share."""
    names: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Names."""


class Outer(Config):
    """All kinds of values."""

    number: float = 1e-5
    """A number, described in so many words that the line must be broken somewhere, because
    nobody reads lines that are longer than about a hundred characters."""
    count: int = 3
    """A count."""
    switch: bool = True
    """Whether."""
    text: str = "plain"
    """A text."""
    maybe: float | None = None
    """Perhaps a number."""
    kind: Literal["yes", "off"] = "yes"
    """A word that YAML 1.1 takes for something else."""
    colour: Annotated[Colour, Field(strict=False)] = Colour.BLUE
    """An enumeration."""
    pair: Annotated[tuple[float, float], Field(strict=False)] = (0.1, 2e300)
    """Two numbers."""
    inner: Inner = Inner()
    others: Annotated[tuple[Inner, ...], Field(strict=False)] = ()
    """Many."""
    by_name: dict[str, Inner] = Field(default_factory=dict)
    """One each."""


def read_back(config: Config, folder: Path) -> Config:
    path = folder / "config.yaml"
    path.write_text(dump_commented_yaml(config), encoding="utf-8")
    return load_model(type(config), path)


_NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
_TEXTS = st.text(st.characters(exclude_categories=("Cs", "Cn")), max_size=30).filter(
    lambda text: not any(mark in text for mark in "\x00\ufffe\uffff")
)
_INNERS = st.builds(Inner, share=_NUMBERS, names=st.lists(_TEXTS, max_size=3).map(tuple))
_OUTERS = st.builds(
    Outer,
    number=_NUMBERS,
    count=st.integers(-(2**63), 2**63),
    switch=st.booleans(),
    text=_TEXTS | st.sampled_from(["null", "1e3", "12", "- x", "a: b", "#", "", " x", "a\n b\n\n"]),
    maybe=st.none() | _NUMBERS,
    kind=st.sampled_from(["yes", "off"]),
    colour=st.sampled_from(Colour),
    pair=st.tuples(_NUMBERS, _NUMBERS),
    inner=_INNERS,
    others=st.lists(_INNERS, max_size=2).map(tuple),
    by_name=st.dictionaries(_TEXTS.filter(lambda key: key != "<<"), _INNERS, max_size=2),
)


@settings(max_examples=150)
@given(_OUTERS)
def test_any_configuration_reads_back_equal(config: Outer) -> None:
    text = dump_commented_yaml(config)
    data = parse_yaml(text, Path("config.yaml")).data
    assert Outer.model_validate(data) == config


@settings(max_examples=50)
@given(_OUTERS)
def test_readers_of_yaml_1_1_see_the_same_numbers(config: Outer) -> None:
    data = yaml.safe_load(dump_commented_yaml(config))
    assert data["number"] == config.number
    assert isinstance(data["number"], float)
    assert data["kind"] == config.kind
    assert data["switch"] is config.switch


class Foreign(Config):
    """Of a package that describes its fields as pydantic's users do."""

    gain: float = Field(default=1.0, description="By how much.")


def test_a_description_of_a_field_is_told_as_well() -> None:
    assert dump_commented_yaml(Foreign()) == "# By how much.\ngain: 1.0\n"


def test_the_text_is_meant_for_people(tmp_path: Path) -> None:
    config = Outer(
        text="+--+\n|  |\n+--+\n", others=(Inner(share=0.1), Inner(names=("a b", "no"))), number=0.1
    )
    assert (
        dump_commented_yaml(config)
        == """\
# A number, described in so many words that the line must be broken somewhere, because nobody
# reads lines that are longer than about a hundred characters.
number: 0.1
# A count.
count: 3
# Whether.
switch: true
# A text.
text: |2
  +--+
  |  |
  +--+
# Perhaps a number.
maybe: null
# A word that YAML 1.1 takes for something else.
kind: "yes"
# An enumeration.
colour: "no"
# Two numbers.
pair: [0.1, 2.0e+300]
# What an inner thing is.
inner:
  # A share.
  share: 0.5
  # Names.
  names: []
# Many.
others:
  -
    # A share.
    share: 0.1
    # Names.
    names: []
  -
    # A share.
    share: 0.5
    # Names.
    names: ["a b", "no"]
# One each.
by_name: {}
"""
    )
    assert read_back(config, tmp_path) == config


def test_a_whole_run_reads_back_equal(tmp_path: Path) -> None:
    config = load_run_config(
        None,
        None,
        ["seed=7", "sensors.lidar=rplidar_a2", "world.floor.friction=0.1234567890123456"],
    )
    assert read_back(config, tmp_path) == config
    assert load_run_config(None, str(tmp_path / "config.yaml")) == config


@pytest.mark.parametrize("world", bundled_names("worlds"))
def test_every_bundled_world_reads_back_equal(tmp_path: Path, world: str) -> None:
    config = load_run_config(world)
    assert read_back(config.world, tmp_path) == config.world


def test_every_key_of_a_run_is_explained() -> None:
    lines = dump_commented_yaml(RunConfig()).splitlines()
    bare = [
        line
        for before, line in zip(["", *lines], lines, strict=False)
        if ":" in line and not line.lstrip().startswith("#") and "#" not in before
    ]
    assert bare == []


def test_what_is_left_out_of_files_is_told_where_all_is_asked_for() -> None:
    short, whole = dump_commented_yaml(RunConfig()), dump_commented_yaml(RunConfig(), untold=())

    assert "looks:" not in short and "additional:" not in short
    assert "\n  looks:\n" in whole and "additional: []" in whole
    told = RunConfig.model_validate({"world": {"looks": {"texture": 0.5}}})
    assert "texture: 0.5" in dump_commented_yaml(told)
