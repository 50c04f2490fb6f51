"""Basin of convergence: share of matches that converge, by the error of their prediction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.core.types import FloatArray, IntArray

DISTANCES_M = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)
TURNS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
"""Edges of the classes that offsets are counted in."""

HOME_M, HOME_RAD = 0.05, float(np.deg2rad(1.0))
"""A match this near to the reference has come home."""


def random_offsets(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) offsets, each class as likely as another, to all sides."""
    away_m = _within_a_class(rng, DISTANCES_M, count)
    turn = np.deg2rad(_within_a_class(rng, TURNS_DEG, count)) * rng.choice([-1.0, 1.0], count)
    side = rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([away_m * np.cos(side), away_m * np.sin(side), turn])


Share = dict[str, float | None]
"""One class: ``to_m`` and ``to_deg``, ``tried``, and the ``share`` that came home."""


class Basin:
    """Counts of tries and of those that came home, per class of distance and turn."""

    def __init__(self) -> None:
        self._tried = np.zeros((len(DISTANCES_M) - 1, len(TURNS_DEG) - 1), dtype=np.int64)
        self._home = np.zeros_like(self._tried)

    def add(self, off: FloatArray, error: FloatArray | None) -> None:
        """off: (3,) of the prediction. error: (3,) of the match, None where there was none."""
        at = _class_of(DISTANCES_M, float(np.hypot(off[0], off[1])))
        turned = _class_of(TURNS_DEG, float(np.rad2deg(abs(off[2]))))
        self._tried[at, turned] += 1
        if error is not None:
            home = np.hypot(error[0], error[1]) <= HOME_M and abs(error[2]) <= HOME_RAD
            self._home[at, turned] += bool(home)

    def shares(self) -> list[Share]:
        """One entry per class, distance by distance; share: None where nothing was tried."""
        tried, home = self._tried.tolist(), self._home.tolist()
        return [
            {
                "to_m": DISTANCES_M[i + 1],
                "to_deg": TURNS_DEG[j + 1],
                "tried": tried[i][j],
                "share": home[i][j] / tried[i][j] if tried[i][j] else None,
            }
            for i in range(len(DISTANCES_M) - 1)
            for j in range(len(TURNS_DEG) - 1)
        ]


def basin_rows(plain: Sequence[Share], searched: Sequence[Share]) -> dict[str, str]:
    """A row per distance: the shares of both, in per cent, turn by turn."""
    turns = len(TURNS_DEG) - 1
    rows = {"turned up to": "".join(f"{f'{deg:g} deg':>10}" for deg in TURNS_DEG[1:])}
    for first in range(0, len(plain), turns):
        pairs = zip(plain[first : first + turns], searched[first : first + turns], strict=True)
        cells = [f"{_percent(a['share'])}/{_percent(b['share'])}" for a, b in pairs]
        rows[f"up to {plain[first]['to_m']:g} m"] = "".join(f"{cell:>10}" for cell in cells)
    return rows


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.0f}"


def _within_a_class(rng: np.random.Generator, edges: Sequence[float], count: int) -> FloatArray:
    number: IntArray = rng.integers(0, len(edges) - 1, count)
    low, high = np.array(edges)[number], np.array(edges)[number + 1]
    return np.asarray(rng.uniform(low, high))


def _class_of(edges: Sequence[float], value: float) -> int:
    return int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))
