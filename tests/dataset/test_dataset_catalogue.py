"""Manifest, statistics, card and figures: right, complete, and the same bytes for the same rows."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from slamsim.dataset.catalogue.card import data_card
from slamsim.dataset.catalogue.statistics import manifest, statistics
from slamsim.dataset.catalogue.write import catalogue_files, write_catalogue
from slamsim.dataset.make.identity import IDENTITY
from slamsim.dataset.make.shard import shard_path
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.sequence import SPLITS, Cell
from slamsim.dataset.store.lazy_table import rows_to_parquet, table_from_parquet
from slamsim.dataset.store.store import open_store
from slamsim.guard.errors import StoreFailed

Row = dict[str, Cell]
CELLS = (
    st.none()
    | st.booleans()
    | st.integers(-5, 5)
    | st.floats(-2.0, 2.0)
    | st.text("ab", max_size=2)
)
ROWS = st.lists(
    st.dictionaries(st.sampled_from(["drawn.a", "quality.b", "drawn.c", "d"]), CELLS), max_size=6
)


def shard(rows: list[Row]) -> pa.Table:
    return table_from_parquet(rows_to_parquet(rows))


def row(index: int, **cells: Cell) -> Row:
    split = SPLITS[index % 3]
    return {
        "index": index,
        "name": f"{split}/{index:06d}",
        "split": split,
        "world_index": index // 2,
        "seed": 2**60 + index,
        "faults": ("", "lidar_late:0.02", "gyro_sign,lidar_late:0.01")[index % 3],
        "drawn.world": "tiny",
        "drawn.sensors.lidar": ("lds_01", "rplidar_a2")[index % 2],
        "drawn.size": index * 0.5,
        "quality.duration_s": 60.0,
        "quality.path_length_m": 10.0 + index,
        "quality.scans": 600,
        "files": 3,
        "size_bytes": 1000,
        "sha256": "0" * 64,
        "status": "made",
        "reason": None,
        "command": None,
        **cells,
    }


FAILED: Row = {"index": 9, "status": "failed", "reason": "stuck", "command": "slamsim ..."}


@given(st.lists(ROWS, max_size=4))
def test_the_manifest_has_every_cell_of_every_shard(parts: list[list[Row]]) -> None:
    tables = [shard(rows) for rows in parts if rows]
    whole = manifest(tables, {"slamsim": "1", "numpy": "2"})
    told = [cells for table in tables for cells in table.to_pylist()]
    assert whole.num_rows == len(told)
    for name in whole.column_names:
        for found, cells in zip(whole[name].to_pylist(), told, strict=True):
            given_cell = cells.get(name)
            if name == "versions":
                assert found == "slamsim 1, numpy 2"
            elif isinstance(found, str) and not isinstance(given_cell, str):
                assert given_cell is not None
            else:
                assert found == given_cell
    assert {name for cells in told for name in cells} <= set(whole.column_names)


def test_columns_stand_in_groups_and_have_one_type() -> None:
    whole = manifest([shard([row(0)]), shard([FAILED]), shard([row(2, **{"drawn.z": 1})])], {})
    names = whole.column_names
    assert names[:3] == ["index", "name", "split"] and names[-1] == "versions"
    groups = [name.partition(".")[0] for name in names if "." in name]
    assert groups == sorted(groups)
    assert not [field.name for field in whole.schema if pa.types.is_null(field.type)]
    assert whole["name"].to_pylist() == ["train/000000", None, "test/000002"]
    assert whole["reason"].to_pylist() == [None, "stuck", None]


def test_statistics_count_what_was_made() -> None:
    rows = [row(index) for index in range(6)]
    told = statistics(manifest([shard(rows), shard([FAILED])], {}))
    assert (told["sequences"], told["failed"], told["worlds"]) == (7, 1, 3)
    assert told["simulated_h"] == 0.1 and told["path_km"] == pytest.approx(0.075)
    assert told["scans"] == 3600 and told["size_bytes"] == 6000
    assert {name: part["sequences"] for name, part in told["splits"].items()} == dict.fromkeys(
        SPLITS, 2
    )
    assert told["faults"] == {"lidar_late": 4, "gyro_sign": 2, "none": 2}
    assert told["drawn"]["sensors.lidar"] == {"lds_01": 3, "rplidar_a2": 3}
    path = told["numbers"]["quality.path_length_m"]
    assert (path["least"], path["median"], path["most"]) == (10.0, 12.5, 15.0)
    json.dumps(told, allow_nan=False)


@pytest.mark.long
def test_the_same_rows_make_the_same_files_and_the_card_names_all_of_them() -> None:
    recipe = load_recipe("tiny")
    whole = manifest([shard([row(index) for index in range(4)])], {"slamsim": "1"})
    files = dict(catalogue_files(recipe, whole))
    assert files == dict(catalogue_files(recipe, whole))
    card = files["README.md"].decode()
    pictures = set(re.findall(r"!\[.*?\]\((.*?)\)", card))
    assert pictures == {name for name in files if name.endswith(".png")}
    assert {"figures/path_length.png", "figures/lidars.png", "figures/faults.png"} <= pictures
    matter = yaml.safe_load(card.split("---\n")[1])
    assert matter["license"] == "cc0-1.0" and matter["pretty_name"] == recipe.title
    assert "4 kB, with" in card
    assert files["LICENSE.txt"].decode().count("CC0-1.0") == 2
    for name in pictures:
        assert files[name].startswith(b"\x89PNG") and b"tIME" not in files[name]


def tables_of(card: str) -> dict[str, Any]:
    """What the card offers to Hugging Face, by name."""
    matter = yaml.safe_load(card.split("---\n")[1])
    return {table["config_name"]: table["data_files"] for table in matter["configs"]}


@pytest.mark.parametrize(("beams", "has_scans"), [((360, 360), True), ((360, 1440), False)])
def test_the_card_names_the_tables_that_can_be_read_as_one(
    beams: tuple[int, int], has_scans: bool
) -> None:
    recipe = load_recipe("tiny")
    rows = [row(index, **{"quality.beams": beams[index]}) for index in range(2)]
    told = statistics(manifest([shard(rows)], {}))
    tables = tables_of(data_card(recipe, told, {}, ()))
    assert tables["manifest"] == "manifest.parquet"
    assert tables["imu"] == [
        {"split": split, "path": f"{split}/*/parquet/imu.parquet"} for split in ("train", "val")
    ]
    assert ("scans" in tables) == has_scans
    without = recipe.model_copy(update={"formats": ("mcap",)})
    assert set(tables_of(data_card(without, told, {}, ()))) == {"manifest"}


def test_a_data_set_of_which_nothing_could_be_made_has_a_card_too() -> None:
    recipe = load_recipe("tiny")
    whole = manifest([shard([{**FAILED, "index": index} for index in range(3)])], {})
    files = dict(catalogue_files(recipe, whole))
    assert b"of which 3 could not be made" in files["README.md"]
    assert json.loads(files["statistics.json"])["failed"] == 3


def test_the_card_follows_the_size_of_the_set() -> None:
    recipe = load_recipe("tiny")
    told = statistics(manifest([shard([row(index) for index in range(4)])], {}))
    for count, size in ((999, "n<1K"), (1000, "1K<n<10K"), (10**6, "n>1M")):
        card = data_card(recipe, {**told, "sequences": count}, {}, ())
        assert yaml.safe_load(card.split("---\n")[1])["size_categories"] == [size]


def test_a_data_set_that_is_removed_while_it_is_made_is_told(tmp_path: Path) -> None:
    recipe, store = load_recipe("tiny"), open_store(str(tmp_path / "set"))
    with pytest.raises(StoreFailed, match=f"{IDENTITY} is gone: another program changed"):
        write_catalogue(store, recipe, 1)
    store.write(IDENTITY, b"{}")
    with pytest.raises(StoreFailed, match="parquet is gone: another program changed"):
        write_catalogue(store, recipe, 1)
    store.write(shard_path(0), b"PAR1")
    with pytest.raises(StoreFailed, match=r"parquet is damaged .* another program changed"):
        write_catalogue(store, recipe, 1)
