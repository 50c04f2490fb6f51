"""Faults of the clock: what the stamps of one stream say, and when its messages are received."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.core.types import BoolArray, IntArray
from slamsim.recording import Messages, Recording
from slamsim.recording.edits.base import IMUS, SCANS, WHEELS, CannotEdit, Edit, Target
from slamsim.recording.edits.messages import ChangeMessages, SelectMessages, select
from slamsim.recording.edits.stamps import Restamp, ScaleStamps, ShiftReceipt, ShiftStamps
from slamsim.sensors.faults.base import Fault, some_of, span_ns, spells

StreamName = Literal["lidar", "imu", "wheels"]
_TARGETS: Mapping[StreamName, Target] = {"lidar": SCANS, "imu": IMUS, "wheels": WHEELS}

_NS = 1e9
MIN_SHARE_LOST = 0.1
"""Of a step by which rounding must move stamps apart; a common shift is another fault."""


class StampsFault(Fault, ABC):
    """A fault of one stream's stamps."""

    stream: StreamName
    """Whose: lidar, imu or wheels (counters, joints, odometry and its transform)."""

    @property
    def target(self) -> Target:
        return _TARGETS[self.stream]


class TimeOffset(StampsFault):
    """All stamps are late, or early, by the same."""

    kind: Literal["time_offset"]
    offset_s: float = Field(ge=-1e10, le=1e10)
    """Stamp less the right one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ShiftStamps(self.target, round(self.offset_s * _NS))


class FramesLate(StampsFault):
    """Messages carry the stamps of later ones: the data have waited in a queue."""

    kind: Literal["frames_late"]
    messages: int = Field(ge=1, le=1000)
    """By how many periods the stamp is too late."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def delayed(stamps: IntArray) -> IntArray:
            period_ns = _period_ns(stamps)
            ends = stamps[-1:] + period_ns * np.arange(1, self.messages + 1)
            return np.concatenate([stamps, ends])[self.messages :]

        return Restamp(self.target, delayed)


class ClockDrift(StampsFault):
    """The stream's clock runs too fast or too slow."""

    kind: Literal["clock_drift"]
    drift_ppm: float = Field(ge=-1e5, le=1e5)
    """Microseconds gained in each second."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleStamps(self.target, self.drift_ppm * 1e-6)


class ClockStep(StampsFault):
    """The stream's clock is set halfway through the recording."""

    kind: Literal["clock_step"]
    jump_s: float = Field(ge=-1e4, le=1e4)
    """By how much its stamps are later from then on."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        start_ns, end_ns = span_ns(recording)
        set_ns, jump_ns = (start_ns + end_ns) // 2, round(self.jump_s * _NS)

        def after_it_was_set(stamps: IntArray) -> IntArray:
            return stamps + np.where(stamps > set_ns, jump_ns, 0)

        return Restamp(self.target, after_it_was_set)


class StampsQuantised(StampsFault):
    """Stamps are rounded down to a coarse clock's ticks."""

    kind: Literal["stamps_quantised"]
    step_s: float = Field(gt=0.0, le=10.0)
    """From one tick of the clock to the next."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        step_ns = max(round(self.step_s * _NS), 1)

        def rounded(stamps: IntArray) -> IntArray:
            lost = stamps % step_ns
            if np.ptp(lost) < MIN_SHARE_LOST * step_ns:
                raise CannotEdit(f"stamps of {recording.name} tick with that clock already")
            return stamps - lost

        return Restamp(self.target, rounded)


class StampsJitter(StampsFault):
    """The stamp is that of publishing: later than the measurement by a changing delay."""

    kind: Literal["stamps_jitter"]
    delay_s: float = Field(gt=0.0, le=10.0)
    """Mean of the exponentially distributed delay."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        delays: dict[int, IntArray] = {}

        def published(stamps: IntArray) -> IntArray:
            if stamps.size not in delays:  # topics of one driver are published together
                late_ns = rng.exponential(self.delay_s * _NS, stamps.size).astype(np.int64)
                delays[stamps.size] = late_ns
            return np.asarray(np.maximum.accumulate(stamps + delays[stamps.size]))

        return Restamp(self.target, published)


class StampsRepeated(StampsFault):
    """Some messages carry the stamp of the one before."""

    kind: Literal["stamps_repeated"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages; evenly spread: 0.5 is every second one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def repeated(stamps: IntArray) -> IntArray:
            count = np.floor(np.arange(stamps.size) * self.share)
            again = np.flatnonzero(np.diff(count) > 0) + 1
            source = np.arange(stamps.size)
            source[again] = again - 1
            return stamps[source]

        return Restamp(self.target, repeated)


class StampsBackward(StampsFault):
    """Single stamps lie before the one that came before."""

    kind: Literal["stamps_backward"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages that step back, by one and a half periods."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def stepped(stamps: IntArray) -> IntArray:
            back = some_of(stamps.size, self.share, rng)
            return stamps - np.where(back, round(1.5 * _period_ns(stamps)), 0)

        return Restamp(self.target, stepped)


class StampsInvented(StampsFault):
    """A converter has numbered the messages that it had at a constant rate, lost ones forgotten."""

    kind: Literal["stamps_invented"]
    lost_share: float = Field(ge=0.0, lt=1.0)
    """Of the messages that were lost before, in runs of ten."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def renumbered(messages: Messages) -> Messages:
            first = rng.random(messages.stamps_ns.size) < self.lost_share / 10.0
            lost = np.convolve(first, np.ones(10))[: messages.stamps_ns.size] > 0.0
            messages = select(messages, ~lost)
            stamps = messages.stamps_ns
            even = stamps[:1] + np.arange(stamps.size) * _period_ns(stamps)
            return replace(messages, stamps_ns=even, received_ns=even.copy())

        return ChangeMessages(self.target, renumbered)


class StreamGaps(StampsFault):
    """Messages are missing, for a while at a time."""

    kind: Literal["stream_gaps"]
    gap_s: float = Field(gt=0.0, le=1000.0)
    """Length of each gap."""
    gaps: int = Field(default=3, ge=1, le=1000)
    """How many, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def left(messages: Messages) -> BoolArray:
            rows = ~spells(messages.stamps_ns, self.gaps, self.gap_s)
            if not rows.any():
                raise CannotEdit(f"gaps of {self.gap_s:g} s leave nothing of {recording.name}")
            return rows

        return SelectMessages(self.target, left)


class StreamCut(StampsFault):
    """A stream ends before the recording does."""

    kind: Literal["stream_cut"]
    kept_share: float = Field(gt=0.0, lt=1.0)
    """Part of its time that is there."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def early(messages: Messages) -> BoolArray:
            stamps_ns = messages.stamps_ns
            length_ns = self.kept_share * (stamps_ns.max(initial=0) - stamps_ns[:1])
            return np.asarray(stamps_ns - stamps_ns[:1] <= length_ns)

        return SelectMessages(self.target, early)


class ReceivedOtherwise(StampsFault):
    """Messages are received long after their stamp, or before it."""

    kind: Literal["received_otherwise"]
    by_s: float = Field(ge=-1e4, le=1e4)
    """By how much later they are received."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ShiftReceipt(self.target, round(self.by_s * _NS))


def _period_ns(stamps_ns: IntArray) -> int:
    return int(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0
