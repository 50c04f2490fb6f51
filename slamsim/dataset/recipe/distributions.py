"""Distributions that a recipe gives to the keys of a configuration, and their values.

Each is a mapping with the name of its kind: ``{uniform: [0.2, 0.6]}``. Anything else that is no
mapping is a constant, and a list may have a distribution at each of its places. A value is drawn
from one number between 0 and 1, by the inverse of the distribution function.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from itertools import accumulate
from statistics import NormalDist
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from slamsim.config.base import Config
from slamsim.guard.errors import did_you_mean, shown
from slamsim.guard.numbers import MOST_COUNT, MOST_NS

DIGITS = 6
"""Significant digits of what is drawn: enough for any setting, and short to read."""
LEAST_MASS = 1e-6
"""A cut normal distribution must leave this share of itself."""

Number = Annotated[float, Field(ge=-MOST_COUNT, le=MOST_COUNT)]
Pair = Annotated[tuple[Number, Number], Field(strict=False)]
Whole = Annotated[int, Field(ge=-MOST_NS, le=MOST_NS)]
Weight = Annotated[float, Field(ge=0.0, le=1e9)]
Weights = Annotated[tuple[Weight, ...], Field(strict=False)]


class Drawn(Config, ABC):
    """A distribution of single values."""

    @abstractmethod
    def value(self, share: float) -> object:
        """The value below which this share of all values lies; 0 <= share < 1."""

    @abstractmethod
    def extremes(self) -> tuple[object, ...]:
        """Values such that a key which takes them takes all others too."""


class Constant(Drawn):
    """Always the same; the only way to write a mapping."""

    constant: Any
    """The value."""

    def value(self, share: float) -> object:
        return self.constant

    def extremes(self) -> tuple[object, ...]:
        return (self.constant,)


class Choice(Drawn):
    """One of several values."""

    choice: Annotated[tuple[Any, ...], Field(strict=False, min_length=1)]
    """The values."""
    weights: Weights | None = None
    """How often each is chosen, relative to the others; all alike without them."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.weights is not None:
            if len(self.weights) != len(self.choice):
                raise ValueError(f"{len(self.choice)} choices have {len(self.weights)} weights")
            if not sum(self.weights) > 0.0:
                raise ValueError("all weights are zero: nothing could be chosen")
        return self

    def value(self, share: float) -> object:
        return self.choice[pick(self.weights or (1.0,) * len(self.choice), share)]

    def extremes(self) -> tuple[object, ...]:
        weights = self.weights or (1.0,) * len(self.choice)
        return tuple(v for v, w in zip(self.choice, weights, strict=True) if w > 0.0)


class Integers(Drawn):
    """A whole number, each of a range as likely as the others."""

    integers: Annotated[tuple[Whole, Whole], Field(strict=False)]
    """Smallest and largest, both possible."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        _ascending("integers", self.integers)
        return self

    def value(self, share: float) -> int:
        low, high = self.integers
        return low + min(int(share * (high - low + 1)), high - low)

    def extremes(self) -> tuple[object, ...]:
        return self.integers


class Uniform(Drawn):
    """A number, evenly distributed."""

    uniform: Pair
    """Smallest and largest."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        _ascending("uniform", self.uniform)
        return self

    def value(self, share: float) -> float:
        low, high = self.uniform
        return _rounded(low + share * (high - low), low, high)

    def extremes(self) -> tuple[object, ...]:
        return self.uniform


