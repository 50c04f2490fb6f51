"""Array types used everywhere, named by the type of their numbers, and what has a row for each
sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Samples:
    """A dataclass whose arrays all have a row for each of its samples."""

    __slots__ = ()

    def select(self, rows: slice | BoolArray | IntArray) -> Self:
        """Some of n samples, or all in another order; what is no array stays.

        rows: a slice, (n,) of bool, or (k,) numbers of samples.
        """
        return self._with({name: array[rows] for name, array in self._arrays().items()})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The samples of all parts, one part after the other; what is no array is that of the
        first."""
        arrays = [part._arrays() for part in parts]
        whole = {name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]}
        return parts[0]._with(whole)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    def _with(self, arrays: dict[str, NDArray[Any]]) -> Self:
        return replace(self, **arrays)  # type: ignore[type-var]
