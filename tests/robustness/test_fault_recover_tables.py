"""Damaged Parquet tables come back by groups of rows; a cut one cannot, and that is said."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from recording_data import recording

from slamsim.guard.errors import InputRefused
from slamsim.io.open import read_log
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording

pytestmark = pytest.mark.fault

SECONDS = 120.0


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    with ParquetLog(tmp_path / "parquet") as log:
        log.write(recording(SECONDS))
    (tmp_path / "out").mkdir()
    return tmp_path / "parquet"


def test_whole_tables_lose_nothing(tables: Path) -> None:
    told = recover(damaged_recording(tables), tables.parent / "out")
    assert not told.losses
    for path in tables.iterdir():
        again = pq.read_table(tables.parent / "out" / path.name)
        assert again.equals(pq.read_table(path), check_metadata=True)


def test_a_damaged_group_costs_its_rows(tables: Path) -> None:
    path = tables / "scans.parquet"
    table = pq.ParquetFile(path)
    assert table.num_row_groups > 1
    column = table.metadata.row_group(1).column(table.schema_arrow.get_field_index("ranges_m"))
    data = bytearray(path.read_bytes())
    first = column.dictionary_page_offset or column.data_page_offset
    data[first + column.total_compressed_size // 2] ^= 1
    path.write_bytes(data)
    told = recover(damaged_recording(tables), tables.parent / "out")
    lost = {topic.topic: topic.lost for topic in told.topics if topic.lost}
    assert lost == {"scans": table.metadata.row_group(1).num_rows}
    assert [loss.path.name for loss in told.losses] == ["scans.parquet"]
    log = read_log(tables.parent / "out")
    assert len(list(log.scans)) == table.metadata.num_rows - lost["scans"]


def test_a_table_that_was_cut_off_is_named(tables: Path) -> None:
    path = tables / "imu.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    told = recover(damaged_recording(tables), tables.parent / "out")
    assert "cut off or damaged" in told.losses[0].reason
    assert not (tables.parent / "out" / "imu.parquet").exists()
    assert read_log(tables.parent / "out").imu is None
    for path in tables.iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputRefused, match="not one whole message"):
        recover(damaged_recording(tables), tables.parent)
