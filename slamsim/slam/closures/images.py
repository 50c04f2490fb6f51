"""Candidates for closures from images: where a place was seen before, whatever the estimate says.

An image tells rooms apart that a lidar cannot, and where the robot stands to within a decimetre;
whether it is true the lidar says.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from slamsim.core.geometry import compose, inverse
from slamsim.core.places import SeenAgain
from slamsim.core.types import FloatArray
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.keyframes import Keyframe, begins_drive
from slamsim.slam.frontend.motion import Odometry

BY_IMAGES = np.diag(np.square([0.1, 0.1, 0.03]))
"""Covariance of where images find a key frame: closures of ``perception.places`` are refused from
0.1 m on, and a rolling shutter turns an image by a degree or two."""


class ImageCandidates:
    """Of a drive. odometry: None where nothing tells how the robot moved, and so where it was when
    an image was taken between two key frames; images are then taken for those of the nearest."""

    def __init__(self, again: Sequence[SeenAgain] = (), odometry: Odometry | None = None) -> None:
        self._again = sorted(again, key=lambda one: (one.now_ns, one.earlier_ns))
        self._now_ns = [one.now_ns for one in self._again]
        self._odometry = odometry

    def of(self, keyframes: Sequence[Keyframe], index: int) -> list[tuple[int, FloatArray]]:
        """Earlier key frames of the same drive that images since the last key frame show again,
        each with where it sees this one (3,)."""
        before_ns = keyframes[index - 1].stamp_ns if index else -1
        now_ns = keyframes[index].stamp_ns
        since = self._again[
            bisect_right(self._now_ns, before_ns) : bisect_right(self._now_ns, now_ns)
        ]
        if not since:
            return []
        first = index
        while first > 0 and not begins_drive(keyframes[first - 1], keyframes[first]):
            first -= 1
        stamps_ns = [keyframe.stamp_ns for keyframe in keyframes[first : index + 1]]
        found = []
        for one in since:
            number = _nearest(stamps_ns, one.earlier_ns)
            T_keyframe_earlier = self._moved(stamps_ns[number], one.earlier_ns)
            T_now_query = self._moved(one.now_ns, now_ns)
            if T_keyframe_earlier is not None and T_now_query is not None:
                T = compose(compose(T_keyframe_earlier, one.T_earlier_now), T_now_query)
                found.append((first + number, T))
        return found

    def _moved(self, first_ns: int, last_ns: int) -> FloatArray | None:
        """(3,) from one instant to another, either way; None where odometry does not cover it."""
        if self._odometry is None or first_ns == last_ns:
            return np.zeros(3)
        begin_ns, end_ns = min(first_ns, last_ns), max(first_ns, last_ns)
        if not self._odometry.covers(begin_ns, end_ns):
            return None
        T = self._odometry.step(begin_ns, end_ns, np.zeros(PARAMETERS)).T_first_last
        return T if first_ns < last_ns else inverse(T)


def _nearest(stamps_ns: Sequence[int], stamp_ns: int) -> int:
    after = bisect_left(stamps_ns, stamp_ns)
    around = range(max(after - 1, 0), min(after + 1, len(stamps_ns)))
    return min(around, key=lambda number: abs(stamps_ns[number] - stamp_ns))
