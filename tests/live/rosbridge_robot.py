"""A rosbridge server of a hub that the test publishes into, and a plain client."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from typing import Any

import cbor2
from live_data import hub
from served_robot import NotedControls
from waiting import TIMEOUT_S
from websockets.sync.client import ClientConnection, connect

from slamsim.live.hub import Hub
from slamsim.live.servers.access import Access
from slamsim.live.servers.rosbridge.server import RosbridgeServer


class Robot:
    """A live robot behind a rosbridge server."""

    def __init__(self, server: RosbridgeServer, messages: Hub, controls: NotedControls) -> None:
        self.server, self.hub, self.controls = server, messages, controls

    def connect(self, **options: Any) -> ClientConnection:
        options = {"max_size": None, "proxy": None} | options
        connected: ClientConnection = connect(self.server.address, **options)
        return connected

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Nothing happens in the server meanwhile; what is published is heard at once behind."""
        entered, left = Event(), Event()

        def wait() -> None:
            entered.set()
            left.wait()

        self.server._loop.call_soon_threadsafe(wait)
        entered.wait()
        try:
            yield
        finally:
            left.set()


@contextmanager
def serving(access: Access | None = None) -> Iterator[Robot]:
    messages, controls = hub(), NotedControls()
    with RosbridgeServer(messages, controls, access or Access(), port=0) as server:
        yield Robot(server, messages, controls)


def ask(client: ClientConnection, **operation: Any) -> None:
    client.send(json.dumps(operation))


def told(client: ClientConnection) -> Any:
    data = client.recv(timeout=TIMEOUT_S)
    return json.loads(data) if isinstance(data, str) else cbor2.loads(data)


def call(client: ClientConnection, name: str, /, **args: Any) -> Any:
    """Also a way to know that all operations before were obeyed."""
    ask(client, op="call_service", service=name, args=args, id="call")
    answer = told(client)
    assert answer["op"] == "service_response" and answer["id"] == "call", answer
    return answer["values"]


def subscribe(client: ClientConnection, topic: str, **options: Any) -> None:
    ask(client, op="subscribe", topic=topic, **options)
    call(client, "/rosapi/get_time")


def complaint(client: ClientConnection, **operation: Any) -> str:
    """The status that an operation gives."""
    ask(client, **operation)
    answer = told(client)
    assert (answer["op"], answer["level"]) == ("status", "error"), answer
    return str(answer["msg"])
