"""A simulated drive without a process of its own.

To start that process, which loads numpy, pydantic and PyBullet, costs more than most drives of
tests. ``test_drive_process.py`` holds that its windows are those of a drive in this process, byte
for byte; what is typed as a command of its own has the process.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

import pytest

from slamsim.config.drive import DriveConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.run import DriveOutcome, DriveRun
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from slamsim.world.model import World


class DriveHere:
    """As ``DriveProcess``."""

    _run: DriveRun

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """There is nothing to end."""

    @property
    def outcome(self) -> DriveOutcome:
        return self._run.outcome

    def drive(
        self,
        world: World,
        robot: RobotModel,
        route: Route,
        config: DriveConfig,
        progress: Progress = silent,
    ) -> Iterator[Drive]:
        self._run = DriveRun(world, robot, route, config, progress)
        return iter(self._run)


@contextmanager
def driving_here() -> Iterator[None]:
    """Simulations within drive in this process."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        for module in ("driven", "simulate"):
            monkeypatch.setattr(f"slamsim.simulation.{module}.DriveProcess", DriveHere)
        yield
