"""Runs work in processes of their own, to measure peak memory and isolate crashes."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import NoReturn, ParamSpec, Self, TypeVar, cast

from slamsim.guard.errors import SlamsimError
from slamsim.process.children import end_with_parent

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

GRACE_S = 5.0
"""So long a child that is told to end may take to remove what it has half written."""

_STANDARD_OUTPUT = 1


class Children:
    """Starts processes, one for each piece of work; none outlives the ``with`` block."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._running: set[BaseProcess] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        running = tuple(self._running)
        for child in running:
            child.terminate()
        for child in running:
            child.join(GRACE_S)
            child.kill()

    def run(
        self,
        work: Callable[Arguments, Result],
        *arguments: Arguments.args,
        **keywords: Arguments.kwargs,
    ) -> Result:
        """What the work returns; may be called from several threads at a time.

        work: a function of a module. Raises SlamsimError with what the work raised, or with the
        code that its process ended with.
        """
        answers, out = self._context.Pipe(duplex=False)
        child = self._context.Process(
            target=_serve, args=(os.getpid(), out, work, arguments, keywords), daemon=True
        )
        child.start()
        self._running.add(child)
        out.close()
        try:
            done, answer = answers.recv()
        except EOFError:
            child.join()
            raise SlamsimError(f"its process ended with code {child.exitcode}") from None
        finally:
            child.join()
            self._running.discard(child)
        if not done:
            raise SlamsimError(str(answer))
        return cast(Result, answer)


def _serve(
    parent: int,
    out: Connection,
    work: Callable[..., object],
    arguments: tuple[object, ...],
    keywords: dict[str, object],
) -> None:
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the parent, which ends its children
    signal.signal(signal.SIGTERM, _end)
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STANDARD_OUTPUT)  # some libraries print
    try:
        out.send((True, work(*arguments, **keywords)))
    except SlamsimError as error:
        out.send((False, str(error)))
    except Exception as error:
        out.send((False, f"{type(error).__name__}: {error}"))


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)
