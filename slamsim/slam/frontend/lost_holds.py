"""What held the scans along a corridor is gone from one scan to the next.

Walls go out of view one by one, or behind an edge. That returns come from behind what held them,
where it was seen just before, shows that the robot was carried along the corridor, even where the
scan fits the map as if it had gone on.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from slamsim.core.result import Event
from slamsim.core.types import Cloud
from slamsim.slam.frontend.kidnap_detection import KIDNAP_WITHIN_NS, Sighting, is_gone
from slamsim.slam.matching.base import Match

HELD_SCANS = 3
"""All of so many scans before must have been held: one alone may have met a clutter of lines."""

LOST_SHARE = 0.02
"""Of the information along the direction that is held least: a seventh of how surely the scans
were held there."""

WORDS = (
    "what held the scans along one direction is gone from one scan to the next, and they see what "
    "is behind it: the robot may have been carried that way, and the map be torn there"
)


class LostHolds:
    """Sees each match, and tells of those that lost from one scan to the next what held them."""

    def __init__(self) -> None:
        self._before: Sighting | None = None
        self._held = deque[float](maxlen=HELD_SCANS)

    def see(self, cloud: Cloud, match: Match) -> Event | None:
        """The event to be told of a cloud (in the base frame at its stamp) that was matched."""
        before, self._before = self._before, Sighting(cloud, match.T_map_base)
        held = float(np.linalg.eigvalsh(match.information[:2, :2])[0])
        least = min(self._held) if len(self._held) == HELD_SCANS else 0.0
        self._held.append(held)
        if before is None or held > LOST_SHARE * least or not least > 0.0:
            return None
        if cloud.stamp_ns - before.cloud.stamp_ns > KIDNAP_WITHIN_NS:
            return None
        if not is_gone(before, self._before):
            return None
        return Event(before.cloud.stamp_ns, cloud.stamp_ns, "torn", WORDS)
