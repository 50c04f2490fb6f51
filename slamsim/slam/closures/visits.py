"""How often each place was mapped, so that a place driven through often does not cost for ever."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray

CELL_M = 1.0
SECTORS = 4
PASS_M = 10.0
"""Coming back after this much path is another pass."""

KNOWN_PASSES, ENOUGH_PASSES = 1, 2
"""After which a place is known: where the robot is found again in what was seen before, and
anywhere. Outdoors (fr-clinic), or after drift, a second pass may be the first that is held."""

KNOWN_TRAVEL_M = 3.0
MOST_TRAVEL_M = 12.0
"""Path between key frames of a known place: more for each further pass, but at least one in so many
metres, so that each room keeps some of every pass. Chosen for memory: a round driven for hours
keeps growing by a fraction of what its first pass took."""


class Visits:
    """Passes through each square metre, counted for each of four headings."""

    def __init__(self) -> None:
        self._passes: dict[tuple[int, int, int], tuple[int, float]] = {}

    def passes(self, T_map_base: FloatArray, path_m: float) -> int:
        """Count a key frame that comes by; how many earlier passes have seen what can be seen from
        here, facing this way. T_map_base: (3,)."""
        place = _place(T_map_base)
        count, last_m = self._passes.get(place, (0, -np.inf))
        again = path_m - last_m >= PASS_M
        self._passes[place] = (count + again, path_m)
        return count - (not again)


def spacing_m(passes: int, found: bool) -> float:
    """Path from one key frame to the next to keep after so many earlier passes, 0 where all are.

    Each further pass needs fewer, for there are those of the passes before. found: whether the
    robot is found again in these.
    """
    spaces = max(passes - (KNOWN_PASSES if found else ENOUGH_PASSES) + 1, 0)
    return min(spaces * KNOWN_TRAVEL_M, MOST_TRAVEL_M)


def _place(T_map_base: FloatArray) -> tuple[int, int, int]:
    column, row = np.floor(T_map_base[:2] / CELL_M).astype(int).tolist()
    sector = int(np.floor(T_map_base[2] / (2.0 * np.pi) * SECTORS + 0.5)) % SECTORS
    return column, row, sector
