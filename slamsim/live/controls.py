"""What clients may ask of a live robot; what other threads ask of a loop, which does it between two
of its turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from typing import Literal, Protocol, TypeVar, cast

from slamsim.guard.errors import SlamsimError

Mode = Literal["tour", "manual", "explore"]
Tracking = Literal["off", "waiting", "tracking", "searching", "lost"]
Goal = Literal["none", "driving", "reached", "not reached"]

HOLD_S = 0.5
"""A twist is held so long unless another follows: as the base of a TurtleBot 2 does (kobuki_node,
``cmd_vel_timeout`` 0.6 s), and longer than the pause between twists of usual programs (10 Hz)."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """How a simulated robot lives.

    rate: times real time, None for as fast as possible. record: from the start. until_done: stop
    when the tour or the exploration is over. duration_s: stop then. slam: map what it sees.
    """

    rate: float | None = 1.0
    mode: Mode = "manual"
    record: bool = False
    until_done: bool = False
    duration_s: float = math.inf
    slam: bool = True


@dataclass(frozen=True, slots=True)
class Status:
    """How a live robot is.

    stamp_ns: true time. rate: times real time that is asked for, None for as fast as possible.
    realtime_factor: what was reached over the last seconds. late_windows: of ``windows``, those
    that were computed later than they were due. recording: the folder that is being written.
    tracking: of the SLAM, ``off`` without it. ended: why the drive is over, empty while it is not.
    goal: what became of the last place that was asked for; ``none`` once another command follows.
    """

    stamp_ns: int
    rate: float | None
    realtime_factor: float
    paused: bool
    mode: Mode
    windows: int
    late_windows: int
    speed_m_s: float
    yaw_rate_rad_s: float
    recording: Path | None
    tracking: Tracking
    keyframes: int
    closures: int
    ended: str
    goal: Goal = "none"


class Controls(Protocol):
    """Safe to call from any thread. A request takes effect with the next window of the drive."""

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """Command a twist, which is limited as ``drive.limits`` says; the drive turns manual.

        hold_s: real time after which the robot stops if no other twist came. Raises BadNumbers
        for what is not finite.
        """
        ...

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        """Drive to a place of the map, around what is known. Raises SlamsimError where no known
        free path leads there, BadNumbers for what is not finite."""
        ...

    def set_mode(self, mode: Mode) -> None:
        """Who drives from now on."""
        ...

    def pause(self, paused: bool) -> None:
        """Let simulated time stand still, or go on."""
        ...

    def step(self, seconds: float) -> None:
        """Let so much simulated time pass while paused. Raises BadNumbers beyond (0, 60]."""
        ...

    def set_rate(self, rate: float | None) -> None:
        """Times real time; None for as fast as possible. Raises BadNumbers beyond [0.01, 100]."""
        ...

    def reset(self) -> None:
        """Begin anew: robot, time, map; a recording is ended and another one begun."""
        ...

    def record(self, on: bool) -> Path | None:
        """Begin or end a recording; its folder, None where there was none to end. Waits until a
        recording that ends is whole. Raises SlamsimError where it cannot be written."""
        ...

    def save_map(self) -> Path:
        """Write the map as it is known by now; its folder. Raises SlamsimError without a map."""
        ...

    def status(self) -> Status:
        """As of the last window."""
        ...


_ANSWER_S = 60.0
"""Beyond the longest window of a slow machine: then the loop has died."""
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
