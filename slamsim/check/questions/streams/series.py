"""The stamps of one stream, and statistics of their spacing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.stamps import order_once
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry, RawStream, Recording, TransformEdge
from slamsim.recording.edits.beams import scan_durations_ns
from slamsim.recording.edits.messages import copies, repeats_are_copies
from slamsim.recording.edits.stamps import are_copies

Kind = Literal["lidar", "imu", "wheels", "transform"]

_SAME_ORIGIN_NS = 3600 * 1_000_000_000
_LOCAL_STEPS = 200
_APART, _FAR_APART = 8, 32
_BEAT_GROWTH = 1.6
_EVEN_SHARE = 0.2
_WHOLE, _MOSTLY = 0.2, 0.9
"""Steps this near to a whole number of periods, in most cases, have messages missing in between."""
TOGETHER = 0.2
"""Of a period: no sensor measures twice in so short a time."""
_BURST_SHARE = 0.5
"""Of the mean time between messages: where most steps are shorter, half of the messages would have
to be lost, or they come in bursts."""


@dataclass(frozen=True, eq=False)
class StampSeries:
    """stamps_ns: (n,) in the order of the file. received_ns: (n,) on the clock of the stamps if
    the recording tells how, None if unknown. lasts_ns: (n,) from stamp to the end of measuring.
    odometries: of a lidar, what may tell how far the robot drove from one scan to the next.
    messages: of which these are the stamps.
    """

    subject: str
    kind: Kind
    stamps_ns: IntArray
    received_ns: IntArray | None
    lasts_ns: IntArray
    odometries: tuple[RawOdometry, ...] = ()
    messages: RawStream | TransformEdge | None = None

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    @property
    def since_first_s(self) -> FloatArray:
        """(n,) stamps counted from the first."""
        return np.asarray((self.stamps_ns - self.stamps_ns[:1]) * 1e-9)

    @property
    def span_s(self) -> float:
        """From the earliest stamp to the latest; 0 without any."""
        return float(np.ptp(self.stamps_ns)) * 1e-9 if len(self) else 0.0

    @property
    def steps_s(self) -> FloatArray:
        """(n - 1,) from each stamp to the next in the file."""
        return np.asarray(np.diff(self.stamps_ns) * 1e-9)

    @cached_property
    def instants_ns(self) -> IntArray:
        """(m,) distinct stamps, ascending."""
        if (self.stamps_ns[1:] > self.stamps_ns[:-1]).all():
            return self.stamps_ns
        return np.unique(self.stamps_ns)

    @property
    def ordered_steps_s(self) -> FloatArray:
        """(m,) between neighbouring instants, however the file has them."""
        return np.asarray(np.diff(self.instants_ns) * 1e-9)

    @property
    def period_s(self) -> float:
        """From one instant to the next, by most of those a few apart; 0 of fewer than two."""
        instants_ns = self.instants_ns
        apart = min(_APART, max(instants_ns.size - 1, 1))
        elapsed_ns = instants_ns[apart:] - instants_ns[:-apart]
        return float(np.median(elapsed_ns)) * 1e-9 / apart if elapsed_ns.size else 0.0

    @cached_property
    def once(self) -> StampSeries:
        """Without messages that are copies of another one, where all that repeat a stamp are."""
        repeats = self.instants_ns.size < len(self)
        if self.messages is None or not repeats or not repeats_are_copies(self.messages):
            return self
        kept = ~copies(self.messages)
        received_ns = None if self.received_ns is None else self.received_ns[kept]
        stamps_ns, lasts_ns = self.stamps_ns[kept], self.lasts_ns[kept]
        return replace(self, stamps_ns=stamps_ns, received_ns=received_ns, lasts_ns=lasts_ns)

    @cached_property
    def travel_m(self) -> FloatArray | None:
        """(m,) path driven until each distinct stamp, by the first odometry that drives and covers
        all of them; None without one."""
        since_s = (self.instants_ns - self.instants_ns[:1]) * 1e-9
        for odometry in self.odometries:
            order = order_once(odometry.stamps_ns)
            stamps_ns, positions_m = odometry.stamps_ns[order], odometry.positions_m[order]
            if stamps_ns.size < 2 or not np.isfinite(positions_m).all():
                continue
            at_s = (stamps_ns - self.instants_ns[0]) * 1e-9
            driven_m = np.append(
                0.0, np.cumsum(np.linalg.norm(np.diff(positions_m, axis=0), axis=1))
            )
            covers = at_s[0] <= self.period_s and at_s[-1] >= since_s[-1] - self.period_s
            if covers and 0.0 < driven_m[-1] < np.inf:
                return np.asarray(np.interp(since_s, at_s, driven_m))
        return None

    @property
    def latency_s(self) -> FloatArray | None:
        """(n,) from the stamp until the message was received; None if the two cannot be compared.

        They count from different origins where most of them are an hour and more apart.
        """
        if self.received_ns is None or not len(self):
            return None
        latency_ns = self.received_ns - self.stamps_ns
        apart = abs(float(np.median(latency_ns))) > _SAME_ORIGIN_NS
        return None if apart else np.asarray(latency_ns * 1e-9)

    @property
    def is_copied(self) -> bool:
        """Whether the times of receipt are the stamps over again, and so say nothing."""
        return are_copies(self.received_ns, self.stamps_ns)


def series_of(recording: Recording) -> list[StampSeries]:
    """The streams whose stamps matter; joint states and what never moves are none."""
    found = [
        StampSeries(
            subject=s.topic,
            kind="lidar",
            stamps_ns=s.stamps_ns,
            received_ns=s.received_ns,
            lasts_ns=scan_durations_ns(s),
            odometries=recording.odometries,
            messages=s,
        )
        for s in recording.scans
    ]
    found += [_instants(s.topic, "imu", s) for s in recording.imus]
    scan_topics = {scans.topic for scans in recording.scans}
    found += [
        _instants(s.topic, "wheels", s)
        for s in (*recording.ticks, *recording.odometries)
        if s.topic not in scan_topics  # in CARMEN logs a laser line carries the odometry
    ]
    found += [_instants(f"{e.topic} {e.name}", "transform", e) for e in recording.moving]
    return [_on_clock(series, recording.clock_ns) for series in found if len(series)]


def usual_step_s(steps_s: FloatArray) -> float:
    """The period of a beat of which some messages are missing; steps_s: (n,), one or more.

    Stamps in whole milliseconds alternate between two steps: the mean of both is the period.
    """
    middle_s = float(np.median(steps_s))
    return float(steps_s[np.abs(steps_s - middle_s) <= 0.5 * abs(middle_s)].mean())


def without_missing(stamps_ns: IntArray) -> IntArray:
    """(n,) with the time of missing messages taken out, where steps are whole multiples of one."""
    steps_ns = np.diff(stamps_ns)
    period_ns = 1e9 * usual_step_s(steps_ns * 1e-9) if steps_ns.size else 0.0
    if not period_ns > 0.0:
        return stamps_ns
    counts = np.rint(steps_ns / period_ns)
    whole = np.abs(steps_ns / period_ns - counts) < _WHOLE
    if whole.mean() < _MOSTLY or not 0.0 < (counts > 1.0).mean() < 0.5:
        return stamps_ns
    longer_ns = np.rint(np.maximum(counts - 1.0, 0.0) * period_ns).astype(np.int64)
    return np.asarray(stamps_ns - np.concatenate([[0], np.cumsum(longer_ns)]))


def spread_s(stamps_ns: IntArray, apart: int) -> float:
    """How much the time from a message to the one so many later varies: sigma by the median
    deviation within some 200 neighbours, so that single gaps and a slow change do not count.

    stamps_ns: (n,).
    """
    elapsed_s = (stamps_ns[apart:] - stamps_ns[:-apart]) * 1e-9
    parts = np.array_split(elapsed_s, max(elapsed_s.size // _LOCAL_STEPS, 1))
    deviations = [np.abs(part - np.median(part)) for part in parts if part.size]
    return SIGMAS_PER_MEDIAN * float(np.median(np.concatenate(deviations))) if deviations else 0.0


def beat_scatter_s(stamps_ns: IntArray) -> float | None:
    """Sigma of the stamps about an even beat, None where there is none below them.

    Stamps that scatter about a beat stay near it however many messages one counts on; where the
    sensor itself comes unevenly they wander off. stamps_ns: (n,).
    """
    whole_ns = without_missing(stamps_ns)
    near_s, far_s = spread_s(whole_ns, _APART), spread_s(whole_ns, _FAR_APART)
    period_s = float(np.median(np.diff(stamps_ns))) * 1e-9
    wanders = far_s > _BEAT_GROWTH * near_s and far_s > 0.1 * _EVEN_SHARE * abs(period_s)
    return None if wanders else near_s / 2.0**0.5


def held_up_s(stamps_ns: IntArray) -> FloatArray:
    """(n,) by how much messages were held up that came together at the end of a pause, 0 of others.

    As many come as were due: none is missing, and they were stamped when they were let through.
    """
    steps_s = np.diff(stamps_ns) * 1e-9
    late_s = np.zeros(stamps_ns.size)
    period_s = usual_step_s(steps_s) if steps_s.size else 0.0
    apart = np.flatnonzero(np.append(steps_s > TOGETHER * period_s, True))
    after = np.searchsorted(apart, np.arange(1, steps_s.size + 1))
    together = apart[after] - np.arange(steps_s.size)  # messages that came after each step
    paused = (steps_s > 2.0 * period_s) & (together > 1)
    for at in np.flatnonzero(paused & (steps_s < (together + 1.0) * period_s)):
        count = int(together[at])
        late_s[at + 1 : at + 1 + count] = steps_s[at] - period_s * np.arange(1, count + 1)
    return np.maximum(late_s, 0.0)


def is_even(stamps_ns: IntArray) -> bool:
    """Whether messages come at a beat, near enough to count those that are missing.

    Bursts have none: within one the steps are alike, and far shorter than messages come. stamps_ns:
    (n,).
    """
    period_s = abs(float(np.median(np.diff(stamps_ns)))) * 1e-9
    together = min(_FAR_APART, stamps_ns.size - 1)
    elapsed_s = float(np.median(stamps_ns[together:] - stamps_ns[:-together])) * 1e-9
    if period_s < _BURST_SHARE * elapsed_s / together:
        return False
    if spread_s(stamps_ns, 1) < 0.5 * _EVEN_SHARE * period_s:
        return True
    scatter_s = beat_scatter_s(stamps_ns)
    return scatter_s is not None and scatter_s < _EVEN_SHARE * period_s


def _instants(subject: str, kind: Kind, of: RawStream | TransformEdge) -> StampSeries:
    none = np.zeros_like(of.stamps_ns)
    return StampSeries(subject, kind, of.stamps_ns, of.received_ns, none, messages=of)


def _on_clock(series: StampSeries, clock_ns: IntArray | None) -> StampSeries:
    """Times of receipt on the simulated clock, where stamps are on it and the recorder was not."""
    if series.received_ns is None or clock_ns is None or len(clock_ns) < 2:
        return series
    if series.latency_s is not None:
        return series
    order = np.argsort(clock_ns[:, 1], kind="stable")
    shown_ns, when_ns = clock_ns[order].T
    begin_ns = int(when_ns[0])
    seconds = np.interp(
        (series.received_ns - begin_ns) * 1e-9,
        (when_ns - begin_ns) * 1e-9,
        (shown_ns - shown_ns[0]) * 1e-9,
    )
    received_ns = shown_ns[0] + np.rint(seconds * 1e9).astype(np.int64)
    return replace(series, received_ns=received_ns)
