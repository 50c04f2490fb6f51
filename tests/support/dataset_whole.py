"""A small finished data set, for tests that look at one, and the worker that makes such."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Self

from slamsim.dataset.make.engines.local import Answer, LocalEngine, WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.make.shard import ShardTask
from slamsim.dataset.recipe.distributions import Constant
from slamsim.dataset.recipe.loading import load_recipe

COUNT, SECONDS = 4, 4.0


class KeptEngine:
    """One worker of this machine that several data sets are made by, one after the other."""

    batch = 1

    def __init__(self, engine: LocalEngine) -> None:
        self._engine = engine

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """It stays for the next."""

    def slots(self) -> int:
        return self._engine.slots()

    def submit(self, task: ShardTask) -> Answer:
        return self._engine.submit(task)


def make_small(out: Path, engine: WorkEngine) -> None:
    recipe = load_recipe("tiny").model_copy(update={"duration_s": Constant(constant=SECONDS)})
    make_dataset(recipe, COUNT, str(out), engine)


def copied(place: Path, folder: Path) -> Path:
    """A copy that may be damaged."""
    shutil.copytree(place, folder)
    return folder
