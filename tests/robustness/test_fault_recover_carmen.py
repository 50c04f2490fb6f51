"""Cut and damaged CARMEN logs come back line by line."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from fault_recovery import MANY, cuts, damaged, recovered_from

from slamsim.guard.errors import InputRefused
from slamsim.io.open import read_log

pytestmark = pytest.mark.fault

OPEN: dict[str, Callable[[bytes], bytes]] = {
    "a.clf": bytes,
    "a.clf.gz": gzip.decompress,
    "a.clf.bz2": bz2.decompress,
}


def line(number: int) -> bytes:
    ranges = " ".join(f"{1.0 + (number * 7 + beam) % 50 / 10:.2f}" for beam in range(19))
    pose = f"{0.01 * number:.6f} 0.000000 0.100000"
    stamp = f"{100.0 + 0.2 * number:.6f}"
    return f"FLASER 19 {ranges} {pose} {pose} {stamp} host {stamp}\n".encode()


LINES = [b"# a comment\n", b"PARAM robot_front_laser_max 20.0 1 host 1\n", *map(line, range(300))]
TEXT = b"".join(LINES)


def read_back(folder: Path) -> list[bytes]:
    (path,) = folder.iterdir()
    return OPEN[path.name](path.read_bytes()).splitlines(keepends=True)


def complete_lines(name: str, cut: bytes) -> list[bytes]:
    """As the decompressors of Python, fed with all there is, let them be seen."""
    if name.endswith("bz2"):
        text, rest = b"", cut
        while rest:
            decoder = bz2.BZ2Decompressor()
            text += decoder.decompress(rest)
            rest = decoder.unused_data
    elif name.endswith("gz"):
        text = zlib.decompressobj(31).decompress(cut)
    else:
        text = cut
    return text[: text.rfind(b"\n") + 1].splitlines(keepends=True)


def packed(name: str) -> bytes:
    if name.endswith("gz"):
        return gzip.compress(TEXT, 6, mtime=0)
    parts = [b"".join(LINES[first : first + 9]) for first in range(0, len(LINES), 9)]
    return b"".join(map(bz2.compress, parts)) if name.endswith("bz2") else TEXT


@MANY
@pytest.mark.parametrize("name", OPEN)
def test_of_a_log_cut_anywhere_every_whole_line_comes_back(
    name: str, count: int, tmp_path: Path
) -> None:
    data = packed(name)
    for cut in cuts(data, 1, [len(data) // 2], count):
        expected = complete_lines(name, data[:cut])
        if len(expected) < 3:
            with pytest.raises(InputRefused, match="not one whole message"):
                recovered_from(data[:cut], tmp_path / "b", name)
            continue
        told, folder = recovered_from(data[:cut], tmp_path / "b", name)
        assert read_back(folder) == expected
        assert told.messages == len(expected) - 2
        assert told.losses or name.endswith("bz2")  # which ends well after each of its streams


@pytest.mark.parametrize("name", OPEN)
def test_a_whole_log_loses_nothing(name: str, tmp_path: Path) -> None:
    told, folder = recovered_from(packed(name), tmp_path / "b", name)
    assert read_back(folder) == LINES
    assert not told.losses and not told.notes
    assert len(list(read_log(folder / name).scans)) == 300


@MANY
def test_damaged_blocks_of_bzip2_are_left_out_and_no_more(count: int, tmp_path: Path) -> None:
    data = packed("a.clf.bz2")
    for _, changed in damaged(data, 3, count):
        told, folder = recovered_from(changed, tmp_path / "b", "a.clf.bz2")
        found = read_back(folder)
        assert set(found) <= set(LINES)
        assert len(LINES) - len(found) <= 2 * 10
        assert len(found) == len(LINES) or told.losses


def test_blocks_in_one_bzip2_stream_begin_at_any_bit(tmp_path: Path) -> None:
    many = b"".join(map(line, range(4000)))
    data = bytearray(bz2.compress(many, 1))  # blocks of 100 kB
    data[len(data) // 2] ^= 1
    told, folder = recovered_from(bytes(data), tmp_path / "b", "a.clf.bz2")
    found = read_back(folder)
    assert set(found) <= set(many.splitlines(keepends=True))
    assert len(many) - len(b"".join(found)) < 110_000
    assert [loss.reason for loss in told.losses] == ["a damaged bzip2 block"]
    assert told.losses[0].gap_s == pytest.approx(0.2 * (4001 - len(found)), abs=1.0)


def test_lines_that_are_none_are_left_out_and_told(tmp_path: Path) -> None:
    bad = [b"FLASER 19 1.0 2.0\n", b"\x00\xff\x13 garbage\n", b"hello world\n", b"x" * (2 << 20)]
    text = b"".join([*LINES[:50], *bad[:3], *LINES[50:], bad[3] + b"\n", *LINES[2:4], b"FLASER 1"])
    told, folder = recovered_from(text, tmp_path / "b", "a.log")
    (path,) = folder.iterdir()
    assert path.read_bytes() == TEXT + b"".join(LINES[2:4])
    assert len(told.losses) == 5
    assert {topic.topic: topic.lost for topic in told.topics} == {"FLASER": 1}


def test_members_of_gzip_after_a_damaged_one_come_back(tmp_path: Path) -> None:
    first, second = (gzip.compress(b"".join(part)) for part in (LINES[:150], LINES[150:]))
    changed = bytearray(first)
    changed[len(first) // 2] ^= 0xFF
    told, folder = recovered_from(bytes(changed) + second, tmp_path / "b", "a.clf.gz")
    found = read_back(folder)
    assert found[-len(LINES[151:]) :] == LINES[151:]
    assert any("may be wrong" in note for note in told.notes)


@pytest.mark.long
@pytest.mark.parametrize("name", ["a.clf.gz", "a.clf.bz2"])
def test_a_bomb_is_refused(name: str, tmp_path: Path) -> None:
    bomb = b"0" * (80 << 20)
    data = gzip.compress(bomb, 9) if name.endswith("gz") else bz2.compress(bomb)
    with pytest.raises(InputRefused, match="than a log of this size can hold") as refused:
        recovered_from(data, tmp_path / "b", name)
    assert refused.value.limit == "text_ratio"
