"""The loop beside a robot that runs elsewhere: its messages in, map, pose and faults out."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.live.controls import Calls, Status
from slamsim.live.hub import Hub, Message
from slamsim.live.live_map import LiveMap
from slamsim.live.mapping import Begin, MappingProcess
from slamsim.live.published import DIAGNOSTICS, MAP
from slamsim.live.remote.checking import CheckingProcess
from slamsim.live.remote.events import LateTopics, Silence
from slamsim.live.remote.received import (
    PATIENCE_S,
    FixedTransforms,
    Inputs,
    ScanOrder,
    find_inputs,
    is_fixed,
    recording_of,
)
from slamsim.live.remote.recording import Recordings
from slamsim.live.remote.teleop import Teleop
from slamsim.live.sources.source import MessageLink
from slamsim.recording import RawScans

FIRST_S = 5.0
"""So much is looked at before the map begins: some tens of scans, which show the largest range, and
fixed transforms that a publisher repeats every second or so."""
_TURN_S = 0.05
"""So long messages are gathered before they are handed on: far below the period of a scan."""
_OWN_MAP = f"/slamsim{MAP}"


@dataclass(frozen=True, slots=True, eq=False)
class RemoteSetup:
    """folder: for recordings and maps. wanted: topics to map from. record: from the start.

    map_topic: where the robot is told its map; empty for one that it does not have yet.
    publishes_transform: tell it ``map -> odom``, unless it knows.
    """

    config: RunConfig
    folder: Path
    wanted: Selection = EVERYTHING
    record: bool = False
    duration_s: float = math.inf
    map_topic: str = ""
    publishes_transform: bool = True


class RemoteRobot:
    """Lives in ``run``; what other threads ask of it is done between two turns of its loop.

    topics: as ``read_topics`` gave them. hub: of those and ``SLAM_TOPICS``.
    """

    def __init__(
        self,
        setup: RemoteSetup,
        source: MessageLink,
        topics: list[TopicKind],
        hub: Hub,
        process: MappingProcess,
        checker: CheckingProcess | None,
    ) -> None:
        self.setup, self.known, self.checker = setup, LiveMap(process), checker
        self._source, self._hub, self._process = source, hub, process
        self.notes: deque[str] = deque(maxlen=100)
        """What a user is told, until it is taken."""
        self._topics = {topic.name: topic for topic in topics}
        published = {topic.name for topic in source.topics()}
        self._told = {MAP: setup.map_topic or (_OWN_MAP if MAP in published else MAP)}
        """Where the robot is told what, by SLAM's topics."""
        if DIAGNOSTICS not in published:  # as of another slamsim
            self._told[DIAGNOSTICS] = DIAGNOSTICS
        self.calls, self._stopping = Calls(), False
        """What other threads ask for."""
        self.teleop, self._fixed = Teleop(source), FixedTransforms()
        self.inputs: Inputs | None = None
        self.recordings = Recordings(setup.folder)
        self.received = 0
        """Messages so far."""
        self.begun_s, self._now_ns = time.monotonic(), time.time_ns()
        self._order = ScanOrder()
        self._silence, self._late = Silence(), LateTopics({*self._topics, "/tf"})
        self.status = self._described()
        """As of the last turn."""

    def run(self) -> None:
        """Until ``stop`` or the end of the setup's duration. A recording is whole then.

        Raises InputRefused where nothing can be mapped, SlamsimError where SLAM or the disk fails.
        What was recorded until then is kept.
        """
        try:
            self._source.subscribe(self._topics)
            if self.setup.record:
                self.begin_recording()
            first = self._first_messages()
            if not self._stopping:
                self._begin_map()
                self._see(first)
            while not self._stopping:
                self._turn()
        finally:
            self._close()

    def stop(self) -> None:
        """End ``run`` after the turn at hand; from any thread."""
        self._stopping = True

    # What may be asked for

    def reset(self) -> None:
        """Begin a new map."""
        self._begin_map()

    def begin_recording(self) -> Path:
        """The folder that is being written."""
        latched = [m for m in self._hub.latched.values() if m.topic.name in self._topics]
        return self.recordings.begin(self._topics.values(), latched)

    # The loop

    def _first_messages(self) -> list[Message]:
        """Those until SLAM knows what it reads."""
        arrived: list[Message] = []
        begun_s = time.monotonic()
        tried_s, why = begun_s, "no message came"
        while not self._stopping:
            self.calls.heed()
            arrived += self._arrived()
            now_s = time.monotonic()
            if now_s - begun_s < FIRST_S or now_s - tried_s < 1.0:
                continue
            tried_s = now_s
            try:
                first = recording_of(self._source.url, arrived)
                self.inputs = find_inputs(first, self.setup.wanted, self._source.url)
            except InputRefused as refusal:
                why = refusal.reason
            else:
                self.known = LiveMap(self._process, self.inputs.odom_frame)
                self._note_inputs(self.inputs)
                break
            if now_s - begun_s > min(PATIENCE_S, self.setup.duration_s):
                raise InputRefused(self._source.url, why)
        return arrived

    def _begin_map(self) -> None:
        inputs, config = self.inputs, self.setup.config
        if inputs is None:
            raise SlamsimError("the robot has not sent enough yet to begin a map")
        log = inputs.log
        self.known.begin(
            Begin(config.slam, config.mapping, log.T_base_laser, log.T_base_imu, inputs.limit)
        )
        self._order = ScanOrder()

    def _note_inputs(self, inputs: Inputs) -> None:
        self.notes.extend((inputs.words, *inputs.log.warnings))
        if self.setup.publishes_transform and inputs.has_map_frame:
            self.notes.append(
                f"the robot tells where {inputs.odom_frame} is, so that is not published"
            )

    def _turn(self) -> None:
        self.calls.heed()
        self._see(self._arrived())
        self.known.heed(self._now_ns, self._post)
        if self.checker is not None:
            self.known.events.extend(self.checker.news())
        self.known.events.extend(self._silence.news())
        if self._late.is_due():
            self.notes.extend(self._late.news(self._source.topics()))
        self.status = self._described()
        self.known.diagnose(self.status, self._values(), self._post)
        self._stopping |= time.monotonic() - self.begun_s >= self.setup.duration_s

    def _arrived(self) -> list[Message]:
        """What came within a turn; clients and recording have it already."""
        found: list[Message] = []
        until_s = time.monotonic() + _TURN_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            message = self._source.receive(left_s)
            if message is None:
                break
            topic = self._topics.get(message.topic.name)
            if topic is not None:
                found.append(Message(topic, message.log_ns, message.data))
        shown = [self._fixed.with_all(m) if is_fixed(m.topic) else m for m in found]
        for message in shown:
            self._hub.publish(message.topic.name, message.log_ns, message.data)
        whole = self.recordings.write(found)
        if whole is not None:
            self.known.events.append(f"the disk is nearly full: the recording ended, {whole}/")
        if self.checker is not None:
            self.checker.take(shown)
        self.received += len(found)
        # By the clock of those who say when messages arrived: simulated time for some.
        self._now_ns = found[-1].log_ns if found else self._now_ns + round(_TURN_S * 1e9)
        return found

    def _see(self, messages: list[Message]) -> None:
        """Hand on to SLAM what it reads of them."""
        if not messages or self.inputs is None:
            return
        streams = self.inputs.of(recording_of(self._source.url, messages))
        scans = [one for one in streams if isinstance(one, RawScans)]
        if scans:
            self._silence.scan_came()
        if scans and self._order.is_another_drive(scans[0].stamps_ns):
            self._begin_another_drive()
        self.known.take(streams)

    def _begin_another_drive(self) -> None:
        self.notes.append("time went back: a new map is begun")
        if self.known.grid is not None:
            self.notes.append(f"the map before is in {self.known.save(self.setup.folder)}/")
        if self.checker is not None:
            self.checker.begin_anew()
        self._begin_map()

    def _post(self, topic: str, log_ns: int, data: bytes) -> None:
        """A message of SLAM, to the clients here and to the robot."""
        self._hub.publish(topic, log_ns, data)
        has_map = self.inputs is not None and self.inputs.has_map_frame
        where = self._told.get(topic)
        if topic == "/tf" and self.setup.publishes_transform and not has_map:
            where = topic
        if where is not None:
            self._source.publish(where, self._hub.topics[topic].type_name, data)

    def _values(self) -> Mapping[str, str]:
        """What is diagnosed of the connection and by the checker."""
        values = {"messages": str(self.received), "dropped": str(self._source.dropped)}
        if self.checker is not None:
            values["checks"] = str(self.checker.checks)
            values["faults"] = "; ".join(one.words for one in self.checker.findings)
        return values

    def _close(self) -> None:
        """Also after a failure: what the robot sent is not lost with it."""
        self.teleop.close()
        try:
            self.recordings.end()
        finally:
            self.calls.close()

    def _described(self) -> Status:
        keyframes, closures = self.known.counts
        speed_m_s, yaw_rate_rad_s = self.known.twist()
        return Status(
            stamp_ns=self._now_ns,
            rate=1.0,
            realtime_factor=1.0,
            paused=False,
            mode="manual",
            windows=0,
            late_windows=0,
            speed_m_s=speed_m_s,
            yaw_rate_rad_s=yaw_rate_rad_s,
            recording=self.recordings.folder,
            tracking=self.known.tracking,
            keyframes=keyframes,
            closures=closures,
            ended="no scans come" if self._silence.is_on else "",
        )
