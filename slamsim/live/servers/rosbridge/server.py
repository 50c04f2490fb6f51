"""Serves a live robot to clients of rosbridge: roslibpy, roslib.js, RosSharp and their like.

The protocol is rosbridge v2 (ROSBRIDGE_PROTOCOL.md of rosbridge_suite). A thread of its own runs
the event loop; each client has a writer and a bounded queue, so that none waits for another.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from http import HTTPStatus
from urllib.parse import quote

from websockets.asyncio.server import Server as WebSocketServer
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed, NegotiationError
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from slamsim.guard.errors import shown
from slamsim.live.controls import Controls
from slamsim.live.hub import Hub
from slamsim.live.rosbridge import LARGEST_MESSAGE
from slamsim.live.servers.access import Access, refusal
from slamsim.live.servers.front import LoopThread
from slamsim.live.servers.rosbridge.client import Client
from slamsim.live.servers.rosbridge.operations import Operations
from slamsim.live.servers.rosbridge.topics import Topics

SUBPROTOCOL = Subprotocol("rosbridge_v2")
"""rosbridge has none; one of this name is taken, any other refused."""

MOST_CLIENTS = 200
_STOP_S = 1.0
"""How long clients have to say goodbye when the server stops."""


class RosbridgeServer(LoopThread):
    """Serves from when it is made until its block ends.

    port: 0 for a free one. Raises OutputRefused where it is taken.
    """

    def __init__(self, hub: Hub, controls: Controls, access: Access, port: int = 9090) -> None:
        super().__init__(access, port)
        self._hub, self._controls = hub, controls
        self._clients: dict[Client, ServerConnection] = {}
        self._start("rosbridge")

    @property
    def port(self) -> int:
        """At which it listens."""
        return self._port

    @property
    def address(self) -> str:
        """What a client opens."""
        token = f"/?token={quote(self._access.token)}" if self._access.token else ""
        return f"ws://{self._access.url_host}:{self._port}{token}"

    async def _serve(self, listens: Callable[[], None]) -> None:
        self._topics = Topics(self._hub)
        self._operations = Operations(self._topics, self._controls)
        server = await self._listening(
            self._talk,
            process_request=self._admit,
            subprotocols=[SUBPROTOCOL],
            select_subprotocol=_subprotocol,
            max_size=LARGEST_MESSAGE,
            max_queue=4,
            ping_interval=None,  # Client.watch
            close_timeout=_STOP_S,
            server_header="slamsim",
        )
        leave = self._hub.listen(self._topics.heard)
        listens()
        try:
            await self._ended.wait()
        finally:
            leave()
            await self._stop(server)

    async def _stop(self, server: WebSocketServer) -> None:
        server.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_STOP_S):
                await server.wait_closed()
        for connection in self._clients.values():
            connection.transport.abort()
        self._topics.close()
        self._operations.close()

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """An answer to a request that is refused."""
        if (why := refusal(self._access, request)) is not None:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
        if len(self._clients) >= MOST_CLIENTS:
            text = f"{MOST_CLIENTS} clients are connected already\n"
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, text)
        return None

    async def _talk(self, connection: ServerConnection) -> None:
        client = Client(connection)
        self._clients[client] = connection
        tasks = [asyncio.create_task(work) for work in (client.write(), client.watch())]
        try:
            async for frame in connection:
                self._operations.handle(client, frame)
                await client.room()
        except ConnectionClosed:
            pass
        finally:
            self._operations.leave(client)
            del self._clients[client]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def _subprotocol(
    connection: ServerConnection, offered: Sequence[Subprotocol]
) -> Subprotocol | None:
    if offered and SUBPROTOCOL not in offered:
        raise NegotiationError(f"this is a server of rosbridge v2, not of {shown(offered[0])}")
    return SUBPROTOCOL if offered else None
