"""Recovered and lost messages of a damaged recording, per topic; whether a message decodes as its
type.

Readers refuse a recording in which a message does not decode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from slamsim.guard.errors import shown
from slamsim.io.ros.message_types import MessageTypes

PATIENCE = 8
"""How often over the bytes of a file are looked through for records that begin in damaged ones."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Bytes of a file that are of no use.

    messages: how many were in it, by topic; None where nothing tells. gap_s: from the last message
    received before it to the first one after it; None at either end of the file.
    """

    path: Path
    first_byte: int
    bytes: int
    reason: str
    messages: Mapping[str, int] | None = None
    gap_s: float | None = None


@dataclass(frozen=True, slots=True)
class TopicReport:
    """messages, their bytes, and when the first and last of them was received: those recovered.

    lost: how many were not. lost_is_known: from what the recording says, else estimated from how
    many of its bytes are lost.
    """

    topic: str
    type_name: str
    messages: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    lost: int = 0
    lost_is_known: bool = True

    @property
    def seconds(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9

    def joined(self, other: TopicReport) -> TopicReport:
        """Both together."""
        parts = [report for report in (self, other) if report.messages] or [self]
        return TopicReport(
            self.topic,
            self.type_name or other.type_name,
            self.messages + other.messages,
            self.bytes + other.bytes,
            min(part.first_ns for part in parts),
            max(part.last_ns for part in parts),
            self.lost + other.lost,
            self.lost_is_known and other.lost_is_known,
        )


@dataclass(frozen=True, slots=True)
class Recovered:
    """recording: what stands there now, to be read. notes: what else to know, in sentences."""

    recording: Path
    topics: tuple[TopicReport, ...]
    losses: tuple[Loss, ...]
    notes: tuple[str, ...]

    @property
    def messages(self) -> int:
        return sum(topic.messages for topic in self.topics)


@dataclass(slots=True)
class RecoveryReport:
    """Counts while one file is copied.

    announced: how many messages the whole file held, by topic, if it says so. packed_bytes: how
    much of the file the recovered messages take.
    """

    path: Path
    losses: list[Loss] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    announced: Mapping[str, int] | None = None
    packed_bytes: int = 0
    _topics: dict[str, TopicReport] = field(default_factory=dict)
    _last_ns: int | None = None
    _open: list[int] = field(default_factory=list)

    def know(self, topic: str, type_name: str) -> None:
        """A topic that is in the file, whether or not a message of it is recovered."""
        self._topics.setdefault(topic, TopicReport(topic, type_name))

    def keep(self, topic: str, count: int, size: int, span_ns: tuple[int, int]) -> None:
        """Messages of one topic. size: their bytes. span_ns: the first and last log time."""
        known = self._topics.get(topic) or TopicReport(topic, "")
        self._topics[topic] = known.joined(TopicReport(topic, "", count, size, *span_ns))
        for index in self._open:
            gap_s = max(span_ns[0] - (self._last_ns or 0), 0) * 1e-9
            self.losses[index] = replace(self.losses[index], gap_s=gap_s)
        self._open.clear()
        self._last_ns = max(span_ns[1], self._last_ns or span_ns[1])

    def lose(
        self, first_byte: int, size: int, reason: str, messages: Mapping[str, int] | None = None
    ) -> None:
        """Bytes that are of no use, and how many messages were in them, if that is known."""
        if self._last_ns is not None:
            self._open.append(len(self.losses))
        self.losses.append(Loss(self.path, first_byte, size, reason, messages))

    def note(self, sentence: str) -> None:
        """What else to know; said once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def topics(self) -> dict[str, TopicReport]:
        """With what is lost of each."""
        names = {*self._topics, *(self.announced or ())}
        names.update(*(loss.messages or () for loss in self.losses))
        reports = {name: self._topics.get(name) or TopicReport(name, "") for name in sorted(names)}
        return {name: self._with_lost(report) for name, report in reports.items()}

    def _with_lost(self, report: TopicReport) -> TopicReport:
        """Announced and not there; else counted in the losses, and estimated by their bytes."""
        if self.announced is not None:
            return replace(
                report, lost=max(self.announced.get(report.topic, 0) - report.messages, 0)
            )
        known = sum(loss.messages.get(report.topic, 0) for loss in self.losses if loss.messages)
        unknown_bytes = sum(loss.bytes for loss in self.losses if loss.messages is None)
        share = unknown_bytes / self.packed_bytes if self.packed_bytes else 0.0
        estimated = round(share * report.messages)
        return replace(report, lost=known + estimated, lost_is_known=unknown_bytes == 0)


def recovered(
    recording: Path, reports: Sequence[RecoveryReport], announced: Mapping[str, int] | None = None
) -> Recovered:
    """Of all files of a recording. announced: messages by topic, if something beside them tells."""
    topics: dict[str, TopicReport] = {}
    for report in reports:
        for name, more in report.topics().items():
            topics[name] = topics[name].joined(more) if name in topics else more
    for name, count in (announced or {}).items():
        known = topics.get(name) or TopicReport(name, "", lost_is_known=False)
        if not known.lost_is_known:
            lost = max(count - known.messages, 0)
            topics[name] = replace(known, lost=lost, lost_is_known=True)
    return Recovered(
        recording,
        tuple(replace(topic, topic=_printable(name)) for name, topic in sorted(topics.items())),
        tuple(loss for report in reports for loss in report.losses),
        tuple(dict.fromkeys(note for report in reports for note in report.notes)),
    )


def _printable(name: str) -> str:
    return name if name.isprintable() and len(name) <= 200 else shown(name)


class DecodableMessages:
    """Judges messages by the definitions of their types."""

    def __init__(self) -> None:
        self._types = MessageTypes()
        self._known: dict[str, bool] = {}

    def describe(
        self, topic: str, type_name: str, encoding: str, written_as: str, definition: str
    ) -> None:
        """How the messages of a topic are serialised, and their definition, if there is one."""
        self._types.declare(topic, type_name, encoding)
        if definition:
            self._types.define(type_name, written_as, definition)
        self._known.pop(topic, None)

    def __call__(self, topic: str, data: bytes) -> bool:
        """True as well where no definition tells."""
        if topic not in self._known:
            try:
                self._types.is_cdr(topic)
                self._known[topic] = True
            except Exception:
                self._known[topic] = False
        if self._known[topic]:
            try:
                self._types.deserialize(topic, data)
            except Exception:
                return False
        return True
