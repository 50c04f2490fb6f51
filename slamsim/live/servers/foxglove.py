"""A live robot for Foxglove and Lichtblick: its messages, and what their panels ask of it.

The protocol is served by ``foxglove-sdk``, behind a front that checks who comes and keeps a slow
client from costing more than itself messages.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Self
from urllib.parse import quote

import foxglove
from foxglove.websocket import Capability, WebSocketServer

from slamsim.live.controls import Controls
from slamsim.live.hub import Hub, Message
from slamsim.live.requests import SERVICES
from slamsim.live.servers.access import Access, not_served
from slamsim.live.servers.foxglove_requests import ENCODINGS, Requests
from slamsim.live.servers.front import Front, hidden_address
from slamsim.simulation.foxglove_channels import FoxgloveChannels


class FoxgloveServer:
    """Serves from when it is made until its block ends; port 0 chooses a free one.

    address: what is entered at "Open connection". Raises OutputRefused where the port is taken.
    """

    def __init__(self, hub: Hub, controls: Controls, access: Access, port: int = 8765) -> None:
        with ExitStack() as opened:
            channels = FoxgloveChannels(hub.topics.values())
            opened.callback(channels.close)
            requests = Requests(channels, controls)
            host = hidden_address()
            server = _behind(host, channels, requests)
            opened.callback(server.stop)
            try:
                front = opened.enter_context(Front(access, port, (host, server.port)))
            except OSError as error:
                raise not_served(access.host, port, error) from None
            opened.enter_context(requests.answering(server))
            opened.callback(hub.listen(_Outgoing(channels, server)))
            self._opened = opened.pop_all()
        token = "" if access.token is None else f"/?token={quote(access.token)}"
        self.address = f"ws://{access.url_host}:{front.port}{token}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()


def _behind(host: str, channels: FoxgloveChannels, requests: Requests) -> WebSocketServer:
    return foxglove.start_server(
        name="slamsim",
        host=host,
        port=0,
        server_listener=requests,
        capabilities=[
            Capability.Time,
            Capability.ClientPublish,
            Capability.Parameters,
            Capability.Services,
        ],
        supported_encodings=list(ENCODINGS),
        services=[requests.service(name) for name in SERVICES],
        context=channels.context,
    )


class _Outgoing:
    """Passes messages of the robot on, and with each of /clock the time."""

    def __init__(self, channels: FoxgloveChannels, server: WebSocketServer) -> None:
        self._channels, self._server = channels, server
        self._clock_ns = 0

    def __call__(self, message: Message) -> None:
        topic, log_ns = message.topic.name, message.log_ns
        if topic == "/clock":
            if log_ns < self._clock_ns:
                self._server.clear_session()  # the drive began anew: viewers forget what they have
            self._clock_ns = log_ns
            self._server.broadcast_time(log_ns)
        self._channels.send(topic, log_ns, message.data)
