"""Places that images show again, as values that cross from perception to SLAM."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import require_finite


@dataclass(frozen=True, slots=True, eq=False)
class SeenAgain:
    """Two images that show one scene, by the instants at which they were exposed.

    T_earlier_now: (3,) the base at the later instant as seen from the base at the earlier one.
    """

    earlier_ns: int
    now_ns: int
    T_earlier_now: FloatArray

    def __post_init__(self) -> None:
        require_finite("where a place was seen again", self.T_earlier_now, (3,))
