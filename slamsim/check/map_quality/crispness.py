"""Compares the crispness of the map at the clock offset of the joint fit and at other offsets.

The fit compares motions; this looks at the map itself. Scans of a few seconds are placed, each
piece of surface at its own instant, by gyroscope and wheels and not by matching them, and the
entropy of the map is followed along the offset (Sheehan, Harrison & Newman, IJRR 2012; Maddern,
Harrison & Newman, Lost in translation (and rotation), ICRA 2012, of offsets between sensors).
What misleads the fit, such as scans that were matched wrongly or wheels that turn before the robot
does, does not mislead this, so that an offset is only as good as its map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.findings import SURE_SIGMAS, Curve, Plot
from slamsim.check.map_quality.dead_reckoning import (
    Clock,
    Clocks,
    covered,
    fitted_clocks,
    laser_poses,
)
from slamsim.check.map_quality.entropy import map_entropy, placed
from slamsim.check.map_quality.views import WindowView, window_views
from slamsim.core.quantiles import student_t
from slamsim.core.types import FloatArray
from slamsim.recording import Recording
from slamsim.slam.laser.scan_motion import ScanMotions

Stream = Literal["gyro", "wheel"]

LEAST_WINDOWS = 4
AROUND_S = 1e-3 * np.array([-64, -32, -16, -8, -4, -2, 0, 2, 4, 8, 16, 32, 64], dtype=np.float64)
"""Offsets that are tried, from that of the fit."""

RISE = 0.01
"""By so much the entropy must rise on either side for an offset to be the crispest."""

NEWTON_STEPS = 2
SLACK_S = {"gyro": 1e-3, "wheel": 4e-3}
"""Crispest and fitted offset may lie so far apart beside their sigmas: the shape of scans, slack
of tyres and levers that are not quite known move both."""

WORSE = 0.005
"""Entropies that differ by less are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Crispness:
    """The entropy of the map along the offset of one stream against the lidar.

    offsets_s, entropy: (n,) tried, and the mean over all windows. fitted_s: offset of the fit, with
    its sigma. crispest_s: where the entropy is least, with its sigma, None if the map does not tell
    it. gained: mean by which the map as corrected is crisper than as stamped, over windows, and its
    sigma; None where the stamps themselves put nothing anywhere.
    """

    stream: Stream
    offsets_s: FloatArray
    entropy: FloatArray
    fitted_s: tuple[float, float]
    crispest_s: tuple[float, float] | None
    gained: tuple[float, float] | None

    @property
    def objection(self) -> str:
        """Why the fitted offset is doubtful; empty if the map does not contradict it."""
        if self.gained is not None and self._worse(*self.gained):
            return f"the map is less crisp with it, by {-self.gained[0]:.2g}, than as stamped"
        if self.crispest_s is None:
            return ""
        apart, sigma = self._apart
        if abs(apart) > SLACK_S[self.stream] + SURE_SIGMAS * sigma:
            return f"the map is crispest {apart * 1e3:+.3g} ± {sigma * 1e3:.2g} ms from it"
        return ""

    @property
    def support(self) -> str:
        """What supports it, in words; empty if the map tells nothing."""
        if self.crispest_s is None:
            return ""
        apart_ms, sigma_ms = 1e3 * self._apart[0], 1e3 * self.crispest_s[1]
        words = f"the map is crispest {apart_ms:+.2g} ± {sigma_ms:.2g} ms from it"
        if self.gained is not None and self.gained[0] > WORSE:
            words += f" and its entropy {self.gained[0]:.2g} less than as stamped"
        return words

    def plot(self, sign: float = 1.0) -> Plot:
        """Entropy against offset, or against minus the offset."""
        order = np.argsort(sign * self.offsets_s)
        ms = sign * 1e3 * self.offsets_s[order]
        fitted, half = sign * 1e3 * self.fitted_s[0], 1.96e3 * self.fitted_s[1]
        who = "gyroscope" if self.stream == "gyro" else "wheels"
        at = np.array([fitted])
        height = np.interp(at, ms, self.entropy[order])
        return Plot(
            f"how crisp the map is by the offset of the {who}",
            "offset, ms",
            "entropy of the map",
            (
                Curve("placed by gyroscope and wheels", ms, self.entropy[order], "line"),
                Curve("fitted, with its 95 % interval", at, height),
            ),
            spans=((float(fitted - half), float(fitted + half)),),
        )

    @property
    def _apart(self) -> tuple[float, float]:
        assert self.crispest_s is not None
        sigma = float(np.hypot(self.crispest_s[1], self.fitted_s[1]))
        return self.crispest_s[0] - self.fitted_s[0], sigma

    @staticmethod
    def _worse(gained: float, sigma: float) -> bool:
        return gained < -WORSE and gained < -SURE_SIGMAS * sigma


