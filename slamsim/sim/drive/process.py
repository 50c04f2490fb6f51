"""Runs the drive in a process of its own, in parallel with sensing.

PyBullet and Open3D both hold Python's lock while they compute; only a second process lets them
work side by side. The child is ``python -m slamsim.sim.drive.process``: it is sent the drive on
standard input and answers with windows on standard output, at most one or two ahead.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Self, cast

from slamsim.config.drive import DriveConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive
from slamsim.guard.errors import SlamsimError
from slamsim.process.children import MEMORY, Halted
from slamsim.process.exit_codes import ended_by
from slamsim.process.module_process import ModuleProcess, answers, tell
from slamsim.process.pipe import Ended, packed, read_message
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.record import START_NS
from slamsim.sim.drive.run import DriveOutcome, DriveRun, Driving
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from slamsim.world.model import World

_Order = tuple["World", RobotModel, Route, DriveConfig]


class DriveProcess(Driving):
    """A process that waits for a drive; a context manager, so that it never outlives its use.

    It loads its libraries while the caller still builds the world.
    """

    def __init__(self) -> None:
        self._child = ModuleProcess("slamsim.sim.drive.process")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._child.end()

    def drive(
        self,
        world: World,
        robot: RobotModel,
        route: Route,
        config: DriveConfig,
        progress: Progress = silent,
    ) -> Iterator[Drive]:
        """The same windows and outcome as ``DriveRun`` gives, byte for byte; once only.

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
        self._child.send(packed((world, robot, route, config)))
        for window in self._answers():
            elapsed_s = float(window.stamps_ns[-1] - START_NS) * 1e-9
            progress(elapsed_s, max(route.duration_estimate_s, elapsed_s))
            yield window

    def _answers(self) -> Iterator[Drive]:
        while self._outcome is None:
            self._child.wait()
            try:
                found = self._child.receive()
                MEMORY.see(self._child.pid)
            except Ended:
                code = self._child.exit_code()
                how = ended_by(-code) if code < 0 else f"ended with code {code}"
                raise SlamsimError(f"the physics engine's process {how}") from None
            for answer in found:
                if isinstance(answer, Drive):
                    yield answer
                elif isinstance(answer, DriveOutcome):
                    self._outcome = answer
                else:
                    raise SlamsimError(str(answer))


def _serve() -> None:
    stream = answers()
    with suppress(BrokenPipeError):  # the other end is gone: there is no one to tell
        run = DriveRun(*cast(_Order, read_message(sys.stdin.buffer)))
        try:
            for window in run:
                tell(stream, window)
            tell(stream, run.outcome)
        except SlamsimError as error:
            tell(stream, str(error))


if __name__ == "__main__":
    _serve()
