"""What was changed in a sealed folder is refused by whoever reads it and named by verify.

``python tests/robustness/long_run.py sealed`` does the same by the thousand, of whole runs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_whole import COUNT, copied
from fault_sealed import Ground, case
from fault_sealed_folders import OF_MAP, OF_WORLD, Sealed, named_by_verify, of_world, sealed_dataset

from slamsim.core.types import Grid, Trajectory
from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.catalogue.write import write_catalogue
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.store.store import open_store
from slamsim.guard.errors import DataDamaged
from slamsim.guard.output import partial_folder
from slamsim.guard.seal import SUMS, sums_text
from slamsim.io.open import read_log, read_recording
from slamsim.io.text.tum import write_tum
from slamsim.run.folder import write_map

pytestmark = pytest.mark.fault
CASES = 10


def of_map(folder: Path) -> Sealed:
    """The files of a mapped run that cost nothing to make."""
    path = Trajectory(np.arange(9), np.zeros((9, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (9, 1)))
    with partial_folder(folder) as partial:
        for name in ("trajectory.tum", "odometry.tum", "ground_truth.tum", "parts/icp.tum"):
            write_tum(partial / name, path)
        write_map(partial, Grid(np.eye(9, dtype=np.float32), 0.05, (0.0, 0.0)))
        (partial / "run.rrd").write_bytes(b"RRF2 and pictures")
    readers = {**OF_WORLD, **OF_MAP}
    made = ("trajectory", "odometry", "ground truth", "parts", "map", "view")
    return Sealed("map", folder, {name: readers[name] for name in made}, named_by_verify)


@pytest.fixture(scope="module")
def grounds(small_set: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ground]:
    home = tmp_path_factory.mktemp("sealed")
    made = (
        sealed_dataset(copied(small_set, home / "set")),
        of_map(home / "map"),
        of_world(home / "world"),
    )
    return {sealed.name: Ground.of(sealed) for sealed in made}


def test_a_table_that_is_missing_is_missed(small_set: Path, tmp_path: Path) -> None:
    sequence = copied(small_set / "train/000000", tmp_path / "sequence")
    assert read_log(sequence / "parquet").imu is not None
    (sequence / "parquet/imu.parquet").unlink()
    for read in (read_log, read_recording):
        with pytest.raises(DataDamaged, match=r"imu\.parquet: missing"):
            read(sequence / "parquet")
    (sequence / "sequence.json").unlink()
    assert read_log(sequence / "parquet").imu is None


@pytest.mark.long
def test_a_data_set_vouches_for_nothing_while_its_catalogue_is_written(
    small_set: Path, tmp_path: Path
) -> None:
    place = copied(small_set, tmp_path / "set")
    (place / SUMS).write_text(sums_text({}))
    (place / "manifest.parquet").write_bytes((place / "shards/00000.parquet").read_bytes())
    reasons = [finding.reason for finding in verify(str(place)).findings if finding.path == SUMS]
    assert reasons == ["tells of no file: the data set was never finished"]
    write_catalogue(open_store(str(place)), load_recipe(str(place / "recipe.yaml")), COUNT)
    assert verify(str(place)).whole


@pytest.mark.long
@pytest.mark.parametrize("kind", ["data set", "map", "world"])
def test_a_few_changed_bytes_are_seen(kind: str, grounds: dict[str, Ground]) -> None:
    found = [case(grounds[kind], number, campaign=1) for number in range(CASES)]
    assert [one for one in found if one["outcomes"] or not one["named"]] == []
    assert sum(one["readers"] for one in found) > CASES // 2
