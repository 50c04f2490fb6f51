"""A robot behind a rosbridge server: rosbridge_suite of ROS 1 or ROS 2, or another slamsim."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from websockets.sync.client import ClientConnection

from slamsim.guard.errors import shown
from slamsim.guard.limits import LIMITS
from slamsim.io.bag2.folder import TopicKind
from slamsim.io.ros.message_types import normal_type_name
from slamsim.io.ros.values import WrongMessage, cdr_of, is_ros1_name, known_type, plain_values
from slamsim.live.rosbridge.fragments import Fragments
from slamsim.live.rosbridge.wire import json_text, parsed, png_content
from slamsim.live.sources.source import LiveSource, text_of

_TOPICS = "/rosapi/topics"
_PERIOD_S = 1.0


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
