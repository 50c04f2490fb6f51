"""How often each place was mapped, so that a place driven through often does not cost for ever."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray

CELL_M = 1.0
SECTORS = 4
PASS_M = 10.0
"""Coming back after this much path is another pass."""

ENOUGH_PASSES = 1
KNOWN_TRAVEL_M = 3.0
MOST_TRAVEL_M = 12.0
"""Path between key frames of a known place: more for each further pass, but at least one in so many
metres, so that each room keeps some of every pass. Chosen for memory: a round driven for hours
keeps growing by a fraction of what its first pass took."""


class Visits:
    """Passes through each square metre, counted for each of four headings."""

    def __init__(self) -> None:
        self._passes: dict[tuple[int, int, int], tuple[int, float]] = {}

    def spacing_m(self, T_map_base: FloatArray, path_m: float) -> float:
        """Count a key frame that comes by; path from one key frame to the next to keep here.

        0, so that all are kept, until earlier passes have seen what can be seen from here, facing
        this way. Each further pass needs fewer, for there are those of the passes before.
        T_map_base: (3,).
        """
        place = _place(T_map_base)
        count, last_m = self._passes.get(place, (0, -np.inf))
        again = path_m - last_m >= PASS_M
        self._passes[place] = (count + again, path_m)
        passes_before = count - (not again)
        spaces = max(passes_before - ENOUGH_PASSES + 1, 0)
        return min(spaces * KNOWN_TRAVEL_M, MOST_TRAVEL_M)


def _place(T_map_base: FloatArray) -> tuple[int, int, int]:
    column, row = np.floor(T_map_base[:2] / CELL_M).astype(int).tolist()
    sector = int(np.floor(T_map_base[2] / (2.0 * np.pi) * SECTORS + 0.5)) % SECTORS
    return column, row, sector