def crispness(
    recording: Recording, motions: ScanMotions | None, calibration: Calibration
) -> dict[Stream, Crispness]:
    """Of each stream that follows the scans; none where the scans say too little."""
    streams: list[Stream] = ["gyro", "wheel"]
    there = [stream for stream in streams if calibration.follows(stream)]
    if motions is None or not calibration.scans_count or not there:
        return {}
    scans = next(scans for scans in recording.scans if scans.topic == motions.topic)
    views = window_views(scans, motions, calibration)
    found = {stream: along(calibration, views, stream) for stream in there}
    return {stream: one for stream, one in found.items() if one is not None}


def along(calibration: Calibration, views: list[WindowView], stream: Stream) -> Crispness | None:
    """The entropy along the offset of one stream, all else as fitted; None of too few windows, or
    where nothing is seen again."""
    if len(views) < LEAST_WINDOWS:
        return None
    clocks = fitted_clocks(calibration)
    value_s, sigma_s, _ = calibration.offset(stream)
    entropies = {by: _entropy(calibration, views, _later(clocks, stream, by)) for by in AROUND_S}
    if not all(np.isfinite(one).all() for one in entropies.values()):
        return None
    crispest = _crispest(calibration, views, (clocks, stream), entropies)
    gained = _gained(calibration, views, _with(clocks, stream, Clock(0.0, 0.0)), entropies[0.0])
    tried = {by: float(one.mean()) for by, one in entropies.items()}
    if gained is not None:
        tried[-value_s] = tried[0.0] + gained[0]
    return Crispness(
        stream,
        value_s + np.array(list(tried)),
        np.array(list(tried.values())),
        (value_s, sigma_s),
        None if crispest is None else (value_s + crispest[0], crispest[1]),
        gained,
    )


def _gained(
    calibration: Calibration, views: list[WindowView], stamped: Clocks, corrected: FloatArray
) -> tuple[float, float] | None:
    """Mean and sigma of what windows lose in entropy by the correction; None where too few can be
    placed as stamped at all."""
    inside = [k for k, view in enumerate(views) if covered(calibration, view, stamped)]
    if len(inside) < LEAST_WINDOWS:
        return None
    lost = _entropy(calibration, [views[k] for k in inside], stamped) - corrected[inside]
    return _mean_of(lost) if np.isfinite(lost).all() else None


def _crispest(
    calibration: Calibration,
    views: list[WindowView],
    of: tuple[Clocks, Stream],
    entropies: Mapping[float, FloatArray],
) -> tuple[float, float] | None:
    """Where the entropy is least, from the fitted offset on, and its sigma, s: Newton's steps, and
    the jackknife over windows; None where it does not rise on both sides."""
    tried = np.array(sorted(entropies))
    mean = np.array([entropies[by].mean() for by in tried])
    least = int(np.argmin(mean))
    risen = mean > mean[least] + RISE
    if not risen[:least].any() or not risen[least + 1 :].any():
        return None
    width = 0.5 * float(tried[least + np.argmax(risen[least:])] - tried[:least][risen[:least]][-1])
    at = float(tried[least])
    for _ in range(NEWTON_STEPS):
        behind, here, ahead = (
            _entropy(calibration, views, _later(*of, at + by)) for by in (-width, 0.0, width)
        )
        slope, bend = (ahead - behind) / (2.0 * width), (ahead + behind - 2.0 * here) / width**2
        if not float(bend.mean()) > 0.0:
            return None
        left_at, step = at, float(np.clip(-slope.mean() / bend.mean(), -width, width))
        at += step
    # The gradient of each window at the place where their sum has none.
    gradient = slope + bend * (at - left_at)
    return at, _mean_of(gradient)[1] / float(bend.mean())


def _entropy(calibration: Calibration, views: list[WindowView], clocks: Clocks) -> FloatArray:
    """(w,) of the map of each window."""
    return np.array(
        [
            map_entropy(placed(view.pieces, laser_poses(calibration, view, clocks)), view.scan)
            for view in views
        ]
    )


def _later(clocks: Clocks, stream: Stream, by_s: float) -> Clocks:
    return _with(clocks, stream, getattr(clocks, stream).later(by_s))


def _with(clocks: Clocks, stream: Stream, clock: Clock) -> Clocks:
    return replace(clocks, gyro=clock) if stream == "gyro" else replace(clocks, wheel=clock)


def _mean_of(values: FloatArray) -> tuple[float, float]:
    """Of few numbers, with a sigma as wide as few of them allow (Student's t)."""
    wider = float(student_t(0.975, values.size - 1)) / 1.96
    return float(values.mean()), wider * float(values.std(ddof=1)) / np.sqrt(values.size)
