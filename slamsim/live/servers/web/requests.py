"""What a page may ask of a live robot, each a JSON object whose ``op`` names it; the pages that are
connected: each is sent what is newest."""

from __future__ import annotations

import asyncio
import json
import logging
from abc import abstractmethod
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from slamsim.guard.errors import SlamsimError, reason_of, shown
from slamsim.live.controls import Controls, Mode

HOLD_S = 0.25
"""A page that is held repeats its twist each 50 ms: five lost ones stop the robot."""


class RequestRefused(SlamsimError):
    """A message of a page that is no request."""

    exit_code = 2


class Request(BaseModel):
    """Numbers may be anything that JSON can say: ``Controls`` tells which of them it takes."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    op: str

    @abstractmethod
    def carry_out(self, controls: Controls) -> str:
        """What to tell who asked; may take its time. Raises SlamsimError if it cannot be done."""


class DriveRequest(Request):
    op: Literal["drive"]
    speed_m_s: float
    yaw_rate_rad_s: float

    def carry_out(self, controls: Controls) -> str:
        controls.drive(self.speed_m_s, self.yaw_rate_rad_s, HOLD_S)
        return ""


class GoToRequest(Request):
    op: Literal["go_to"]
    x_m: float
    y_m: float
    yaw_rad: float | None = None

    def carry_out(self, controls: Controls) -> str:
        controls.go_to(self.x_m, self.y_m, self.yaw_rad)
        return f"Driving to x {self.x_m:.2f} m, y {self.y_m:.2f} m."


class ModeRequest(Request):
    op: Literal["mode"]
    mode: Mode

    def carry_out(self, controls: Controls) -> str:
        controls.set_mode(self.mode)
        return ""


class PauseRequest(Request):
    op: Literal["pause"]
    paused: bool

    def carry_out(self, controls: Controls) -> str:
        controls.pause(self.paused)
        return ""


class StepRequest(Request):
    op: Literal["step"]
    seconds: float

    def carry_out(self, controls: Controls) -> str:
        controls.step(self.seconds)
        return ""


class RateRequest(Request):
    op: Literal["rate"]
    rate: float | None

    def carry_out(self, controls: Controls) -> str:
        controls.set_rate(self.rate)
        return ""


class ResetRequest(Request):
    op: Literal["reset"]

    def carry_out(self, controls: Controls) -> str:
        controls.reset()
        return "The drive begins anew."


class RecordRequest(Request):
    op: Literal["record"]
    on: bool

    def carry_out(self, controls: Controls) -> str:
        folder = controls.record(self.on)
        if folder is None:
            return "There was no recording to stop."
        return f"{'Recording to' if self.on else 'Recorded in'} {_short(folder)}."


class SaveMapRequest(Request):
    op: Literal["save_map"]

    def carry_out(self, controls: Controls) -> str:
        return f"Map saved in {_short(controls.save_map())}."


AnyRequest = (
    DriveRequest
    | GoToRequest
    | ModeRequest
    | PauseRequest
    | StepRequest
    | RateRequest
    | ResetRequest
    | RecordRequest
    | SaveMapRequest
)
_REQUESTS: TypeAdapter[AnyRequest] = TypeAdapter(Annotated[AnyRequest, Field(discriminator="op")])


def parse_request(text: str | bytes) -> AnyRequest:
    """Raises RequestRefused, which says what is wrong, for what is none."""
    try:
        return _REQUESTS.validate_json(text)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        place = ".".join(map(str, detail["loc"][1:]))
        given = shown(text if detail["type"] == "json_invalid" else detail["input"])
        reason = f"{place}: {detail['msg']}" if place else detail["msg"]
        raise RequestRefused(f"{reason} (given {given})") from None


def _short(folder: Path) -> str:
    """Its last two names: the rest is of no use on another machine."""
    return f"{folder.parent.name}/{folder.name}"


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
