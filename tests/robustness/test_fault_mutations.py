"""Damaged inputs of all formats: the right result or one refusal, nothing else."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fault_changes import PLAIN, splice_with
from fault_judge import Outcome, Try, judged
from fault_mutations import SEEDS, grounds, verdicts
from fault_seeds import Change, Unfit, digest

from slamsim.guard.errors import InputRefused

pytestmark = pytest.mark.fault


@pytest.mark.long
@pytest.mark.parametrize("cases", [60, pytest.param(150, marks=pytest.mark.slow)])
def test_damaged_inputs_of_all_formats_are_read_right_or_refused(
    cases: int, tmp_path: Path
) -> None:
    found = list(verdicts(grounds(SEEDS, tmp_path), cases, campaign=1))
    assert len({seed.name for seed in SEEDS}) == len(SEEDS) >= 14
    assert len(found) >= cases
    assert [verdict for verdict in found if not verdict.good] == []
    outcomes = Counter(verdict.outcome for verdict in found)
    assert min(outcomes["right"], outcomes["other"], outcomes["refused"]) > 0.08 * cases


def _refuse() -> object:
    raise InputRefused("a file", "it is damaged")


def _hold_much() -> object:
    return np.ones(95 << 20).sum()


def _leak() -> object:
    return os.open(os.devnull, os.O_RDONLY)


def _fail() -> object:
    raise KeyError("odd")


def _go_on() -> object:
    while True:
        pass


def _starve() -> object:
    try:
        return np.ones(1 << 40)
    except MemoryError as error:
        raise InputRefused("a file", "it is damaged") from error


def _warn() -> object:
    return np.log(np.zeros(1))


@pytest.mark.long
def test_the_judge_tells_every_outcome_and_goes_on_after_a_death() -> None:
    tries: list[tuple[Outcome, Try]] = [
        ("right", Try("sound", lambda: 1)),
        ("other", Try("another", lambda: 2, lambda value: "other")),
        ("refused", Try("refused", _refuse)),
        ("odd", Try("odd", _fail)),
        ("odd", Try("warned", _warn)),
        ("signal", Try("killed", lambda: os.kill(os.getpid(), signal.SIGSEGV))),
        ("silent", Try("silent", lambda: 3, lambda value: "silent")),
        ("memory", Try("memory", _hold_much)),
        ("memory", Try("starved", _starve)),
        ("signal", Try("gone", lambda: os._exit(7))),
        ("open files", Try("leaking", _leak)),
        ("right", Try("last", lambda: 4)),
    ]
    found = list(judged([tried for _, tried in tries]))
    assert [verdict.outcome for verdict in found] == [outcome for outcome, _ in tries]
    assert [verdict.name for verdict in found] == [tried.name for _, tried in tries]
    assert "SIGSEGV" in found[5].detail and "code 7" in found[9].detail


@pytest.mark.long
def test_the_judge_ends_what_hangs_and_goes_on() -> None:
    tries = [Try("busy", _go_on), Try("asleep", lambda: time.sleep(60.0)), Try("sound", int)]
    found = [verdict.outcome for verdict in judged(tries, hang_s=1.0)]
    assert found == ["hang", "hang", "right"]


@pytest.mark.parametrize("change", [*PLAIN, splice_with([b"donor " * 9])])
def test_changes_take_any_bytes_and_are_the_same_again(change: Change) -> None:
    changed = 0
    for number in range(60):
        data = np.random.default_rng(number).bytes(number)
        try:
            once = change(data, np.random.default_rng(number))
            again = change(data, np.random.default_rng(number))
        except Unfit:
            assert not data
            continue
        assert isinstance(once, bytes) and once == again
        changed += once != data
    assert changed > 30


def test_the_digest_tells_values_apart_and_nothing_else() -> None:
    values = [1, 1.0, "1", b"1", None, [1], [[1]], np.ones(1), np.ones((1, 1)), np.ones(1, "f4")]
    assert len({digest(value) for value in values}) == len(values)
    assert digest({"a": [np.arange(3)]}) == digest({"a": (np.arange(3),)})
