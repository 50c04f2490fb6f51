"""The drive in a process of its own, so that its windows are made while others are sensed.

PyBullet and Open3D both hold Python's lock while they compute; only a second process lets them
work side by side. The child is ``python -m slamsim.sim.drive.process``: it is sent the drive on
standard input and answers with windows on standard output, at most one or two ahead.
"""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Self

from slamsim.config.drive import DriveConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive
from slamsim.guard.errors import SlamsimError
from slamsim.process.children import Halted, Patience, dying_with_us
from slamsim.process.exit_codes import ended_by
from slamsim.sim.drive.route import Route
from slamsim.sim.drive.run import DriveOutcome, drive
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

    from slamsim.world.model import World

_STANDARD_OUTPUT, _STANDARD_ERROR = 1, 2
_PACKAGES = Path(__file__).parents[3]
_BUFFER_BYTES = 1 << 16


class DriveProcess:
    """A process that waits for a drive; a context manager, so that it never outlives its use.

    It loads its libraries while the caller still builds the world.
    """

    def __init__(self) -> None:
        self._child = subprocess.Popen(
            dying_with_us([sys.executable, "-P", "-m", "slamsim.sim.drive.process"]),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, _import_path()))},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C ends this process, which then ends the child
        )
        assert self._child.stdout is not None
        self._patience = Patience(self._child.pid)
        answers = _From(self._child.stdout.fileno(), self._patience)
        self._from = io.BufferedReader(answers, _BUFFER_BYTES)
        self._outcome: DriveOutcome | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._child.kill()
        self._child.communicate()

    @property
    def outcome(self) -> DriveOutcome:
        """Raises RuntimeError until the last window has been taken."""
        if self._outcome is None:
            raise RuntimeError("the outcome of a drive is known once its last window was taken")
        return self._outcome

    def drive(
        self,
        world: World,
        robot: RobotModel,
        route: Route,
        config: DriveConfig,
        progress: Progress = silent,
    ) -> Iterator[Drive]:
        """The same windows and outcome as ``sim.drive.drive`` gives, byte for byte; once only.

        Raises SlamsimError where the process ends, or is stopped and does not go on.
        """
        try:
            yield from self._windows(world, robot, route, config, progress)
        except Halted as halted:
            raise SlamsimError(f"the physics engine's process {halted}") from None

    def _windows(
        self,
        world: World,
        robot: RobotModel,
        route: Route,
        config: DriveConfig,
        progress: Progress,
    ) -> Iterator[Drive]:
        self._tell((world, robot, route, config))
        for window in self._answers():
            elapsed_s = float(window.stamps_ns[-1]) * 1e-9
            progress(elapsed_s, max(route.duration_estimate_s, elapsed_s))
            yield window

    def _tell(self, value: object) -> None:
        assert self._child.stdin is not None
        descriptor = self._child.stdin.fileno()
        os.set_blocking(descriptor, False)
        rest = memoryview(pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL))
        with suppress(BrokenPipeError):  # the other end is gone: who reads from it is told why
            while rest:
                self._patience.wait((), (descriptor,))
                rest = rest[os.write(descriptor, rest) :]

    def _answers(self) -> Iterator[Drive]:
        while self._outcome is None:
            try:
                answer = pickle.load(self._from)
            except (EOFError, pickle.UnpicklingError):
                code = self._child.wait()
                how = ended_by(-code) if code < 0 else f"ended with code {code}"
                raise SlamsimError(f"the physics engine's process {how}") from None
            if isinstance(answer, Drive):
                yield answer
            elif isinstance(answer, DriveOutcome):
                self._outcome = answer
            else:
                raise SlamsimError(str(answer))


class _From(io.RawIOBase):
    """A pipe from a process that may be stopped."""

    def __init__(self, descriptor: int, patience: Patience) -> None:
        self._descriptor, self._patience = descriptor, patience

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        self._patience.wait((self._descriptor,))
        return os.readv(self._descriptor, (buffer,))


def _import_path() -> list[str | Path]:
    """Where this very package is, before whatever the user's environment names."""
    return [_PACKAGES, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]


def _send(stream: IO[bytes], value: object) -> None:
    try:
        pickle.dump(value, stream, protocol=pickle.HIGHEST_PROTOCOL)
        stream.flush()
    except BrokenPipeError:
        return  # the other end is gone: whoever reads from it is told why


def _serve() -> None:
    # What native code prints must not come between the answers.
    answers = os.fdopen(os.dup(_STANDARD_OUTPUT), "wb")
    os.dup2(_STANDARD_ERROR, _STANDARD_OUTPUT)
    run = drive(*pickle.load(sys.stdin.buffer))
    try:
        for window in run:
            pickle.dump(window, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
    except BrokenPipeError:
        return
    except SlamsimError as error:
        _send(answers, str(error))
        return
    _send(answers, run.outcome)


if __name__ == "__main__":
    _serve()