class LogUniform(Drawn):
    """A positive number, each order of magnitude as likely as the others."""

    log_uniform: Pair
    """Smallest and largest."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        _ascending("log_uniform", self.log_uniform)
        if self.log_uniform[0] <= 0.0:
            raise ValueError(f"log_uniform begins above 0, not at {self.log_uniform[0]:g}")
        if not math.isfinite(self.log_uniform[1] / self.log_uniform[0]):
            raise ValueError("log_uniform spans more orders of magnitude than there are numbers")
        return self

    def value(self, share: float) -> float:
        low, high = self.log_uniform
        return _rounded(low * math.exp(share * math.log(high / low)), low, high)

    def extremes(self) -> tuple[object, ...]:
        return self.log_uniform


class Normal(Drawn):
    """A number, normally distributed and cut at both sides."""

    normal: Pair
    """Mean and standard deviation."""
    within: Pair | None = None
    """Smallest and largest; without them, three standard deviations to both sides."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        mean, deviation = self.normal
        if deviation < 0.0:
            raise ValueError(f"a standard deviation is never negative: {deviation:g}")
        _ascending("within", self.bounds)
        low, high = self.bounds
        if deviation == 0.0 and not low <= mean <= high:
            raise ValueError(f"the mean {mean:g} lies outside [{low:g}, {high:g}]")
        if deviation > 0.0 and self._shares()[1] - self._shares()[0] < LEAST_MASS:
            raise ValueError(
                f"next to nothing of a normal distribution about {mean:g} with the deviation "
                f"{deviation:g} lies within [{low:g}, {high:g}]"
            )
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        mean, deviation = self.normal
        return self.within or (mean - 3.0 * deviation, mean + 3.0 * deviation)

    def _shares(self) -> tuple[float, float]:
        curve = NormalDist(*self.normal)
        return curve.cdf(self.bounds[0]), curve.cdf(self.bounds[1])

    def value(self, share: float) -> float:
        mean, deviation = self.normal
        if deviation == 0.0:
            return mean
        low, high = self._shares()
        inner = min(max(low + share * (high - low), 1e-300), 1.0 - 1e-16)
        return _rounded(NormalDist(mean, deviation).inv_cdf(inner), *self.bounds)

    def extremes(self) -> tuple[object, ...]:
        return self.bounds


class Listed(Config):
    """A list with a distribution at each place."""

    listed: Annotated[tuple[Distribution, ...], Field(strict=False)]
    """The distributions."""


KINDS: dict[str, type[Drawn | Listed]] = {
    "constant": Constant,
    "choice": Choice,
    "integers": Integers,
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "listed": Listed,
}


def as_distribution(given: object) -> object:
    """A plain value as a constant, a list as ``listed``. ValueError for an unknown kind."""
    if isinstance(given, Drawn | Listed):
        return given
    if isinstance(given, list | tuple):
        return {"listed": given}
    if not isinstance(given, dict):
        return {"constant": given}
    if len(several := [kind for kind in KINDS if kind in given]) > 1:
        raise ValueError(f"one distribution stands here, not {' and '.join(several)}")
    if kind_of(given) is None:
        key = str(next(iter(given), ""))
        hint = did_you_mean(key, KINDS) or f"; one of {', '.join(KINDS)} is needed"
        raise ValueError(f"there is no distribution {shown(key)}{hint}")
    return given


def kind_of(given: object) -> str | None:
    """The name of the class that a mapping, or an instance, is of; None for none."""
    if isinstance(given, Drawn | Listed):
        return type(given).__name__
    found = next((kind for kind in KINDS if isinstance(given, dict) and kind in given), None)
    return None if found is None else KINDS[found].__name__


Distribution = Annotated[
    Annotated[Constant, Tag("Constant")]
    | Annotated[Choice, Tag("Choice")]
    | Annotated[Integers, Tag("Integers")]
    | Annotated[Uniform, Tag("Uniform")]
    | Annotated[LogUniform, Tag("LogUniform")]
    | Annotated[Normal, Tag("Normal")]
    | Annotated[Listed, Tag("Listed")],
    Discriminator(kind_of),
    BeforeValidator(as_distribution),
]
"""One distribution, or a plain value for a constant."""

Listed.model_rebuild()


def edges(distribution: Distribution) -> tuple[object, ...]:
    """Values such that a key which takes them takes all others too, the usual one first."""
    if not isinstance(distribution, Listed):
        return distribution.extremes()
    inner = [edges(one) for one in distribution.listed]
    usual = [values[0] for values in inner]
    return tuple(
        [*usual[:place], value, *usual[place + 1 :]]
        for place, values in enumerate(inner)
        for value in values
    ) or ([],)


def pick(weights: tuple[float, ...], share: float) -> int:
    """Index of the weight in whose part of their sum the share lies; never one that is zero."""
    ends = list(accumulate(weights))
    found = bisect_right(ends, share * ends[-1])
    return min(found, max(i for i, weight in enumerate(weights) if weight > 0.0))


def _ascending(name: str, pair: tuple[float, float]) -> None:
    if pair[0] > pair[1]:
        raise ValueError(f"{name}: the smaller value comes first, not [{pair[0]:g}, {pair[1]:g}]")


def _rounded(value: float, low: float, high: float) -> float:
    return min(max(float(f"{value:.{DIGITS}g}"), low), high)
