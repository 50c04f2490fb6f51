"""A page in a browser that shows a live robot and drives it.

One port serves the page, finished recordings, and the WebSocket that the page opens. An exact table
of addresses is all there is: no request names a file.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
from collections.abc import Callable
from dataclasses import asdict
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote

from websockets.asyncio.server import Server as SocketServer
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from slamsim.guard.errors import SlamsimError
from slamsim.live.controls import Controls
from slamsim.live.hub import Hub
from slamsim.live.servers.access import Access
from slamsim.live.servers.front import LoopThread
from slamsim.live.servers.web.answers import (
    Recordings,
    answer,
    has_query_token,
    in_chunks,
    keep_token,
    page_answer,
    refusal,
    zip_head,
    zipped,
)
from slamsim.live.servers.web.requests import AnyRequest, Client, DriveRequest, Newest
from slamsim.live.servers.web.view import View

FAST_S, SLOW_S, QUIET_S = 0.04, 0.5, 0.25
"""Pauses between two scans that are sent, between two maps, and between two states of a robot that
sends nothing. A scan of every drive is drawn as smoothly as a film; a map is read, not watched."""

DROP_S = 60.0
"""A client that takes nothing for so long is dropped."""

MOST_CLIENTS = 64
MOST_BYTES = 1 << 16
"""Of a message of a client; the longest request has some hundred."""

_CLOSE_S = 0.5
"""For a client to say goodbye."""

_LIVE, _RECORDING = "/live", "/recording/"

_log = logging.getLogger(__name__)


class PageServer(LoopThread):
    """Serves the page from when it is made until its block ends, on a thread of its own.

    port: 0 chooses a free one. Raises OutputRefused where it cannot listen.
    """

    def __init__(
        self, hub: Hub, controls: Controls, access: Access, port: int, drop_s: float = DROP_S
    ) -> None:
        super().__init__(access, port)
        self._hub, self._controls, self._drop_s = hub, controls, drop_s
        self._recordings = Recordings()
        self._clients = 0
        self._began_ns: int | None = None
        self._downloads = set[ServerConnection]()
        self._start("page")

    @property
    def address(self) -> str:
        """What a browser opens."""
        query = "" if self._access.token is None else f"?token={quote(self._access.token)}"
        return f"http://{self._access.url_host}:{self._port}/{query}"

    async def _serve(self, listens: Callable[[], None]) -> None:
        self._news, self._newest = asyncio.Event(), Newest()
        server = await self._listening(
            self._converse,
            process_request=self._answer,
            server_header=None,
            close_timeout=_CLOSE_S,
            max_size=MOST_BYTES,
        )
        self._cookie = f"slamsim_{self._port}"
        view = View(self._hub, self._wake)
        works = (self._publish(view), self._draw(view), self._ended.wait())
        tasks = [asyncio.create_task(work) for work in works]
        listens()
        ended, others = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        view.leave()
        for task in others:
            task.cancel()
        await self._close(server)
        for task in ended:
            task.result()

    async def _close(self, server: SocketServer) -> None:
        server.close()
        try:
            async with asyncio.timeout(2.0 * _CLOSE_S):
                await server.wait_closed()
        except TimeoutError:  # some take nothing, not even a farewell
            for connection in (*server.all_connections, *self._downloads):
                connection.transport.abort()

    def _wake(self) -> None:
        """Called when something is published. Once a set event is enough until it is cleared."""
        if not self._news.is_set():
            self._in_loop(self._news.set)

    async def _publish(self, view: View) -> None:
        while True:
            self._news.clear()
            view.follow()
            if self._clients:
                for kind, frame in view.scans():
                    self._newest.put(kind, frame)
            self._put_state(view)
            await asyncio.sleep(FAST_S if self._clients else QUIET_S)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(QUIET_S):
                    await self._news.wait()

    async def _draw(self, view: View) -> None:
        """Maps take milliseconds to compress, off the thread that answers."""
        while True:
            if self._clients:
                for kind, frame in await asyncio.to_thread(lambda: list(view.maps())):
                    self._newest.put(kind, frame)
            await asyncio.sleep(SLOW_S)

    def _put_state(self, view: View) -> None:
        status = self._controls.status()
        self._recordings.note(status.recording)
        fields: dict[str, Any] = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(status).items()
        }
        fields["recording"] = None if status.recording is None else status.recording.name
        finished = self._recordings.finished().items()
        fields["recordings"] = [{"id": key, "name": path.name} for key, path in finished]
        if self._began_ns is None or status.stamp_ns < self._began_ns:
            self._began_ns = status.stamp_ns
        fields["time_s"] = (status.stamp_ns - self._began_ns) * 1e-9
        fields["pose"] = view.pose()
        fields["clients"] = self._clients
        self._newest.put("state", json.dumps({"type": "state", **fields}, allow_nan=False))

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """What a request gets; None lets a WebSocket be opened."""
        if refused := refusal(self._access, request, self._cookie):
            return refused
        path = request.path.partition("?")[0]
        if path == "/":
            if (token := self._access.token) and has_query_token(request):
                return keep_token(token, self._cookie)
            return page_answer()
        if path == _LIVE and "Upgrade" in request.headers:
            if self._clients < MOST_CLIENTS:
                return None
            return answer(HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are connected.\n")
        folder = self._recordings.finished().get(path.removeprefix(_RECORDING))
        if path.startswith(_RECORDING) and folder is not None:
            await self._download(connection, folder)
            return None
        return answer(HTTPStatus.NOT_FOUND, "There is nothing here.\n")

    async def _download(self, connection: ServerConnection, folder: Path) -> None:
        """Sent by hand and then closed, for the library sends whole answers alone."""
        self._downloads.add(connection)
        try:
            connection.transport.write(zip_head(folder.name))
            chunks = in_chunks(zipped(folder))
            while chunk := await asyncio.to_thread(next, chunks, b""):
                if connection.transport.is_closing():
                    return
                connection.transport.write(chunk)
                async with asyncio.timeout(self._drop_s):
                    await connection.drain()
            connection.transport.close()
            async with asyncio.timeout(self._drop_s):
                await asyncio.shield(connection.connection_lost_waiter)
        except (OSError, SlamsimError, TimeoutError):  # a client knows it by the missing last chunk
            connection.transport.abort()
        finally:
            self._downloads.discard(connection)

    async def _converse(self, socket: ServerConnection) -> None:
        self._clients += 1
        try:
            await Client(socket, self._newest, self._drop_s).serve(self._carry_out)
        finally:
            self._clients -= 1

    async def _carry_out(self, request: AnyRequest) -> str:
        """A twist at once, which takes no time; all else may take some."""
        if isinstance(request, DriveRequest):
            return request.carry_out(self._controls)
        text = await asyncio.to_thread(request.carry_out, self._controls)
        self._recordings.note(self._controls.status().recording)
        return text
