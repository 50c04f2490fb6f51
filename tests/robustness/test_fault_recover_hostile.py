"""Hostile files cost recovery neither memory nor time, and it writes only where it is told."""

from __future__ import annotations

import bz2
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bag_data import ROS2, Robot, as_mcap
from fault_recovery import recovered_from
from killed import die, killed
from limited_child import run_limited
from mcap import records

from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused, OutputRefused
from slamsim.guard.output import partial_folder
from slamsim.guard.replaceable import require_apart
from slamsim.io.mcap.framing import MAGIC, record_bytes
from slamsim.io.open import read_log
from slamsim.io.salvage.source import damaged_recording
from slamsim.run.recovering import recover_log

pytestmark = pytest.mark.fault

DEPTH = 20_000
RECOVER = """
import sys
from pathlib import Path
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording
from slamsim.guard.errors import InputRefused
try:
    recover(damaged_recording(Path(sys.argv[1])), Path(sys.argv[2]))
except InputRefused:
    print("refused")
"""


def _mcap_chunk(content: bytes, claimed: int) -> bytes:
    packed, crc = zstandard.compress(content), zlib.crc32(content)
    return record_bytes(records.Chunk("zstd", packed, 0, 0, crc, claimed))


def mcap_bombs() -> bytes:
    zeros = bytes(64 << 20)
    return MAGIC + b"".join(_mcap_chunk(zeros, n) for n in (300 << 20, 1 << 20, 1 << 62))


def nested_mcap() -> bytes:
    """Chunks that each claim all that follows, and none of them fits its checksum."""
    heads, inside = list[bytes](), 0
    for _ in range(DEPTH):
        heads.append(struct.pack("<BQQQQIIQ", 6, 40 + inside, 0, 0, inside, 1, 0, inside))
        inside += len(heads[-1])
    return MAGIC + b"".join(reversed(heads))


def _bag_record(fields: dict[bytes, bytes], data_bytes: int) -> bytes:
    texts = [name + b"=" + value for name, value in fields.items()]
    pairs = b"".join(struct.pack("<I", len(text)) + text for text in texts)
    return struct.pack("<I", len(pairs)) + pairs + struct.pack("<I", data_bytes)


def nested_bag() -> bytes:
    heads, inside = list[bytes](), 3
    fields = {b"op": b"\x05", b"compression": b"bz2", b"size": struct.pack("<I", 1 << 20)}
    for _ in range(DEPTH):
        heads.append(_bag_record(fields, inside))
        inside += len(heads[-1])
    return b"#ROSBAG V2.0\n" + b"".join(reversed(heads)) + b"end"


def bag_bomb() -> bytes:
    packed = bz2.compress(bytes(64 << 20))
    fields = {b"op": b"\x05", b"compression": b"bz2", b"size": struct.pack("<I", 400 << 20)}
    return b"#ROSBAG V2.0\n" + _bag_record(fields, len(packed)) + packed


def bzip2_marks() -> bytes:
    return b"BZh9" + bytes.fromhex("314159265359") * 100_000


HOSTILE: dict[str, tuple[str, Callable[[], bytes]]] = {
    "mcap bombs": ("a.mcap", mcap_bombs),
    "mcap chunks in chunks": ("a.mcap", nested_mcap),
    "bag bomb": ("a.bag", bag_bomb),
    "bag chunks in chunks": ("a.bag", nested_bag),
    "bzip2 marks": ("a.clf.bz2", bzip2_marks),
    "headers and no bag": ("a.bag", lambda: b"\x40\0\0\0\x04\0\0\0op=\x02" * 50_000),
    "chunk shapes and no chunk": ("a.mcap", lambda: MAGIC + b"\x06\0\0\0\0\0\0\0\0" * 100_000),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_files_stay_within_memory_and_time(kind: str, tmp_path: Path) -> None:
    name, make = HOSTILE[kind]
    (tmp_path / name).write_bytes(make())
    (tmp_path / "out").mkdir()
    arguments = (str(tmp_path / name), str(tmp_path / "out"))
    done = run_limited(RECOVER, *arguments, memory_bytes=1 << 30, seconds=60)
    assert done.stdout.strip() == "refused"


def test_random_bytes_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for name in ("a.mcap", "a.bag", "a.clf", "a.clf.gz", "a.clf.bz2", "a.db3"):
        for size in (1, 100, 10_000):
            with pytest.raises(InputRefused):
                recovered_from(rng.bytes(size), tmp_path / "b", name)


def test_the_damaged_recording_is_never_written_over(tmp_path: Path) -> None:
    log = tmp_path / "run" / "log"
    log.mkdir(parents=True)
    as_mcap(log / "a.mcap", Robot(ROS2).drive())
    damaged = damaged_recording(tmp_path / "run")
    assert damaged.path == log
    for taken in (log, tmp_path / "run", log / "new", tmp_path / "run" / ".." / "run"):
        with pytest.raises(OutputRefused, match="choose another"):
            require_apart([taken], [damaged.path])
    require_apart([tmp_path / "run_recovered"], [damaged.path])

    def work() -> None:
        with partial_folder(tmp_path / "x") as folder:
            as_mcap(folder / "a.mcap", Robot(ROS2).drive())
            die()

    killed(work)
    with pytest.raises(OutputRefused, match="choose another"):
        require_apart([tmp_path / "x"], [damaged_recording(tmp_path / "x").path])


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    as_mcap(tmp_path / "a.mcap", Robot(ROS2).drive())
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "a.mcap").symlink_to(tmp_path / "a.mcap")
    with pytest.raises(InputRefused, match="link"):
        damaged_recording(tmp_path / "log")


def test_the_command_tells_and_seals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = as_mcap(tmp_path / "a.mcap", Robot(ROS2).drive(), chunk_size=3000).read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputRefused, match=r"`slamsim recover .*a\.mcap` gets back what is whole"):
        read_log(tmp_path / "a.mcap")
    reporter = Reporter(as_json=True)
    found = recover_log(damaged_recording(tmp_path / "a.mcap"), tmp_path / "out", reporter)
    told = json.loads(capsys.readouterr().out)
    assert told["messages"] == found.messages > 0
    assert told["losses"][0]["path"] == "a.mcap"
    assert {"SHA256SUMS", "a.mcap", "metadata.yaml", "recovery.json"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
    assert len(list(read_log(tmp_path / "out").scans)) > 3
    assert json.loads((tmp_path / "out" / "recovery.json").read_text())["notes"] == told["notes"]
