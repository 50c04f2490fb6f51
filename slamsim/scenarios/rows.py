"""Reads numbers from the rows of trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.scenarios.base import Outcome, Row


def number(row: Row, key: str) -> float:
    """A number of a row that has it."""
    return float(cast(float, row[key]))


def column(outcomes: Sequence[Outcome], key: str) -> FloatArray:
    """(n,) the same number of every row; nan where a row has none."""
    values = (one.values.get(key) for one in outcomes)
    return np.array([np.nan if value is None else cast(float, value) for value in values])


def having(outcomes: Sequence[Outcome], **wanted: object) -> list[Outcome]:
    """Those whose rows say exactly this."""
    return [
        one
        for one in outcomes
        if all(one.values.get(key) == value for key, value in wanted.items())
    ]
