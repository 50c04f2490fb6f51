"""How often each place was mapped, so that a place driven through often does not cost for ever."""

from __future__ import annotations

import numpy as np

from slamsim.types import FloatArray

CELL_M = 1.0
SECTORS = 4
PASS_M = 10.0
"""Coming back after this much path is another pass."""

ENOUGH_PASSES = 2


class Visits:
    """Passes through each square metre, counted for each of four headings."""

    def __init__(self) -> None:
        self._passes: dict[tuple[int, int, int], tuple[int, float]] = {}

    def enough(self, T_map_base: FloatArray, path_m: float) -> bool:
        """Whether earlier passes have seen all that can be seen from here, facing this way."""
        count, last_m = self._passes.get(_place(T_map_base), (0, path_m))
        return count - (path_m - last_m < PASS_M) >= ENOUGH_PASSES

    def add(self, T_map_base: FloatArray, path_m: float) -> None:
        """One more key frame that was kept."""
        place = _place(T_map_base)
        count, last_m = self._passes.get(place, (0, -np.inf))
        again = path_m - last_m >= PASS_M
        self._passes[place] = (count + again, path_m)


def _place(T_map_base: FloatArray) -> tuple[int, int, int]:
    column, row = np.floor(T_map_base[:2] / CELL_M).astype(int).tolist()
    sector = int(np.floor(T_map_base[2] / (2.0 * np.pi) * SECTORS + 0.5)) % SECTORS
    return column, row, sector
