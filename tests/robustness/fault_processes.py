"""The command line as a process to be stopped or killed, with everything that it starts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from limited_child import hear_interrupts

MAIN = "from slamsim.entry import main; main()"
_MARK = "SLAMSIM_TEST_MARK"


class Run:
    """A command that runs in a session of its own. kin(): whatever it started, however deep."""

    def __init__(self, *arguments: object, cwd: Path, code: str = MAIN) -> None:
        self._mark = uuid.uuid4().hex
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)],
            cwd=cwd,
            env={**os.environ, _MARK: self._mark},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=hear_interrupts,  # noqa: PLW1509  no threads here
        )

    def kin(self) -> list[int]:
        """It and its descendants that are alive, those included that lost their parents."""
        marked, alive = f"{_MARK}={self._mark}".encode(), []
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if marked in (folder / "environ").read_bytes():
                    alive.append(int(folder.name))
        return sorted(alive)

    def child(self) -> int | None:
        """The process that does the work, once there is one."""
        with suppress(OSError):
            children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
            return next(map(int, children.read_text().split()), None)
        return None

    def await_child(self) -> None:
        """Until then Python itself is starting, and a signal ends it as it ends any process."""
        while self.child() is None and self.process.poll() is None:
            time.sleep(0.005)

    def ended(self, within_s: float = 60.0) -> tuple[int, str, float]:
        """(exit code, what it said, how long that took)."""
        begin_s = time.monotonic()
        told = self.process.communicate(timeout=within_s)[1]
        return self.process.returncode, told, time.monotonic() - begin_s

    def orphans(self, within_s: float = 2.0) -> list[int]:
        """Who is still there so long after the end."""
        end_s = time.monotonic() + within_s
        while (left := self.kin()) and time.monotonic() < end_s:
            time.sleep(0.05)
        return left


@contextmanager
def running(*arguments: object, cwd: Path, code: str = MAIN) -> Iterator[Run]:
    """The command, of which nothing outlives the block."""
    run = Run(*arguments, cwd=cwd, code=code)
    try:
        yield run
    finally:
        for process in run.kin():
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        run.process.communicate()
