"""Pages that are connected: each is sent what is newest, and may ask for things."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Awaitable, Callable

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from slamsim.guard.errors import SlamsimError, reason_of
from slamsim.live.servers.web.requests import AnyRequest, DriveRequest, parse_request

MOST_WAITING = 32
"""Requests of one client that wait for the one before them."""

_log = logging.getLogger(__name__)

CarryOut = Callable[[AnyRequest], Awaitable[str]]


class Newest:
    """The newest frame of each kind, which all clients share.

    Nothing is queued for a client: when it has taken one frame it is given the newest of those that
    it has not seen, so a slow one misses frames, costs no memory, and holds up no other.
    """

    def __init__(self) -> None:
        self._frames: dict[str, tuple[int, str | bytes]] = {}
        self._versions = 0
        self._changed = asyncio.Event()

    def put(self, kind: str, frame: str | bytes) -> None:
        """Wakes the clients."""
        self._versions += 1
        self._frames[kind] = self._versions, frame
        self._changed.set()
        self._changed = asyncio.Event()

    def unseen(self, seen: dict[str, int]) -> str | bytes | None:
        """A frame that is newer than the version seen of its kind, noted as seen; of several the
        one that is oldest in that client's eyes. None if there is nothing new."""
        newer = [k for k, (version, _) in self._frames.items() if seen.get(k, 0) < version]
        if not newer:
            return None
        kind = min(newer, key=lambda each: seen.get(each, 0))
        seen[kind], frame = self._frames[kind]
        return frame

    async def changed(self) -> None:
        """Waits for the next frame."""
        await self._changed.wait()


class Client:
    """One page. drop_s: it is dropped when it takes nothing for so long."""

    def __init__(self, socket: ServerConnection, newest: Newest, drop_s: float) -> None:
        self._socket, self._newest, self._drop_s = socket, newest, drop_s
        self._waiting: asyncio.Queue[AnyRequest] = asyncio.Queue(MOST_WAITING)

    async def serve(self, carry_out: CarryOut) -> None:
        """Until the connection ends."""
        try:
            async with asyncio.TaskGroup() as tasks:
                others = [tasks.create_task(self._tell()), tasks.create_task(self._work(carry_out))]
                await self._listen(carry_out)
                for each in others:
                    each.cancel()
        except* ConnectionClosed:
            pass
        except* TimeoutError:
            _log.warning("a page took nothing for %.0f s and was dropped", self._drop_s)
            self._socket.transport.abort()

    async def _tell(self) -> None:
        seen: dict[str, int] = {}
        while True:
            while (frame := self._newest.unseen(seen)) is not None:
                await self._send(frame)
            await self._newest.changed()

    async def _listen(self, carry_out: CarryOut) -> None:
        """Twists are carried out at once; what may take its time does not hold them up."""
        async for text in self._socket:
            op = ""
            try:
                request = parse_request(text)
                op = request.op
                if isinstance(request, DriveRequest):
                    await carry_out(request)
                else:
                    self._waiting.put_nowait(request)
            except SlamsimError as error:
                await self._answer("error", op, str(error))
            except asyncio.QueueFull:
                await self._answer("error", op, "Left out: too many requests are waiting.")

    async def _work(self, carry_out: CarryOut) -> None:
        while True:
            request = await self._waiting.get()
            try:
                text = await carry_out(request)
            except SlamsimError as error:
                await self._answer("error", request.op, str(error))
            except Exception as error:
                _log.exception("request %s of a page", request.op)
                await self._answer("error", request.op, reason_of(error))
            else:
                await self._answer("done", request.op, text)

    async def _answer(self, kind: str, op: str, text: str) -> None:
        await self._send(json.dumps({"type": kind, "op": op, "text": text}))

    async def _send(self, frame: str | bytes) -> None:
        async with asyncio.timeout(self._drop_s):
            await self._socket.send(frame)
