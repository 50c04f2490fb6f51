"""A robot elsewhere: what is told once, and what a full disk or a failing look leave behind."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import cast

import pytest
from scan_recording import healthy

from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.open import open_recording
from slamsim.live import controls
from slamsim.live.hub import Message
from slamsim.live.live_map import LiveMap, _Lag
from slamsim.live.mapping import MappingProcess
from slamsim.live.remote import recording
from slamsim.live.remote.events import LateTopics, Silence
from slamsim.live.remote.recording import Recordings
from slamsim.recording import RawScans, RawStream
from slamsim.run.live.serving import run_until_signal

CLOCK = TopicKind("/clock", "rosgraph_msgs/msg/Clock")
ODOM = TopicKind("/odom", "nav_msgs/msg/Odometry")
IMAGE = TopicKind("/image", "sensor_msgs/msg/Image")


def test_silence_and_lag_are_told_as_they_begin_and_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    monkeypatch.setattr("slamsim.live.remote.events.time.monotonic", lambda: now_s[0])
    silence, lag = Silence(), _Lag()
    told = []
    for now_s[0], lag_s in ((1.0, 0.0), (6.0, 31.0), (7.0, 20.0), (8.0, 0.5)):
        if now_s[0] == 7.0:
            silence.scan_came()
        told.append([*silence.news(), *lag.news(lag_s)])
    assert told == [
        [],
        [
            "no scan for 6 s",
            "SLAM is 31 s behind: scans are left out until it has caught up",
        ],
        ["scans come again"],
        ["SLAM has caught up"],
    ]


def test_topics_that_come_late_are_told_once_and_others_never() -> None:
    late = LateTopics(["/clock"])
    assert list(late.news([CLOCK, IMAGE])) == []
    (told,) = late.news([CLOCK, ODOM, IMAGE])
    assert told.startswith("/odom appeared late")
    assert list(late.news([CLOCK, ODOM])) == []


def test_a_recording_ends_whole_before_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = [Message(CLOCK, number, b"\0\1\0\0" + bytes(8)) for number in range(3)]
    recordings = Recordings(tmp_path)
    folder = recordings.begin([CLOCK], [])
    monkeypatch.setattr(recording, "free_bytes", lambda path: recording.RESERVE_BYTES - 1)
    assert recordings.write(messages) == folder
    assert recordings.folder is None and recordings.write(messages) is None
    clock_ns = open_recording(folder).recording.clock_ns
    assert clock_ns is not None and len(clock_ns) == 3


def test_a_loop_ends_where_the_look_at_it_fails() -> None:
    class Waiting:
        def __init__(self) -> None:
            self.over = Event()

        def run(self) -> None:
            self.over.wait()

        def stop(self) -> None:
            self.over.set()

    def fail() -> None:
        raise SlamsimError("the terminal is gone")

    loop = Waiting()
    with pytest.raises(SlamsimError, match="terminal"):
        run_until_signal(loop, fail)
    assert loop.over.is_set()


def test_a_loop_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controls, "_ANSWER_S", 0.01)
    with pytest.raises(SlamsimError, match="did not answer"):
        controls.Calls().answer(lambda: None)


def test_a_slam_that_lags_gets_no_scans_until_it_has_caught_up() -> None:
    class Lagging:
        lag_s = 31.0

        def __init__(self) -> None:
            self.taken: list[list[str]] = []

        def take(self, streams: list[RawStream]) -> None:
            self.taken.append([stream.topic for stream in streams])

    process = Lagging()
    known = LiveMap(cast(MappingProcess, process))
    streams = healthy().streams
    for process.lag_s in (31.0, 2.0, 0.5):
        known.take(streams)
    every = [stream.topic for stream in streams]
    without = [stream.topic for stream in streams if not isinstance(stream, RawScans)]
    assert process.taken == [without, without, every] and every != without
    assert [words.split()[-1] for words in known.events] == ["up", "up"]
