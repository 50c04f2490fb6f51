"""Text logs from outside: the same lines from any packing, and no damage goes unseen."""

from __future__ import annotations

import bz2
import gzip
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from limited_child import run_limited
from lowered_limits import lowered
from real_logs import needs_radish, radish

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.unpacking import open_lines

PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    "plain": lambda raw: raw,
    "gzip": gzip.compress,
    "bzip2": bz2.compress,
    "bzip2 in pieces": lambda raw: b"".join(
        bz2.compress(raw[i : i + 30_000]) for i in range(0, max(len(raw), 1), 30_000)
    ),
}
LONG = "\n".join(f"FLASER {i} {i * 0.37:.3f} {random.Random(i).random()}" for i in range(5000))


def lines_until_refused(path: Path) -> tuple[list[str], InputRefused | None]:
    lines: list[str] = []
    try:
        for _, line in open_lines(path):
            lines.append(line)
    except InputRefused as error:
        return lines, error
    return lines, None


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("text", ["", "one", "one\n", "\n\n", "a\r\nb\r\n", LONG, LONG + "\n"])
def test_all_packings_give_the_same_lines(tmp_path: Path, packing: str, text: str) -> None:
    path = tmp_path / "log.anything"
    path.write_bytes(PACKINGS[packing](text.encode()))
    expected = text.replace("\r\n", "\n").split("\n")
    if expected[-1] == "":
        expected.pop()
    assert list(open_lines(path)) == list(enumerate(expected, start=1))


@given(
    st.binary(max_size=200).filter(lambda raw: b"\0" not in raw and raw[:1] not in b"\x1fB\xef(")
)
def test_lines_are_those_of_a_plain_split(raw: bytes) -> None:
    with tempfile.NamedTemporaryFile() as file:
        file.write(raw)
        file.flush()
        lines = [line for _, line in open_lines(Path(file.name))]
    expected = raw.removesuffix(b"\n").split(b"\n") if raw else []
    assert lines == [e.rstrip(b"\r").decode("utf-8", "backslashreplace") for e in expected]


@pytest.mark.parametrize("packing", ["gzip", "bzip2", "bzip2 in pieces"])
def test_a_cut_archive_names_the_line_reached(tmp_path: Path, packing: str) -> None:
    packed = PACKINGS[packing](LONG.encode())
    path = tmp_path / "log"
    for share in (0.02, 0.3, 0.7, 0.999):
        path.write_bytes(packed[: int(share * len(packed))])
        lines, error = lines_until_refused(path)
        assert error is not None
        assert "cut off" in error.reason
        assert error.where == f"line {len(lines) + 1}"
        assert lines == LONG.split("\n")[: len(lines)]


@pytest.mark.parametrize("packing", ["gzip", "bzip2"])
def test_no_changed_byte_of_an_archive_goes_unseen(tmp_path: Path, packing: str) -> None:
    packed = PACKINGS[packing](LONG.encode())
    path = tmp_path / "log"
    dice = random.Random(5)
    for _ in range(60):
        broken = bytearray(packed)
        # The first ten bytes of gzip hold a time stamp and a system that nothing depends on.
        broken[dice.randrange(10, len(packed))] ^= 1 << dice.randrange(8)
        path.write_bytes(broken)
        _, error = lines_until_refused(path)
        assert error is not None


@pytest.mark.parametrize("packing", ["gzip", "bzip2"])
def test_bytes_after_the_end_are_refused_and_padding_is_not(tmp_path: Path, packing: str) -> None:
    path = tmp_path / "log"
    path.write_bytes(PACKINGS[packing](b"one\ntwo\n") + b"\0" * 100_000)
    assert lines_until_refused(path) == (["one", "two"], None)
    path.write_bytes(PACKINGS[packing](b"one\ntwo\n") + b"garbage")
    lines, error = lines_until_refused(path)
    assert lines == ["one", "two"]
    assert error is not None
    assert "damaged" in error.reason


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.clf"
    path.write_bytes(b"\x7fELF\x02\x01\x01\0\0\0\0\n")
    with pytest.raises(InputRefused, match="line 1: holds a NUL byte"):
        list(open_lines(path))


def test_odd_bytes_and_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "log.clf"
    path.write_bytes(b"\xef\xbb\xbf# caf\xe9\nODOM")
    assert list(open_lines(path)) == [(1, "# caf\\xe9"), (2, "ODOM")]


def test_missing_files_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        open_lines(tmp_path / "absent")
    with pytest.raises(InputRefused, match="folder"):
        open_lines(tmp_path)


def test_limits_on_line_total_and_ratio(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(b"short\n" + b"x" * 101)
    with (
        pytest.raises(InputRefused, match="line 2: the line is longer than 100 bytes"),
        lowered(text_line_bytes=100),
    ):
        list(open_lines(path))
    with (
        pytest.raises(InputRefused, match="more than 100 bytes of text"),
        lowered(text_total_bytes=100),
    ):
        list(open_lines(path))
    path.write_bytes(bz2.compress(b"a line\n" * 100_000))
    with (
        pytest.raises(InputRefused, match="more text than a log"),
        lowered(text_ratio=100, text_ratio_floor_bytes=1000),
    ):
        list(open_lines(path))


def test_bombs_are_stopped_in_little_memory(tmp_path: Path) -> None:
    (tmp_path / "long_line.bz2").write_bytes(bz2.compress(b"x" * 30_000_000))
    (tmp_path / "long_line.gz").write_bytes(gzip.compress(b"x" * 30_000_000, 1))
    (tmp_path / "newlines.bz2").write_bytes(bz2.compress(b"\n" * 20_000_000))
    done = run_limited(
        """
        import sys
        from pathlib import Path
        from slamsim.guard.errors import InputRefused
        from slamsim.guard.unpacking import open_lines
        for path in sorted(Path(sys.argv[1]).iterdir()):
            try:
                for _ in open_lines(path):
                    pass
                print("read")
            except InputRefused as error:
                print(path.name, error.reason)
        """,
        str(tmp_path),
        memory_bytes=160 << 20,
    )
    told = done.stdout.splitlines()
    assert "longer than 1,048,576 bytes" in told[0]
    assert "longer than 1,048,576 bytes" in told[1]
    assert "more text than a log" in told[2]


@needs_radish
def test_the_lines_of_a_real_log() -> None:
    count = sum(line.startswith("FLASER") for _, line in open_lines(radish("aces")[0]))
    assert count == 7374
