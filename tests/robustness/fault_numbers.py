"""What becomes of numbers that are none: a right result, or one clear refusal; never in between."""

from __future__ import annotations

import math
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from types import FrameType
from typing import Any, Literal

import numpy as np
import pytest
from pydantic import ValidationError

from slamsim.core.types import FloatArray, Grid, OutsideTimeRange, Scan
from slamsim.guard.errors import SlamsimError

BAD: dict[str, float] = {
    "nan": math.nan,
    "inf": math.inf,
    "minus inf": -math.inf,
    "huge": 1e200,
}
EDGES_NS = {"least": np.iinfo(np.int64).min, "most": np.iinfo(np.int64).max}
CLEAR = (SlamsimError, OutsideTimeRange, ValidationError)
HANG_S = 60
"""Most of it for kernels that are compiled at the first call, beside other tests."""

Outcome = Literal["refused", "right"]
Case = tuple[Callable[[], object], Outcome]


def refused(call: Callable[[], object]) -> Case:
    """A case that must end in a clear error."""
    return call, "refused"


def right(call: Callable[[], object]) -> Case:
    """A case that must give numbers, all of them finite."""
    return call, "right"


def each(name: str, call: Callable[[float], object]) -> dict[str, Case]:
    """A case for every number that is none, given to a call that must refuse them all."""
    return {f"{name} of {what}": refused(partial(call, bad)) for what, bad in BAD.items()}


def judge(case: Case) -> None:
    """Run one case; fails the test on anything but what it must come to."""
    call, wanted = case
    with _no_longer_than(HANG_S), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = call()
        except CLEAR as error:
            words = str(error)
            assert wanted == "refused", f"refused, where numbers were to come: {words}"
            assert words.strip() and len(words) < 1000 and "Traceback" not in words
            return
    odd = list(unsound(result))
    assert not odd, f"numbers that are none came out: {odd[:5]}"
    assert wanted == "right", f"taken without a word: {result!r}"


def cases(*tables: Mapping[str, Case]) -> pytest.MarkDecorator:
    """All cases of some tables as parameters of a test, each under its name."""
    every = {name: case for table in tables for name, case in table.items()}
    assert len(every) == sum(map(len, tables)), "two cases of one name"
    return pytest.mark.parametrize("case", [pytest.param(c, id=n) for n, c in every.items()])


def put(values: np.ndarray, bad: float, place: int = -1) -> np.ndarray:
    """A copy with one number replaced."""
    damaged = values.copy()
    damaged.reshape(-1)[place] = bad
    return damaged


def unsound(value: object, place: str = "") -> Iterator[str]:
    """Where in a result there is a number that is not finite, and should be."""
    if isinstance(value, Grid | Scan):  # nan stands for unknown there, by contract
        return
    if isinstance(value, float | np.floating):
        if not math.isfinite(value):
            yield f"{place} = {value}"
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            yield f"{place}{value.shape}"
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from unsound(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from unsound(item, f"{place}[{name}]")
    elif isinstance(value, tuple | list):
        for number, item in enumerate(value):
            yield from unsound(item, f"{place}[{number}]")


def steps(count: int, every_ns: int = 100_000_000) -> np.ndarray:
    """(count,) stamps."""
    return np.arange(count, dtype=np.int64) * every_ns


def line(count: int) -> FloatArray:
    """(count, 3) poses on a bend, none of them equal."""
    turn = np.linspace(0.0, 1.5, count)
    return np.column_stack([np.sin(turn), 1.0 - np.cos(turn), turn])


@contextmanager
def _no_longer_than(seconds: int) -> Iterator[None]:
    def hangs(number: int, frame: FrameType | None) -> Any:
        raise AssertionError(f"hangs for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
