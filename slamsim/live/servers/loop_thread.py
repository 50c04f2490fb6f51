"""A server whose event loop runs on a thread of its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import Self


class LoopThread:
    """Serves from ``_start`` until its block ends, when ``_ended`` is set."""

    _loop: asyncio.AbstractEventLoop
    _ended: asyncio.Event

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._in_loop(self._ended.set)
        self._thread.join()

    def _start(self, name: str) -> None:
        """Returns as soon as it listens; raises what ``_serve`` raises before."""
        listening: Future[None] = Future()
        self._thread = Thread(target=self._run, args=(listening,), name=name, daemon=True)
        self._thread.start()
        listening.result()

    def _run(self, listening: Future[None]) -> None:
        try:
            asyncio.run(self._begin(lambda: listening.set_result(None)))
        except Exception as error:
            if listening.done():
                raise
            listening.set_exception(error)

    async def _begin(self, listens: Callable[[], None]) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        await self._serve(listens)

    async def _serve(self, listens: Callable[[], None]) -> None:
        """Until ``_ended`` is set; calls listens once clients may come."""
        raise NotImplementedError

    def _in_loop(self, action: Callable[[], None]) -> None:
        """From any thread; nothing is done when the server has ended meanwhile."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(action)
