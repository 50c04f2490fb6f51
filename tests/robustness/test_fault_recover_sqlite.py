"""Damaged, cut and unfinished rosbag2 SQLite files come back as far as SQLite reads them."""

from __future__ import annotations

import shutil
import sqlite3
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bag_data import ROS2, Robot, as_rosbag2
from fault_recovery import recovered_from
from rosbags.rosbag2 import Reader

from slamsim.guard.errors import InputRefused
from slamsim.io.open import read_log
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording

pytestmark = pytest.mark.fault

Messages = Counter[tuple[str, int, bytes]]
PAGE = 4096


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some 130 messages on thirty pages."""
    folder = as_rosbag2(tmp_path_factory.mktemp("whole") / "log", Robot(ROS2).drive())
    return folder / "log.db3"


def messages_of(path: Path) -> Messages:
    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topic_id = topics.id"
    with sqlite3.connect(path) as db:
        return Counter(db.execute(query))


def messages_in(folder: Path) -> Messages:
    with Reader(folder) as reader:
        return Counter((c.topic, stamp_ns, data) for c, stamp_ns, data in reader.messages())


def test_a_whole_file_becomes_mcap_and_loses_nothing(whole: Path, tmp_path: Path) -> None:
    told, folder = recovered_from(whole.read_bytes(), tmp_path / "b", "a.db3")
    assert messages_in(folder) == messages_of(whole)
    assert not told.losses
    (tmp_path / "c").mkdir()
    log = read_log(folder)
    assert len(list(log.scans)) == len(list(read_log(whole).scans))


def test_a_damaged_page_costs_its_own_messages(whole: Path, tmp_path: Path) -> None:
    data, right = whole.read_bytes(), messages_of(whole)
    rng = np.random.default_rng(1)
    recovered, refused = 0, 0
    for page in range(6, len(data) // PAGE):
        changed = bytearray(data)
        changed[page * PAGE : (page + 1) * PAGE] = rng.bytes(PAGE)
        try:
            told, folder = recovered_from(bytes(changed), tmp_path / "b", "a.db3")
        except InputRefused:  # the page that leads to all others
            refused += 1
            continue
        found = messages_in(folder)
        # A message of several pages has no checksum that tells of damage in the last of them.
        assert (found - right).total() <= 2
        recovered += (found & right).total()
        if found.total() < right.total():
            assert told.losses and any(topic.lost for topic in told.topics)
    assert refused <= 1
    assert recovered > 0.9 * right.total() * (len(data) // PAGE - 6)


def test_a_file_that_was_cut_off_is_read_as_far_as_it_goes(whole: Path, tmp_path: Path) -> None:
    data, right = whole.read_bytes(), messages_of(whole)
    kept = []
    for cut in np.linspace(9000, len(data) - 1, 20).astype(int).tolist():
        try:
            told, folder = recovered_from(data[:cut], tmp_path / "b", "a.db3")
        except InputRefused:
            kept.append(0)
            continue
        found = messages_in(folder)
        assert found <= right and told.messages == found.total()
        kept.append(found.total())
    assert kept == sorted(kept)
    assert kept[-1] > 0.8 * right.total()


@pytest.mark.parametrize("journal", ["WAL", "DELETE"])
def test_a_journal_beside_the_file_is_taken_into_account(
    journal: str, whole: Path, tmp_path: Path
) -> None:
    """Copied while a recorder has it open, as a kill leaves it."""
    (tmp_path / "log").mkdir()
    path = tmp_path / "log" / "a.db3"
    shutil.copyfile(whole, path)
    recorder = sqlite3.connect(path, isolation_level=None)
    recorder.execute(f"PRAGMA journal_mode = {journal}")
    recorder.execute("PRAGMA cache_size = 1")
    recorder.execute("BEGIN")
    recorder.execute(
        "INSERT INTO messages SELECT id + 500, topic_id, timestamp, data FROM messages"
    )
    if journal == "WAL":
        recorder.execute("COMMIT")
    (tmp_path / "killed").mkdir()
    for file in (tmp_path / "log").iterdir():
        shutil.copyfile(file, tmp_path / "killed" / file.name)
    recorder.close()
    (tmp_path / "out").mkdir()
    recover(damaged_recording(tmp_path / "killed"), tmp_path / "out")
    right = messages_of(whole)
    assert messages_in(tmp_path / "out") == (right + right if journal == "WAL" else right)
    assert not list((tmp_path / "out").glob("*.copy"))


def test_messages_that_are_compressed_one_by_one_are_unpacked(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    shutil.copyfile(whole, path)
    with sqlite3.connect(path) as db:
        packed = [
            (zstandard.compress(d), n) for n, d in db.execute("SELECT id, data FROM messages")
        ]
        packed[7] = (packed[7][0][:-9], packed[7][1])
        packed[8] = (zstandard.compress(bytes(80 << 20)), packed[8][1])
        db.executemany("UPDATE messages SET data = ? WHERE id = ?", packed)
    told, folder = recovered_from(path.read_bytes(), tmp_path / "b", "a.db3")
    found, right = messages_in(folder), messages_of(whole)
    assert found < right and right.total() - found.total() == 2
    assert "cannot be unpacked" in told.losses[0].reason


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\0" + bytes(5000), b"no database " * 99])
def test_what_is_no_database_is_refused(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="not one whole message"):
        recovered_from(content, tmp_path / "b", "a.db3")


def test_a_view_is_not_computed(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type)")
        db.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM n) SELECT id, 1 AS topic_id, 1 AS timestamp, x'00' AS data FROM n"
        )
    with pytest.raises(InputRefused, match="not a plain table"):
        recovered_from(path.read_bytes(), tmp_path / "b", "a.db3")
