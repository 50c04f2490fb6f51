"""A small finished data set, made once for all tests that look at one."""

from __future__ import annotations

import shutil
from pathlib import Path

from slamsim.dataset.engines.local import LocalEngine
from slamsim.dataset.loading import load_recipe
from slamsim.dataset.make import make_dataset

COUNT = 4


def make_small(out: Path, count: int = COUNT) -> None:
    make_dataset(load_recipe("tiny"), count, str(out), LocalEngine(1))


def copied(place: Path, folder: Path) -> Path:
    """A copy that may be spoilt."""
    shutil.copytree(place, folder)
    return folder
