"""What clients of the Foxglove protocol ask of a live robot: messages, parameters, services."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from threading import Event, Lock, Thread
from typing import Any, cast, get_args

from foxglove import MessageSchema, Parameter, Service, ServiceRequest, ServiceSchema
from foxglove.websocket import Client, ClientChannel, StatusLevel, WebSocketServer

from slamsim.guard.errors import SlamsimError, reason_of, shown
from slamsim.guard.numbers import BadNumbers
from slamsim.io.ros.layouts import CDR_LITTLE_ENDIAN, CdrLayout
from slamsim.io.ros.message_types import normal_type_name, ros2_types
from slamsim.live.controls import Controls, Mode, Status
from slamsim.live.requests import SERVICES, SET_BOOL, SUBSCRIBED, Fields, publish
from slamsim.simulation.foxglove_channels import FoxgloveChannels, Listener, ros2_schema

ENCODINGS = "json", "cdr"
"""Of what clients send; they take the first, for which they need no definitions."""
TELL_EVERY_S = 0.25
"""How often parameters are compared with those that the clients know."""
SAME_STATUS_S, MOST_STATUSES = 1.0, 10
"""One refusal is not told again before, nor more of them in that time: they go to all clients."""

_REQUEST = {SET_BOOL: "bool data\n"}
_RESPONSE = "bool success\nstring message\n"


class Requests(Listener):
    """Obeys clients; what is refused is told to all of them as a status.

    Called on threads of the SDK, which serve all clients: what may take time is done elsewhere.
    """

    def __init__(self, channels: FoxgloveChannels, controls: Controls) -> None:
        super().__init__(channels)
        self._controls, self._types = controls, ros2_types()
        self._publishing: dict[tuple[int, int], ClientChannel] = {}
        self._goals = ThreadPoolExecutor(1, thread_name_prefix="goals")
        self._server: WebSocketServer | None = None
        self._lock, self._told_s = Lock(), dict[str, float]()

    @contextmanager
    def answering(self, server: WebSocketServer) -> Iterator[None]:
        """Inside, statuses and changed parameters are told through this server."""
        self._server, over = server, Event()
        telling = Thread(target=self._tell_changes, args=(server, over), daemon=True)
        telling.start()
        try:
            yield
        finally:
            over.set()
            telling.join()
            self._server = None
            self._goals.shutdown(cancel_futures=True)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        kind = normal_type_name(channel.schema_name)
        kinds = SUBSCRIBED.get(channel.topic, ())
        if channel.encoding not in ENCODINGS:
            self._refuse(f"messages are taken as json or cdr, not as {shown(channel.encoding)}")
        elif kind in kinds:
            self._publishing[client.id, channel.id] = channel
        elif kinds:
            self._refuse(f"{channel.topic} takes {' or '.join(kinds)}, not {shown(kind)}")
        else:
            known = ", ".join(SUBSCRIBED)
            self._refuse(f"no one listens to {shown(channel.topic)}; publish on one of {known}")

    def on_client_unadvertise(self, client: Client, channel_id: int) -> None:
        self._publishing.pop((client.id, channel_id), None)

    def on_message_data(self, client: Client, channel_id: int, data: bytes) -> None:
        channel = self._publishing.get((client.id, channel_id))
        if channel is None:
            return
        topic, kind = channel.topic, normal_type_name(channel.schema_name)
        try:
            message = self._decoded(channel.encoding, kind, data)
        except BadNumbers as error:
            self._refuse(f"{topic}: {error}")
            return
        work = partial(self._obey, topic, partial(publish, self._controls, topic, kind, message))
        if topic == "/cmd_vel":
            work()
        else:  # a way to the goal is looked for
            self._goals.submit(work)

    def on_get_parameters(
        self, client: Client, names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        values = _values(self._controls.status())
        unknown = [name for name in names if name not in values]
        if unknown:
            self._refuse(f"no parameter {shown(unknown[0])}; there are {', '.join(values)}")
        return [_parameter(name, values[name]) for name in names or values if name in values]

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """As they are from now on: those that are refused stay as they were."""
        values = _values(self._controls.status())
        for parameter in parameters:
            name, value = parameter.name, parameter.get_value()
            if name not in values:
                self._refuse(f"no parameter {shown(name)}; there are {', '.join(values)}")
            elif self._obey(name, partial(_SETTERS[name], self._controls, value)):
                values[name] = value
        named = [parameter.name for parameter in parameters if parameter.name in values]
        return [_parameter(name, values[name]) for name in named]

    def service(self, name: str) -> Service:
        """As it is told to clients."""
        kind = SERVICES[name].type_name
        request = ros2_schema(f"{kind}_Request", _REQUEST.get(kind, ""))
        response = ros2_schema(f"{kind}_Response", _RESPONSE)
        schema = ServiceSchema(
            kind,
            request=MessageSchema(encoding="cdr", schema=request),
            response=MessageSchema(encoding="cdr", schema=response),
        )
        return Service(name, schema=schema, handler=self._serve)

    def _serve(self, request: ServiceRequest) -> bytes:
        """The SDK calls this on a thread that no other client waits for, with CDR alone."""
        service = SERVICES[request.service_name]
        try:
            asked = _asked(service.type_name, request.payload)
            success, message = True, service.call(self._controls, asked)
        except SlamsimError as error:
            success, message = False, str(error)
        return CdrLayout().constant("u1", success).string(message).rows(1).tobytes()

    def _decoded(self, encoding: str, kind: str, data: bytes) -> Fields:
        if encoding == "json":
            return _from_json(data)
        try:
            return asdict(cast(Any, self._types.deserialize_cdr(data, kind)))
        except Exception as error:  # of many types, for damage of any kind
            raise BadNumbers(f"this is no {kind}: {reason_of(error)}") from None

    def _obey(self, what: str, work: Callable[[], None]) -> bool:
        """Whether it was done; why not is told."""
        try:
            work()
        except SlamsimError as error:
            self._refuse(f"{what}: {error}")
            return False
        return True

    def _refuse(self, why: str) -> None:
        now_s = time.monotonic()
        with self._lock:
            self._told_s = {w: s for w, s in self._told_s.items() if now_s - s < SAME_STATUS_S}
            if why in self._told_s or len(self._told_s) >= MOST_STATUSES:
                return
            self._told_s[why] = now_s
        if self._server is not None:
            self._server.publish_status(why, StatusLevel.Error)

    def _tell_changes(self, server: WebSocketServer, over: Event) -> None:
        told = _values(self._controls.status())
        while not over.wait(TELL_EVERY_S):
            now = _values(self._controls.status())
            changed = [_parameter(name, now[name]) for name in now if now[name] != told[name]]
            if changed:
                server.publish_parameter_values(changed)
            told = now


def _from_json(data: bytes) -> Fields:
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise BadNumbers(f"this is no JSON: {reason_of(error)}") from None
    if not isinstance(message, dict):
        raise BadNumbers(f"a message has fields, this one is {shown(message)}")
    return message


def _asked(kind: str, payload: bytes) -> Fields:
    if kind != SET_BOOL:
        return {}
    if len(payload) != len(CDR_LITTLE_ENDIAN) + 1 or payload[-1] > 1:
        raise BadNumbers(f"this is no {kind}: {shown(payload)}")
    return {"data": payload[-1] == 1}


def _values(status: Status) -> dict[str, Any]:
    """The parameters; a rate of 0 stands for as fast as possible."""
    rate = 0.0 if status.rate is None else status.rate
    return {
        "/slamsim/rate": rate,
        "/slamsim/paused": status.paused,
        "/slamsim/mode": status.mode,
    }


def _set_rate(controls: Controls, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadNumbers(f"a rate is a number of times real time, not {shown(value)}")
    controls.set_rate(None if value == 0 else float(value))


def _set_paused(controls: Controls, value: object) -> None:
    if not isinstance(value, bool):
        raise BadNumbers(f"true or false is needed, not {shown(value)}")
    controls.pause(value)


def _set_mode(controls: Controls, value: object) -> None:
    if value not in get_args(Mode):
        raise BadNumbers(f"a mode is one of {', '.join(get_args(Mode))}, not {shown(value)}")
    controls.set_mode(cast(Mode, value))


_SETTERS: Mapping[str, Callable[[Controls, Any], None]] = {
    "/slamsim/rate": _set_rate,
    "/slamsim/paused": _set_paused,
    "/slamsim/mode": _set_mode,
}


def _parameter(name: str, value: Any) -> Parameter:
    return Parameter(name, value=float(value) if name == "/slamsim/rate" else value)
