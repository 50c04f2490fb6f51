"""How long a rolling shutter takes from the first row to the last: learnt from what turns do.

Points move on while an image is read out. To first order that is the camera's velocity times the
time since the first row, and that time is one number for the whole recording, which no CameraInfo
tells. Each image that turns says a little about it (least squares, the motion being free).
"""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.perception.point_fit import SHARED_ERROR, SeenPoints, misfit, weight_of

USUAL_S = 0.02
"""Standard deviation before anything is known: most cameras read out within a frame of 33 ms."""
SAME_ERROR = 30.0
"""Variance over that of independent images: neighbouring ones follow the same points, and the
velocity is that since the image before."""
LONGEST_S = 0.1
LEAST_TURN_RAD_S = 0.15
"""Slower turns tell less than what else bends an image."""


class Readout:
    """seconds: what is known by now; 0 at first, which is a global shutter."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._information = USUAL_S**-2

    def learn(
        self, T_now_keyframe: FloatArray, seen: SeenPoints, velocity: FloatArray, sigma: float
    ) -> None:
        """From points at a fitted motion (4, 4). velocity: (6,) of points in the camera, metres and
        radians a second. sigma: standard deviation of a ray."""
        if np.linalg.norm(velocity[3:]) < LEAST_TURN_RAD_S:
            return
        swept = self.seconds * velocity
        off, by_step, _, _ = misfit(T_now_keyframe, seen, swept)
        longer = swept + np.concatenate([np.zeros(3), 1e-3 * velocity[3:]])
        by_readout = 1e3 * (misfit(T_now_keyframe, seen, longer)[0] - off).ravel()
        sigmas = sigma * seen.vague
        each = weight_of(np.linalg.norm(off, axis=1) / sigmas) / (SHARED_ERROR * sigmas**2)
        weight, J = np.repeat(each, 2), by_step.reshape(-1, 6)
        both = np.column_stack([by_readout, off.ravel()])
        free = np.linalg.solve((J.T * weight) @ J, (J.T * weight) @ both)
        rest = weight * (by_readout - J @ free[:, 0])
        self._information += float(rest @ by_readout) / SAME_ERROR
        step_s = -float(rest @ off.ravel()) / SAME_ERROR / self._information
        self.seconds = float(np.clip(self.seconds + step_s, 0.0, LONGEST_S))
