"""What was changed in a sealed folder is refused by whoever reads it and named by verify.

``python tests/long_run.py sealed`` does the same by the thousand.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from dataset_whole import copied
from fault_sealed import Ground, case
from fault_sealed_folders import OF_MAP, OF_WORLD, Sealed, named_by_verify, of_world, sealed_dataset

from slamsim.config.loading import load_run_config
from slamsim.console import Reporter
from slamsim.run.mapping import map_recording

pytestmark = pytest.mark.fault
CASES = 25


def of_map(small_set: Path, folder: Path) -> Sealed:
    map_recording(
        small_set / "train/000000/log", load_run_config(None), folder, Reporter(quiet=True)
    )
    return Sealed("map", folder, {**OF_WORLD, **OF_MAP}, named_by_verify)


@pytest.fixture(scope="module")
def grounds(small_set: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ground]:
    home = tmp_path_factory.mktemp("sealed")
    made = (
        sealed_dataset(copied(small_set, home / "set")),
        of_map(small_set, home / "map"),
        of_world(home / "world"),
    )
    return {sealed.name: Ground.of(sealed) for sealed in made}


@pytest.mark.parametrize("kind", ["data set", "map", "world"])
def test_a_few_changed_bytes_are_seen(kind: str, grounds: dict[str, Ground]) -> None:
    found = [case(grounds[kind], number, campaign=1) for number in range(CASES)]
    assert [one for one in found if one["outcomes"] or not one["named"]] == []
    assert sum(one["readers"] for one in found) > CASES // 2
