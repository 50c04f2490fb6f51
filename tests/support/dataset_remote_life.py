"""What a data set behind a URL goes through: made, read, damaged, verified, repaired."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
from dataset_run import tree

import slamsim.dataset
from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.recipe.distributions import Constant
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.store.remote import RemoteStore
from slamsim.run.dataset.telling import repair_plan

COUNT, SECONDS = 2, 4.0
DAMAGED = "train/000000/truth/scans.parquet"


def downloaded(address: str, folder: Path) -> dict[str, bytes]:
    store = RemoteStore(address)
    store._files.invalidate_cache()
    store._files.get(store._root, str(folder), recursive=True)
    return tree(folder)


def live_through(address: str, engine: WorkEngine, folder: Path) -> None:
    """All of it, repaired as the commands that are told do it; folder: for copies here."""
    recipe = load_recipe("tiny").model_copy(update={"duration_s": Constant(constant=SECONDS)})
    make_dataset(recipe, COUNT, address, engine)
    found = verify(address)
    assert found.whole and found.checked == COUNT
    whole = downloaded(address, folder / "whole")
    assert found.files == len(whole)

    there, here = slamsim.dataset.open(address), slamsim.dataset.open(folder / "whole")
    np.testing.assert_array_equal(there[1].scans.ranges_m, here[1].scans.ranges_m)

    data = bytearray(whole[DAMAGED])
    data[len(data) // 2] ^= 1
    RemoteStore(address).write(DAMAGED, bytes(data))
    damaged = verify(address)
    assert [finding.path for finding in damaged.findings] == [DAMAGED]

    *removal, making = repair_plan(damaged).commands
    for command in removal:
        python, *words = shlex.split(command)
        assert python == "python"
        subprocess.run([sys.executable, *words], check=True)
    assert making == f"slamsim dataset make {address}/recipe.yaml -n {COUNT} --out {address}"
    make_dataset(recipe, COUNT, address, engine)
    assert downloaded(address, folder / "repaired") == whole
    assert verify(address).whole
