"""What other threads ask of a loop, which does it between two of its turns."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from threading import Event
from typing import TypeVar, cast

from slamsim.guard.errors import SlamsimError

_ANSWER_S = 60.0
_T = TypeVar("_T")


class Calls:
    """wake: set by each call, for a loop that waits."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Callable[[], object], Future[object]]] = SimpleQueue()
        self._is_over = False
        self.wake = Event()

    def ask(self, request: Callable[[], object]) -> Future[object]:
        """From any thread. Once the loop is over, the answer is a SlamsimError."""
        answer: Future[object] = Future()
        self._waiting.put((request, answer))
        self.wake.set()
        if self._is_over:
            self.close()
        return answer

    def answer(self, request: Callable[[], _T]) -> _T:
        """Ask, and wait for it. Raises what the request raises, SlamsimError where the loop does
        not come to it."""
        try:
            return cast(_T, self.ask(request).result(_ANSWER_S))
        except TimeoutError:
            raise SlamsimError(f"the live robot did not answer within {_ANSWER_S:.0f} s") from None

    def heed(self) -> None:
        """In the loop: do what was asked for."""
        while (asked := self._next()) is not None:
            request, answer = asked
            try:
                answer.set_result(request())
            except SlamsimError as error:
                answer.set_exception(error)

    def close(self) -> None:
        """The loop is over: nothing is done any more."""
        self._is_over = True
        while (asked := self._next()) is not None:
            asked[1].set_exception(SlamsimError("the live robot has ended"))

    def _next(self) -> tuple[Callable[[], object], Future[object]] | None:
        try:
            return self._waiting.get_nowait()
        except Empty:
            return None
