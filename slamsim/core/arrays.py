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
    """A dataclass whose arrays all have a row for each of its samples, and those of samples in it
    too."""

    __slots__ = ()

    def select(self, rows: slice | BoolArray | IntArray) -> Self:
        """Some of n samples, or all in another order; what is no array stays.

        rows: a slice, (n,) of bool, or (k,) numbers of samples.
        """
        return self._with(
            {
                name: held.select(rows) if isinstance(held, Samples) else held[rows]
                for name, held in self._held().items()
            }
        )

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The samples of all parts, one part after the other; what is no array is that of the
        first."""
        whole: dict[str, Any] = {}
        for name, first in parts[0]._held().items():
            held = [getattr(part, name) for part in parts]
            is_array = isinstance(first, np.ndarray)
            whole[name] = np.concatenate(held) if is_array else type(first).joined(held)
        return parts[0]._with(whole)

    def _held(self) -> dict[str, Any]:
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        return {name: v for name, v in values.items() if isinstance(v, np.ndarray | Samples)}

    def _with(self, held: dict[str, Any]) -> Self:
        return replace(self, **held)  # type: ignore[type-var]
