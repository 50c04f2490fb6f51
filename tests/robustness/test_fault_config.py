"""Every number of the configuration, damaged in every way: it is refused where it is typed."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from slamsim.config.run import RunConfig

pytestmark = pytest.mark.fault

DAMAGED: tuple[object, ...] = (math.nan, math.inf, -math.inf, 1e200, -1e200, "1.0", True)
"""No number of the configuration is one of these."""


def numbers(model: type[BaseModel]) -> Iterator[tuple[type[BaseModel], str]]:
    """Every field below a model that is a single number, with the model that it is in."""
    seen: set[type[BaseModel]] = set()
    waiting = [model]
    while waiting:
        now = waiting.pop()
        if now in seen:
            continue
        seen.add(now)
        for name, field in now.model_fields.items():
            waiting += models(field.annotation)
            if field.annotation in (float, int):
                yield now, name


def models(annotation: Any) -> list[type[BaseModel]]:
    """The models that a field may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if isinstance(annotation, types.GenericAlias | types.UnionType) or typing.get_args(annotation):
        return [found for part in typing.get_args(annotation) for found in models(part)]
    return []


FIELDS = sorted(
    {(m.__name__, name): (m, name) for m, name in numbers(RunConfig)}.values(),
    key=lambda one: (one[0].__name__, one[1]),
)


def test_the_walk_finds_the_numbers() -> None:
    assert len(FIELDS) > 150
    assert {"GraphConfig", "LidarConfig", "PhysicsConfig"} <= {m.__name__ for m, _ in FIELDS}


@pytest.mark.parametrize(("model", "name"), FIELDS, ids=[f"{m.__name__}.{n}" for m, n in FIELDS])
def test_no_number_is_taken_that_is_none(model: type[BaseModel], name: str) -> None:
    for bad in DAMAGED:
        with pytest.raises(ValidationError) as refused:
            model.model_validate({name: bad})
        places = {error["loc"][:1] for error in refused.value.errors()}
        assert (name,) in places, f"{name} = {bad!r} was taken without a word"
