"""Options of ``slamsim bench`` that the chosen part does not look at are refused."""

from __future__ import annotations

import shlex

import pytest
from test_documentation import commands
from typer.main import get_command
from typer.testing import CliRunner

from slamsim.bench.parts import USED, require_used
from slamsim.cli.main import app
from slamsim.guard.errors import OverrideRefused, SlamsimError


def documented() -> list[list[str]]:
    split = (shlex.split(command, comments=True) for command in commands())
    return [words for words in split if words[1:2] == ["bench"]]


def test_every_documented_measurement_uses_its_options() -> None:
    assert len(documented()) >= 10
    for _, _, *words in documented():
        part = words[0] if words and not words[0].startswith("-") else "all"
        require_used(part, [word for word in words if word.startswith("--")])


def test_each_option_is_used_by_a_part() -> None:
    command = get_command(app).commands["bench"]  # type: ignore[attr-defined]
    there = {each.opts[0] for each in command.params if each.opts[0].startswith("--")}
    used = {option for options in USED.values() for option in options}
    assert used == there - {"--quiet", "--json", "--help"}


@pytest.mark.parametrize(
    ("words", "option", "used"),
    [
        (["robustness", "--world", "tiny"], "--world", "--cases"),
        (["check", "--cameras", "--pairs", "2"], "--pairs", "--workers"),
        (["check", "-c", "labyrinth_10hz"], "--config", "--curves"),
        (["accuracy", "--no-bound", "--cameras"], "--cameras", "--bound"),
        (["slam", "--peers", "--repeats", "1"], "--repeats", "--peers"),
        (["check", "--recording", "x", "--seeds", "2"], "--seeds", "--faults"),
        (["matcher", "--recording", "x", "--world", "tiny"], "--world", "--set"),
        (["robustness", "--only", "3", "--cases", "5"], "--cases", "--seed"),
    ],
)
def test_an_option_that_a_part_does_not_look_at(words: list[str], option: str, used: str) -> None:
    done = CliRunner().invoke(app, ["bench", *words])
    assert isinstance(done.exception, OverrideRefused)
    assert done.exception.option == option and used in done.exception.reason


def test_a_part_that_there_is_not() -> None:
    with pytest.raises(SlamsimError, match=r"choose from all, sense, drive.*robustness, online"):
        require_used("speed", [])
