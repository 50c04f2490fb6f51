"""What a client asks for, operation by operation."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from slamsim.guard.errors import SlamsimError, shown
from slamsim.io.ros.values import (
    WrongMessage,
    cdr_of,
    is_ros1_name,
    known_type,
    plain_values,
)
from slamsim.live.controls import Controls
from slamsim.live.requests import SUBSCRIBED, publish
from slamsim.live.rosbridge import request_of
from slamsim.live.servers.rosbridge.client import LEVELS, Client, Kind, Options
from slamsim.live.servers.rosbridge.services import (
    Answer,
    ClientServices,
    Rosapi,
    Service,
    robot_services,
)
from slamsim.live.servers.rosbridge.topics import Topics

_COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
_SMALLEST_FRAGMENT = 100
_MOST_CALLS = 32
"""Calls of services of one client that are not answered yet."""
_CALL_THREADS = 8

Operation = Mapping[str, Any]
T = TypeVar("T")


class Operations:
    """Obeys clients. All of it happens on the event loop; what may take long, such as ending a
    recording, on threads of its own."""

    def __init__(self, topics: Topics, controls: Controls) -> None:
        self._topics, self._controls = topics, controls
        self._loop = asyncio.get_running_loop()
        self._threads = ThreadPoolExecutor(_CALL_THREADS, "rosbridge-call")
        self._tasks: set[asyncio.Task[None]] = set()
        self._clients = ClientServices()
        robot = robot_services(controls)
        rosapi = Rosapi(topics, self._now_ns, self._service_types).services()
        self._services: Mapping[str, tuple[Service, bool]] = {
            **{name: (service, True) for name, service in robot.items()},
            **{name: (service, False) for name, service in rosapi.items()},
        }
        self._table: Mapping[str, Callable[[Client, Operation], None]] = {
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "call_service": self._call_service,
            "advertise_service": self._advertise_service,
            "unadvertise_service": self._unadvertise_service,
            "service_response": self._service_response,
            "set_level": self._set_level,
            "fragment": self._fragment,
        }

    def close(self) -> None:
        """Begin nothing more; what is begun ends on its own."""
        self._threads.shutdown(wait=False, cancel_futures=True)

    def leave(self, client: Client) -> None:
        """The client is gone."""
        self._topics.leave(client)
        self._clients.leave(client)

    def handle(self, client: Client, frame: str | bytes) -> None:
        """What a client sent: it is told in a status what was wrong with it."""
        operation: Operation = {}
        try:
            operation = request_of(frame)
            self._obey(client, operation)
        except SlamsimError as error:
            client.tell("error", str(error), _key(operation))

    def _obey(self, client: Client, operation: Operation) -> None:
        name = operation.get("op")
        if not isinstance(name, str) or name not in self._table:
            known = ", ".join(self._table)
            raise WrongMessage(f"an 'op' is needed, one of {known}; not {shown(name)}")
        self._table[name](client, operation)

    def _now_ns(self) -> int:
        return self._controls.status().stamp_ns

    def _service_types(self) -> Mapping[str, str]:
        own = {name: kind for name, ((kind, _), _) in self._services.items()}
        return {**self._clients.types(), **own}

    def _advertise(self, client: Client, operation: Operation) -> None:
        topic, type_name = _take(operation, "topic", str), _take(operation, "type", str)
        taken = SUBSCRIBED.get(topic)
        if taken is None:
            self._topics.advertise(client, topic, type_name)
        elif known_type(type_name) not in taken:
            raise WrongMessage(f"{topic} takes {' or '.join(taken)}, not {shown(type_name)}")

    def _unadvertise(self, client: Client, operation: Operation) -> None:
        topic = _take(operation, "topic", str)
        if topic not in SUBSCRIBED:
            self._topics.unadvertise(client, topic)

    def _publish(self, client: Client, operation: Operation) -> None:
        topic, values = _take(operation, "topic", str), operation.get("msg")
        kinds = SUBSCRIBED.get(topic)
        if kinds is None:
            self._topics.publish_of_client(topic, values, self._now_ns())
            return
        stamped = isinstance(values, Mapping) and "twist" in values
        kind = kinds[-1] if stamped else kinds[0]
        message = plain_values(kind, cdr_of(kind, values, 0), ros1=False)
        if topic == "/cmd_vel":
            publish(self._controls, topic, kind, message)
            return

        if client.calls >= _MOST_CALLS:
            raise WrongMessage(f"{_MOST_CALLS} calls are not answered yet")

        def go(_: Operation) -> Operation:
            publish(self._controls, topic, kind, message)
            return {}

        def answer(told: object, succeeded: bool) -> None:
            if not succeeded:
                client.tell("error", str(told), _key(operation))

        self._start(client, go, {}, answer)  # to plan a path may take a while

    def _subscribe(self, client: Client, operation: Operation) -> None:
        topic = _take(operation, "topic", str)
        type_name = _take(operation, "type", str, "")
        compression = _take(operation, "compression", str, "none")
        if compression not in _COMPRESSIONS:
            known = ", ".join(_COMPRESSIONS)
            raise WrongMessage(f"compression: one of {known}, not {shown(compression)}")
        size = operation.get("fragment_size")
        if size is not None:
            size = _take(operation, "fragment_size", int)
            if size < _SMALLEST_FRAGMENT:
                raise WrongMessage(f"fragment_size: at least {_SMALLEST_FRAGMENT}, not {size}")
        ros1 = is_ros1_name(type_name) and compression != "cbor-raw"
        options = Options(
            Kind(compression, ros1),
            _count(operation, "throttle_rate") * 1e-3,
            _count(operation, "queue_length"),
            size,
        )
        self._topics.subscribe(client, topic, type_name, _key(operation), options)

    def _unsubscribe(self, client: Client, operation: Operation) -> None:
        self._topics.unsubscribe(client, _take(operation, "topic", str), _key(operation))

    def _set_level(self, client: Client, operation: Operation) -> None:
        level = _take(operation, "level", str)
        if level not in LEVELS:
            raise WrongMessage(f"level: one of {', '.join(LEVELS)}, not {shown(level)}")
        client.set_level(level)

    def _fragment(self, client: Client, operation: Operation) -> None:
        text = client.fragments.add(operation, self._loop.time())
        if text is None:
            return
        whole = request_of(text)
        if whole.get("op") == "fragment":
            raise WrongMessage("fragments of fragments are not read")
        self.handle(client, text)

    def _call_service(self, client: Client, operation: Operation) -> None:
        name, _, number = _take(operation, "service", str).partition("#")
        key = _key(operation)
        key = number if key is None and number else key
        about = {} if key is None else {"id": key}

        def answer(values: object, succeeded: bool) -> None:
            told = {"op": "service_response", "service": name, "values": values}
            client.reply(told | {"result": succeeded} | about)

        given = operation.get("args", {})
        given = {} if given == [] else given
        if not isinstance(given, Mapping):
            answer(f"args: an object is needed, not {shown(given)}", False)
        elif client.calls >= _MOST_CALLS:
            answer(f"{_MOST_CALLS} calls are not answered yet", False)
        else:
            self._call(client, name if name.startswith("/") else f"/{name}", given, answer)

    def _call(self, client: Client, name: str, given: Operation, answer: Answer) -> None:
        if name in self._services:
            (_, call), slow = self._services[name]
            if slow:
                self._start(client, call, given, answer)
            else:
                answer(*_called(call, given))
        elif name in self._clients.types():
            self._clients.call(client, name, given, answer)
        else:
            answer(f"there is no service {shown(name)}", False)

    def _advertise_service(self, client: Client, operation: Operation) -> None:
        name, type_name = _take(operation, "service", str), _take(operation, "type", str)
        if name in self._services:
            raise WrongMessage(f"the robot serves {name}")
        self._clients.advertise(client, name, type_name)

    def _unadvertise_service(self, client: Client, operation: Operation) -> None:
        self._clients.unadvertise(client, _take(operation, "service", str))

    def _service_response(self, client: Client, operation: Operation) -> None:
        succeeded = _take(operation, "result", bool, True)
        values = operation.get("values", {})
        self._clients.respond(client, operation.get("id"), values, succeeded)

    def _start(
        self,
        client: Client,
        call: Callable[[Operation], Mapping[str, Any]],
        given: Operation,
        answer: Answer,
    ) -> None:
        """Call it on another thread, and answer when it is done."""
        client.calls += 1

        async def run() -> None:
            try:
                answer(*await self._loop.run_in_executor(self._threads, _called, call, given))
            finally:
                client.calls -= 1

        task = self._loop.create_task(run())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _called(
    call: Callable[[Operation], Mapping[str, Any]], given: Operation
) -> tuple[Mapping[str, Any] | str, bool]:
    """What a service gives, or why it does not."""
    try:
        return call(given), True
    except SlamsimError as error:
        return str(error), False


def _key(operation: Operation) -> str | int | None:
    key = operation.get("id")
    sound = isinstance(key, str) or (isinstance(key, int) and key.bit_length() <= 64)
    return key if sound else None


def _take(operation: Operation, name: str, kind: type[T], default: T | None = None) -> T:
    value = operation.get(name)
    value = default if value is None else value
    if type(value) is not kind:
        raise WrongMessage(
            f"{operation.get('op')}: {name} is needed as {kind.__name__}, not {shown(value)}"
        )
    return value


def _count(operation: Operation, name: str) -> int:
    """Not negative, 0 if left out; roslib sends whole numbers as floats too."""
    value = operation.get(name, 0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1e9:
        raise WrongMessage(f"{name}: a number of at least 0 is needed, not {shown(value)}")
    return int(value)
