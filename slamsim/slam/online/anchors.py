"""From the front end's drifting frame to the map as it is known by now."""

from __future__ import annotations

from collections import deque

import numpy as np

from slamsim.core.geometry import adjoint, between, compose, inverse
from slamsim.core.types import FloatArray
from slamsim.slam.backend.correction import Correction
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.frontend.tracking import Tracked


class Anchors:
    """Carries the back end's newest correction over to the scans since then."""

    def __init__(self) -> None:
        self._waiting: deque[Keyframe] = deque()
        self._anchor: Keyframe | None = None
        self._correction: Correction | None = None

    def add(self, keyframe: Keyframe) -> None:
        """One more key frame that the back end may place."""
        self._waiting.append(keyframe)

    def move(self, correction: Correction | None) -> None:
        """Take over a correction of the newest key frame that the back end knows."""
        if correction is None:
            return
        self._correction = correction
        while self._waiting and self._waiting[0].index <= correction.keyframe:
            self._anchor = self._waiting.popleft()

    @property
    def joined(self) -> bool:
        """Whether anything tells where the newest key frame is in the map of the first."""
        return self._correction is None or self._correction.joined

    def place(self, tracked: Tracked) -> tuple[FloatArray, FloatArray]:
        """(3,) T_map_base of a scan and its covariance (3, 3)."""
        if self._correction is None or self._anchor is None:
            return tracked.T_map_base, np.zeros((3, 3))
        step = between(self._anchor.T_map_base, tracked.T_map_base)
        carry = adjoint(inverse(step))
        covariance = carry @ self._correction.covariance @ carry.T
        return compose(self._correction.T_map_base, step), covariance
