"""``slamsim verify``: what is altered or missing is named, what is added is told."""

from __future__ import annotations

import bz2
import gzip
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bag_data import ROS1, ROS2, Robot, as_mcap, as_ros1, as_rosbag2
from dataset_run import tree
from mcap.writer import CompressionType, Writer
from typed import typed

from slamsim.console.reporter import Reporter
from slamsim.guard.errors import NotFound
from slamsim.guard.output import partial_folder
from slamsim.guard.seal import SUMS
from slamsim.io.open import checked_recording
from slamsim.run.verifying import verify_and_tell, verify_path

pytestmark = pytest.mark.fault
LASER = "FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 1.0 host 1.0\n"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    with partial_folder(folder) as partial:
        (partial / "log").mkdir()
        (partial / "log" / "data").write_bytes(b"first")
        (partial / "map.pgm").write_bytes(b"second")
        (partial / "empty").touch()
    return folder


def named(path: Path) -> dict[str, str]:
    return {damage.path: damage.reason for damage in verify_path(path).damaged}


def test_an_untouched_folder_is_whole_and_stays_as_it_is(run: Path) -> None:
    before, times = tree(run), (run / "map.pgm").stat()
    found = verify_path(run)
    assert found.whole and found.files == 4 and found.extra == ()
    assert tree(run) == before and (run / "map.pgm").stat() == times


def test_what_is_altered_missing_or_added_is_told_apart(run: Path) -> None:
    (run / "map.pgm").write_bytes(b"secund")
    (run / "empty").write_bytes(b"x")
    (run / "log" / "data").unlink()
    (run / "notes.txt").touch()
    (run / ".cache").touch()
    found = verify_path(run)
    assert named(run) == {
        "log/data": "missing",
        "map.pgm": "its bytes are not those that were written",
        "empty": "its bytes are not those that were written",
    }
    assert found.extra == ("notes.txt",)


def test_a_part_is_judged_alone(run: Path) -> None:
    (run / "map.pgm").write_bytes(b"secund")
    assert verify_path(run / "log").whole and verify_path(run / "log" / "data").whole
    assert set(named(run / "map.pgm")) == {"map.pgm"}
    (run / "log" / "more").touch()
    assert verify_path(run / "log").extra == ("log/more",)
    assert verify_path(run / "empty").extra == ()


def test_without_sums_or_with_damaged_ones_nothing_is_vouched_for(run: Path) -> None:
    text = (run / SUMS).read_bytes()
    (run / SUMS).write_bytes(text[:-1])
    assert list(named(run)) == [str(run / SUMS)]
    (run / SUMS).unlink()
    assert list(named(run)) == [SUMS]


def test_a_file_that_became_a_folder_or_a_pipe_is_missing(run: Path) -> None:
    for name in ("map.pgm", "empty"):
        (run / name).unlink()
    (run / "map.pgm").mkdir()
    os.mkfifo(run / "empty")
    assert named(run) == {"map.pgm": "missing", "empty": "missing"}


def test_where_nobody_vouches_there_is_nothing_to_compare(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for place in (tmp_path, tmp_path / "notes.txt", tmp_path / "nothing"):
        with pytest.raises(NotFound):
            verify_path(place)


def carmen(path: Path, packed: Callable[[bytes], bytes]) -> Path:
    path.write_bytes(packed(LASER.encode() * 3))
    return path


def without_checksums(path: Path) -> Path:
    with path.open("wb") as file:
        writer: Any = Writer(file, enable_crcs=False, enable_data_crcs=False)
        writer.start()
        schema = writer.register_schema("a/msg/A", "ros2msg", b"int8 a")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\1", 1)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda p: as_mcap(p / "a.mcap", Robot(ROS2).drive(), CompressionType.ZSTD),
            "all that is in",
        ),
        (lambda p: without_checksums(p / "a.mcap"), r"a chunk \(1x\), the data section \(1x\)"),
        (lambda p: as_rosbag2(p / "a", Robot(ROS2).drive()), "nothing: SQLite"),
        (
            lambda p: as_ros1(p / "a.bag", Robot(ROS1).drive(), "BZ2"),
            "packed with bz2 have checksums",
        ),
        (lambda p: carmen(p / "a.clf", bytes), "nothing: plain text"),
        (lambda p: carmen(p / "a.clf.gz", gzip.compress), "the packed text has checksums"),
        (lambda p: carmen(p / "a.clf.bz2", bz2.compress), "the packed text has checksums"),
    ],
)
def test_of_a_recording_it_says_what_its_checksums_vouch_for(
    make: Callable[[Path], Path], words: str, tmp_path: Path
) -> None:
    path = make(tmp_path)
    found = verify_path(path)
    assert found.whole and found.size_bytes > 0
    assert re.search(words, found.checked_against), found.checked_against


def test_a_cut_or_altered_recording_is_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = carmen(tmp_path / "a.clf.gz", gzip.compress)
    path.write_bytes(path.read_bytes()[:-1])
    assert "cut off" in str(named(path))
    assert not verify_and_tell(str(path), Reporter())
    told = capsys.readouterr().out
    # slamsim did not write it: no command of ours makes it again.
    assert "cut off" in told and "Run the command again" not in told
    path = as_mcap(tmp_path / "a.mcap", Robot(ROS2).drive(), CompressionType.ZSTD)
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    path.write_bytes(data)
    assert f"{path}, byte" in str(named(path))


def test_the_tables_of_a_data_set_and_its_log_have_checksums_throughout(small_set: Path) -> None:
    sequence = small_set / "train/000000"
    assert "every page" in checked_recording(sequence / "parquet")
    assert checked_recording(sequence / "log") == (
        "all that is in the MCAP files has checksums, and they hold"
    )
    found = verify_path(sequence)
    assert found.whole and found.files > 10


def test_a_data_set_is_told_by_what_lies_in_it(
    small_set: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert verify_and_tell(str(small_set), Reporter(as_json=True))
    assert json.loads(capsys.readouterr().out)["sequences"] == 4


def test_the_command_ends_with_0_4_or_10(run: Path) -> None:
    assert typed("verify", run, "-q", cwd=run.parent).returncode == 0
    (run / "map.pgm").write_bytes(b"secund")
    (run / "notes").touch()
    done = typed("verify", run, "--json", cwd=run.parent)
    told = json.loads(done.stdout)
    assert done.returncode == 4 and not told["whole"] and told["extra"] == ["notes"]
    assert [damage["path"] for damage in told["damaged"]] == ["map.pgm"]
    assert "map.pgm: its bytes are not those" in typed("verify", run, cwd=run.parent).stdout
    assert typed("verify", "nothing", cwd=run.parent).returncode == 10
