"""A small finished data set, for tests that look at one, and the worker that makes such."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Self, TypeVar

from slamsim.dataset.make.engines.local import Answer, LocalEngine, WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.make.shard import ShardTask
from slamsim.dataset.recipe.distributions import Constant
from slamsim.dataset.recipe.loading import load_recipe

COUNT, SECONDS = 4, 4.0
Result = TypeVar("Result")


class KeptEngine:
    """One worker of this machine that several data sets are made by, one after the other.

    workers: the same, for what is no data set.
    """

    batch = 1

    def __init__(self, engine: LocalEngine) -> None:
        self._engine = engine
        self.workers = nullcontext(engine._workers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """It stays for the next."""

    def slots(self) -> int:
        return self._engine.slots()

    def submit(self, task: ShardTask) -> Answer:
        return self._engine.submit(task)


class LentWorker:
    """As ``Worker``, by one that stays."""

    def __init__(self, engine: KeptEngine) -> None:
        self._workers = engine.workers.enter_result

    def run(self, work: Callable[[], Result], limit_s: float) -> Result:
        return self._workers.submit(work, limit_s).result()

    def close(self) -> None:
        """It stays for the next."""


def make_small(out: Path, engine: WorkEngine) -> None:
    recipe = load_recipe("tiny").model_copy(update={"duration_s": Constant(constant=SECONDS)})
    make_dataset(recipe, COUNT, str(out), engine)


def copied(place: Path, folder: Path) -> Path:
    """A copy that may be damaged."""
    shutil.copytree(place, folder)
    return folder
