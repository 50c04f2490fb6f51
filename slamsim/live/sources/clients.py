"""Robots behind a server, and which protocol it speaks: Foxglove's (foxglove_bridge of ROS 1 or ROS
2, a program with the Foxglove SDK) or rosbridge_suite's; another slamsim speaks both.

Foxglove's is described in docs/spec.md of github.com/foxglove/ws-protocol.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import InvalidHandshake, InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection
from websockets.typing import Subprotocol

from slamsim.guard.errors import InputRefused, reason_of, shown
from slamsim.guard.limits import LIMITS
from slamsim.io.bag2.writer import TopicKind, described
from slamsim.io.ros.foxglove_schemas import Translation, translation
from slamsim.io.ros.message_types import WRITTEN_AS, MessageTypes, normal_type_name, ros2_types
from slamsim.io.ros.values import (
    WrongMessage,
    cdr_of,
    cdr_of_message,
    is_ros1_name,
    known_type,
    plain_values,
    ros1_of,
)
from slamsim.live.rosbridge import Fragments, json_text, parsed, png_content
from slamsim.live.sources.source import LiveSource, Tell, connected, objects_of, text_of

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_DATA = 0x01
_HEAD = struct.Struct("<BIQ")
_WRITTEN_AS = {"cdr": "ros2msg", "ros1": "ros1msg"}
"""How definitions are written where a channel does not say, by its encoding."""


class FoxgloveSource(LiveSource):
    """Takes the encodings cdr and ros1, and Foxglove's own schemas; a topic of others is not
    listed."""

    subprotocols = SUBPROTOCOLS

    def _greet(self, connection: ClientConnection) -> None:
        self._types = MessageTypes()
        self._translations: dict[int, Translation] = {}
        self._channels: dict[int, TopicKind] = {}
        self._subscribed: dict[int, int] = {}
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
            if not isinstance(number, int):
                continue
            schema = text_of(channel, "schema")
            if (turn := _translation(kind, encoding, schema)) is not None:
                self._translations[number] = turn
                self._channels[number] = TopicKind(topic, turn.type_name)
            if encoding not in _WRITTEN_AS:
                continue
            written_as = channel.get("schemaEncoding") or _WRITTEN_AS[encoding]
            if written_as not in WRITTEN_AS:
                continue
            self._types.declare(topic, kind, encoding)
            self._types.define(kind, str(written_as), schema)
            self._channels[number] = TopicKind(topic, self._types.type_name(topic))
        self._changed(connection)

    def _unadvertised(self, connection: ClientConnection, told: Mapping[str, Any]) -> None:
        numbers = told.get("channelIds")
        gone = numbers if isinstance(numbers, list) else []
        for number in (each for each in gone if isinstance(each, int)):
            self._channels.pop(number, None)
            self._translations.pop(number, None)
            self._subscribed = {n: one for n, one in self._subscribed.items() if one != number}
        self._changed(connection)

    def _changed(self, connection: ClientConnection) -> None:
        self._has_topics(connection, {one.name: one for one in self._channels.values()})

    def _ask_for(self, connection: ClientConnection, names: Iterable[str]) -> None:
        wanted, asked = set(names), {self._channels[one].name for one in self._subscribed.values()}
        requests = []
        for channel, topic in self._channels.items():
            if topic.name in wanted - asked:
                number = next(self._numbers)
                self._subscribed[number] = channel
                asked.add(topic.name)
                requests.append({"id": number, "channelId": channel})
        if requests:
            connection.send(json.dumps({"op": "subscribe", "subscriptions": requests}))

    def _message(self, frame: bytes) -> None:
        if len(frame) < _HEAD.size:
            raise WrongMessage(f"a message of {len(frame)} bytes is too short")
        _, number, _ = _HEAD.unpack_from(frame)
        channel = self._subscribed.get(number)
        if channel is None:
            return
        topic, data = self._channels[channel], frame[_HEAD.size :]
        try:
            turn = self._translations.get(channel)
            self._arrived(topic, self._cdr(topic, data) if turn is None else turn.cdr(data))
        except Exception as error:  # of many types, for damage of any kind
            self._notice(f"messages of {topic.name} are left out: {reason_of(error)}")

    def _cdr(self, topic: TopicKind, data: bytes) -> bytes:
        message = self._types.deserialize(topic.name, data)
        as_it_is = self._types.is_cdr(topic.name)
        return data if as_it_is else cdr_of_message(topic.type_name, message)

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


def _translation(schema_name: str, encoding: str, schema: str) -> Translation | None:
    """A schema that is no text comes in base64; what is none is no schema either."""
    binary = b""
    if encoding == "protobuf":
        with suppress(ValueError):
            binary = base64.b64decode(schema)
    return translation(schema_name, encoding, binary)


def _publishing(told: Mapping[str, Any]) -> str:
    """The encoding in which a server takes messages, empty for none that is known."""
    can, encodings = told.get("capabilities"), told.get("supportedEncodings")
    if not isinstance(can, list) or "clientPublish" not in can or not isinstance(encodings, list):
        return ""
    return next((name for name in _WRITTEN_AS if name in encodings), "")


_TOPICS = "/rosapi/topics"
_PERIOD_S = 1.0
"""How often a bridge is asked for its topics."""


class RosbridgeSource(LiveSource):
    """Asks for CBOR, and takes JSON and PNG as well."""

    _asked_topics_s = math.inf

    def _greet(self, connection: ClientConnection) -> None:
        self._fragments = Fragments(LIMITS.bag_record_bytes)
        self._told_types: Mapping[str, str] = {}
        self._advertised: set[str] = set()
        self._asked: set[str] = set()
        self._numbers = itertools.count()
        self._ask_for_topics(connection)

    def topics(self) -> Sequence[TopicKind]:
        """As of about a second ago: a server of rosbridge tells topics only when it is asked."""
        connection = self._connection
        if connection is not None and time.monotonic() > self._asked_topics_s + _PERIOD_S:
            self._try(lambda: self._ask_for_topics(connection))
        return super().topics()

    def _ask_for_topics(self, connection: ClientConnection) -> None:
        self._asked_topics_s = time.monotonic()
        _say(connection, op="call_service", id="topics", service=_TOPICS, args={})

    def _heard(self, connection: ClientConnection, frame: str | bytes) -> None:
        self._obey(connection, parsed(frame), depth=0)

    def _obey(self, connection: ClientConnection, told: Mapping[str, Any], depth: int) -> None:
        """depth: how many wrappings of the message were taken off."""
        what = told.get("op")
        if what == "publish":
            self._published(told)
        elif what == "service_response" and told.get("id") == "topics":
            self._topics_told(connection, told)
        elif what == "status" and told.get("level") in ("error", "warning"):
            self._notice(f"the server says: {shown(told.get('msg'), 200)}")
        elif what in ("fragment", "png") and depth < 2:
            whole = (
                png_content(told.get("data"))
                if what == "png"
                else self._fragments.add(told, time.monotonic())
            )
            if whole is not None:
                self._obey(connection, parsed(whole), depth + 1)

    def _published(self, told: Mapping[str, Any]) -> None:
        kind = self._kinds.get(text_of(told, "topic"))
        if kind is None or kind.name not in self._wanted:
            return
        try:
            self._arrived(kind, cdr_of(kind.type_name, told.get("msg"), time.time_ns()))
        except WrongMessage as error:
            self._notice(f"messages of {kind.name} are left out: {error}")

    def _topics_told(self, connection: ClientConnection, told: Mapping[str, Any]) -> None:
        values = told.get("values")
        if told.get("result") is False or not isinstance(values, Mapping):
            self._fail(f"it does not answer {_TOPICS}: {shown(values, 200)}")
            return
        names, types = values.get("topics"), values.get("types")
        if not (
            isinstance(names, list)
            and isinstance(types, list)
            and all(isinstance(text, str) for text in [*names, *types])
        ):
            self._fail(f"it answers {_TOPICS} with {shown(values, 200)}")
            return
        self._told_types = dict(zip(names, types, strict=False))
        kinds = {n: TopicKind(n, normal_type_name(t)) for n, t in self._told_types.items()}
        self._has_topics(connection, kinds)

    def _ask_for(self, connection: ClientConnection, names: Iterable[str]) -> None:
        for name in names:
            if name not in self._told_types or name in self._asked:
                continue
            kind = self._told_types[name]
            known_type(kind)
            self._asked.add(name)
            request = {"topic": name, "type": kind, "compression": "cbor"}
            _say(connection, op="subscribe", id=f"slamsim:{name}", **request)

    def _send(self, connection: ClientConnection, topic: TopicKind, data: bytes) -> None:
        ros1 = any(map(is_ros1_name, self._told_types.values()))
        kind = topic.type_name.replace("/msg/", "/") if ros1 else topic.type_name
        if topic.name not in self._advertised:
            self._advertised.add(topic.name)
            _say(connection, op="advertise", topic=topic.name, type=kind)
        values: Any = plain_values(topic.type_name, data, ros1)
        message = {"op": "publish", "topic": topic.name, "msg": _ros1(values) if ros1 else values}
        connection.send(json_text(message), text=True)


def _ros1(value: Any) -> Any:
    """Times with the names of ROS 1 alone: its rosbridge refuses a field that it does not know."""
    if isinstance(value, dict):
        if "nsecs" in value:
            return {name: value[name] for name in ("secs", "nsecs")}
        return {name: _ros1(one) for name, one in value.items()}
    return [_ros1(one) for one in value] if isinstance(value, list) else value


def _say(connection: ClientConnection, **operation: object) -> None:
    connection.send(json.dumps(operation))


def open_source(url: str, tell: Tell) -> LiveSource:
    """The server at a URL, not connected yet: its block connects.

    A server of the Foxglove protocol picks one of its subprotocols; one of rosbridge has none, or
    refuses them. tell: gets a sentence each when the connection breaks, or messages are left out.
    Raises InputRefused for no such URL, and where nothing answers.
    """
    _require_url(url)
    try:
        with connected(url, SUBPROTOCOLS) as connection:
            speaks_foxglove = connection.subprotocol in SUBPROTOCOLS
    except InvalidStatus as error:
        if error.response.status_code in (401, 403):
            body = (error.response.body or b"").decode(errors="replace").strip()
            raise InputRefused(url, f"the server refuses: {shown(body, 200)}") from None
        speaks_foxglove = False
    except InvalidHandshake:
        speaks_foxglove = False
    except (WebSocketException, OSError, EOFError) as error:
        raise InputRefused(url, f"nothing answers there: {reason_of(error)}") from None
    return FoxgloveSource(url, tell) if speaks_foxglove else RosbridgeSource(url, tell)


def _require_url(url: str) -> None:
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        valid = False
    if not valid:
        raise InputRefused(url, "an address such as ws://robot:9090 or ws://robot:8765 is needed")
