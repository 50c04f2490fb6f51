"""A robot behind a server of the Foxglove WebSocket protocol: foxglove_bridge of ROS 1 or ROS 2, a
program with the Foxglove SDK, or another slamsim.

The protocol is described in docs/spec.md of github.com/foxglove/ws-protocol.
"""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any

from websockets.sync.client import ClientConnection
from websockets.typing import Subprotocol

from slamsim.guard.errors import reason_of, shown
from slamsim.io.bag2.folder import TopicKind, described
from slamsim.io.ros.message_types import WRITTEN_AS, MessageTypes
from slamsim.io.ros.standard_types import ros2_types
from slamsim.io.ros.values import WrongMessage, cdr_of_message, ros1_of
from slamsim.live.rosbridge.wire import parsed
from slamsim.live.sources.source import LiveSource, objects_of, text_of

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_DATA = 0x01
_HEAD = struct.Struct("<BIQ")
_WRITTEN_AS = {"cdr": "ros2msg", "ros1": "ros1msg"}
"""How definitions are written where a channel does not say, by its encoding."""


class FoxgloveSource(LiveSource):
    """Takes the encodings cdr and ros1; a topic of another is not listed."""

    subprotocols = SUBPROTOCOLS

    def _greet(self, connection: ClientConnection) -> None:
        self._types = MessageTypes()
        self._channels: dict[int, TopicKind] = {}
        self._subscribed: dict[int, TopicKind] = {}
        self._numbers = itertools.count()
        self._sent: dict[str, int] = {}
        self._encoding = ""

    def _heard(self, connection: ClientConnection, frame: str | bytes) -> None:
        if isinstance(frame, bytes):
            if frame[:1] == bytes([_DATA]):
                self._message(frame)
            return
        told = parsed(frame)
        what = told.get("op")
        if what == "serverInfo":
            self._encoding = _publishing(told)
        elif what == "advertise":
            self._advertised(connection, told)
        elif what == "unadvertise":
            self._unadvertised(connection, told)
        elif what == "status" and told.get("level") in (1, 2):
            self._notice(f"the server says: {shown(told.get('message'), 200)}")

    def _advertised(self, connection: ClientConnection, told: Mapping[str, Any]) -> None:
        for channel in objects_of(told, "channels"):
            number, encoding = channel.get("id"), text_of(channel, "encoding")
            topic, kind = text_of(channel, "topic"), text_of(channel, "schemaName")
            if not isinstance(number, int) or encoding not in _WRITTEN_AS:
                continue
            written_as = channel.get("schemaEncoding") or _WRITTEN_AS[encoding]
            if written_as not in WRITTEN_AS:
                continue
            self._types.declare(topic, kind, encoding)
            self._types.define(kind, str(written_as), text_of(channel, "schema"))
            self._channels[number] = TopicKind(topic, self._types.type_name(topic))
        self._changed(connection)

    def _unadvertised(self, connection: ClientConnection, told: Mapping[str, Any]) -> None:
        numbers = told.get("channelIds")
        gone = numbers if isinstance(numbers, list) else []
        for number in gone:
            topic = self._channels.pop(number, None) if isinstance(number, int) else None
            self._subscribed = {n: one for n, one in self._subscribed.items() if one is not topic}
        self._changed(connection)

    def _changed(self, connection: ClientConnection) -> None:
        self._has_topics(connection, {one.name: one for one in self._channels.values()})

    def _ask_for(self, connection: ClientConnection, names: Iterable[str]) -> None:
        wanted, asked = set(names), {one.name for one in self._subscribed.values()}
        requests = []
        for channel, topic in self._channels.items():
            if topic.name in wanted - asked:
                number = next(self._numbers)
                self._subscribed[number] = topic
                asked.add(topic.name)
                requests.append({"id": number, "channelId": channel})
        if requests:
            connection.send(json.dumps({"op": "subscribe", "subscriptions": requests}))

    def _message(self, frame: bytes) -> None:
        if len(frame) < _HEAD.size:
            raise WrongMessage(f"a message of {len(frame)} bytes is too short")
        _, number, _ = _HEAD.unpack_from(frame)
        topic = self._subscribed.get(number)
        if topic is None:
            return
        data = frame[_HEAD.size :]
        try:
            message = self._types.deserialize(topic.name, data)
            as_it_is = self._types.is_cdr(topic.name)
            self._arrived(topic, data if as_it_is else cdr_of_message(topic.type_name, message))
        except Exception as error:  # of many types, for damage of any kind
            self._notice(f"messages of {topic.name} are left out: {reason_of(error)}")

    def _send(self, connection: ClientConnection, topic: TopicKind, data: bytes) -> None:
        if not self._encoding:
            raise WrongMessage("the server takes no messages of ROS, so nothing is published there")
        if topic.name not in self._sent:
            self._sent[topic.name] = len(self._sent)
            channel = {"id": self._sent[topic.name], **self._description(topic)}
            connection.send(json.dumps({"op": "advertise", "channels": [channel]}))
        payload = ros1_of(topic.type_name, data) if self._encoding == "ros1" else data
        connection.send(struct.pack("<BI", _DATA, self._sent[topic.name]) + payload)

    def _description(self, topic: TopicKind) -> Mapping[str, str]:
        ros1 = self._encoding == "ros1"
        text = ros2_types().generate_msgdef(topic.type_name, ros_version=1)[0] if ros1 else ""
        return {
            "topic": topic.name,
            "encoding": self._encoding,
            "schemaName": topic.type_name.replace("/msg/", "/") if ros1 else topic.type_name,
            "schema": text or described(topic.type_name)[1],
            "schemaEncoding": _WRITTEN_AS[self._encoding],
        }


def _publishing(told: Mapping[str, Any]) -> str:
    """The encoding in which a server takes messages, empty for none that is known."""
    can, encodings = told.get("capabilities"), told.get("supportedEncodings")
    if not isinstance(can, list) or "clientPublish" not in can or not isinstance(encodings, list):
        return ""
    return next((name for name in _WRITTEN_AS if name in encodings), "")
