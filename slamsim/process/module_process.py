"""Runs a module of this package as a child process and exchanges pickles with it.

Standard input and output carry the messages. The child never outlives this process, and Ctrl-C
ends this process alone, which then ends the child.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from slamsim.process.children import Patience, dying_with_us
from slamsim.process.pipe import Pipe, packed, read_message

_PACKAGES = Path(__file__).parents[2]
_STANDARD_INPUT, _STANDARD_OUTPUT, _STANDARD_ERROR = 0, 1, 2


class ModuleProcess:
    """``python -m module``, begun at once.

    environment: what it has besides ours. pass_fds: descriptors that stay open in it.
    """

    def __init__(
        self,
        module: str,
        environment: Mapping[str, str] | None = None,
        pass_fds: Sequence[int] = (),
    ) -> None:
        self._child = subprocess.Popen(
            dying_with_us([sys.executable, "-P", "-m", module]),
            env={**(environment or {}), **os.environ, "PYTHONPATH": _import_path()},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=pass_fds,
            start_new_session=True,
        )
        assert self._child.stdin is not None and self._child.stdout is not None
        self._pipe = Pipe(self._child.stdin, self._child.stdout)

    @property
    def pid(self) -> int:
        return self._child.pid

    def send(self, data: bytes) -> None:
        """Hand on a packed message; returns at once. What is left is sent by the next calls."""
        self._pipe.send(data)

    @property
    def unsent_bytes(self) -> int:
        """What waits until the child takes it."""
        return self._pipe.unsent_bytes

    def receive(self) -> list[object]:
        """All messages that are whole by now. Raises Ended when the child is gone."""
        return self._pipe.receive()

    def wait(self) -> None:
        """Until there may be something to receive. Raises Halted where the child is stopped."""
        self._pipe.wait(Patience(self._child.pid))

    def exit_code(self) -> int:
        """Of a child that is about to end by itself; negative for the signal that ended it."""
        return self._child.wait()

    def end(self) -> int:
        """End it, whatever it is doing; its exit code."""
        self._child.kill()
        for stream in (self._child.stdin, self._child.stdout):
            assert stream is not None
            stream.close()
        return self._child.wait()


def requests() -> BinaryIO:
    """Called in the child: where messages come from. The interpreter aborts where it ends while a
    thread reads ``sys.stdin``."""
    return os.fdopen(os.dup(_STANDARD_INPUT), "rb")


def answers() -> BinaryIO:
    """Called in the child: where messages go; what native code prints goes to standard error."""
    stream = os.fdopen(os.dup(_STANDARD_OUTPUT), "wb")
    os.dup2(_STANDARD_ERROR, _STANDARD_OUTPUT)
    return stream


def tell(stream: BinaryIO, answer: object) -> None:
    """Called in the child: hand on an answer at once."""
    stream.write(packed(answer))
    stream.flush()


def listen(stream: BinaryIO, take: Callable[[Any], None]) -> None:
    """Called in the child: from now on a thread takes messages as they come, so that the pipe never
    fills; when standard input ends the parent is gone, and this process ends, too."""
    threading.Thread(target=_listen, args=(stream, take), daemon=True).start()


def _listen(stream: BinaryIO, take: Callable[[Any], None]) -> None:
    try:
        while True:
            take(read_message(stream))
    except EOFError:
        os._exit(0)


def _import_path() -> str:
    """Where this very package is, before whatever the user's environment names."""
    given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    return os.pathsep.join([str(_PACKAGES), *given])
