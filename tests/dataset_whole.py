"""A small finished data set, for tests that look at one."""

from __future__ import annotations

import shutil
from pathlib import Path

from slamsim.dataset.distributions import Constant
from slamsim.dataset.engines.local import LocalEngine
from slamsim.dataset.loading import load_recipe
from slamsim.dataset.make import make_dataset

COUNT = 4


def make_small(out: Path, count: int = COUNT, seconds: float = 4.0) -> None:
    recipe = load_recipe("tiny").model_copy(update={"duration_s": Constant(constant=seconds)})
    make_dataset(recipe, count, str(out), LocalEngine(1))


def copied(place: Path, folder: Path) -> Path:
    """A copy that may be spoilt."""
    shutil.copytree(place, folder)
    return folder
