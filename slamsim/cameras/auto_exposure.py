"""Automatic exposure: the light of one image sets exposure and gain of the next, with a lag."""

from __future__ import annotations

import numpy as np

from slamsim.cameras.settings import ExposureConfig

_DARKEST = 1e-4
"""Of the largest value: a darker mean is taken for this one."""
_MOST_FACTOR = 8.0
"""By which one image can ask for more or less light: a mean near the largest value is cut off and
does not tell how much too bright it was."""


class AutoExposure:
    """Exposure and gain of one imager, image by image at a rate."""

    def __init__(self, config: ExposureConfig, rate_hz: float) -> None:
        self._config = config
        self.exposure_s, self.gain = config.exposure_s, config.gain
        made_good = 1.0 if config.lag_s == 0.0 else 1.0 - np.exp(-1.0 / (rate_hz * config.lag_s))
        self._made_good = float(made_good)

    def measured(self, mean: float) -> None:
        """Take the mean of an image, as a share of the largest value, before the next one."""
        config = self._config
        if not config.auto:
            return
        wanted = config.target / max(mean, _DARKEST)
        factor = min(max(wanted, 1.0 / _MOST_FACTOR), _MOST_FACTOR) ** self._made_good
        amount_s = self.exposure_s * self.gain * factor
        self.exposure_s = min(max(amount_s, config.exposure_min_s), config.exposure_max_s)
        self.gain = min(max(amount_s / self.exposure_s, 1.0), config.gain_max)
