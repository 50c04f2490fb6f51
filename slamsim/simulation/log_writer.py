"""Writes the rosbag2 recording of a drive during the drive."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from slamsim.config.streams import SinkEntry
from slamsim.core.types import Drive
from slamsim.io.bag2.writer import GrowingBag, TopicKind
from slamsim.io.ros.encoding import Outgoing, outgoing, stream_messages
from slamsim.io.staged_writer import StagedWriter
from slamsim.recording import Recording
from slamsim.sensors.readings import Readings
from slamsim.simulation.header import LogHeader
from slamsim.simulation.recorder import TOPICS, DriveRecorder

_LATCHED = ("/robot_description", "/tf_static")


class Sink(AbstractContextManager[Any], Protocol):
    """Takes messages of declared topics in the order of their arrival, until its block ends."""

    def add(self, streams: Sequence[Outgoing]) -> None:
        """The next messages of some topics, to be kept until their time has come."""
        ...

    def release(self, until_ns: int | None) -> None:
        """Pass on what has arrived by then, or all of it."""
        ...


def recorded_topics(header: LogHeader) -> list[TopicKind]:
    """All topics of a simulated recording."""
    types = {**TOPICS, **header.topics}
    return [TopicKind(topic, kind, topic in _LATCHED) for topic, kind in types.items()]


def begun_bag(folder: Path, header: LogHeader) -> GrowingBag:
    """An empty recording that says all that it says once; a context manager."""
    custom = {"epoch": header.epoch, **dict(sorted(header.metadata.items()))}
    return GrowingBag(folder, recorded_topics(header), custom)


class LogWriter(StagedWriter):
    """As a ``GrowingBag``: all that a ``DriveRecorder`` records.

    name: of the recordings that ``write`` gives. sinks: where the same messages go besides.
    """

    def __init__(
        self, folder: Path, header: LogHeader, name: str = "", sinks: Sequence[SinkEntry] = ()
    ) -> None:
        super().__init__()
        topics = recorded_topics(header)
        with ExitStack() as opened:  # closes what was begun where a later sink cannot begin
            bag: Sink = opened.enter_context(begun_bag(folder, header))
            started = [opened.enter_context(entry.start(topics)) for entry in sinks]
            self._open.push(opened.pop_all())
        self._sinks: tuple[Sink, ...] = (bag, *started)
        self._recorder = DriveRecorder(name, header)
        self._is_first = True

    def write(self, readings: Readings, window: Drive) -> Recording:
        """The next window of the drive and what was sensed up to its end, as it is recorded.

        Messages that arrive after the window's end are held back until their time has come.
        """
        part = self._recorder.take([readings], [window])
        said = part.recording if self._is_first else said_once_left_out(part.recording)
        self._is_first = False
        streams = outgoing(said, self._recorder.constants)
        messages = [*streams, *map(stream_messages, part.beside)]
        for sink in self._sinks:
            sink.add(messages)
            sink.release(int(window.stamps_ns[-1]))
        return part.recording

    def _finish(self) -> None:
        rest = [stream_messages(stream) for stream in self._recorder.rest()]
        for sink in self._sinks:
            sink.add(rest)


def said_once_left_out(part: Recording) -> Recording:
    """A part of a recording that others went before."""
    return replace(part, robot_description=None, transforms=part.moving)
