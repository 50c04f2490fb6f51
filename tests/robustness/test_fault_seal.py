"""What slamsim sealed is compared with its seal whenever it is read: damage is seen, not used."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from dataset_stub import draw

from slamsim.dataset.make.shard import made_row, sequence_mark
from slamsim.dataset.recipe.sequence import SequenceFacts
from slamsim.guard.errors import DataDamaged, NotFound
from slamsim.guard.files import open_as_found, open_input
from slamsim.guard.output import partial_folder
from slamsim.guard.seal import (
    SEQUENCE,
    SUMS,
    SumsDamaged,
    read_sequence,
    read_sums,
    require_as_written,
    seal_in,
    sequence_text,
    sha256_of,
    sums_text,
)

pytestmark = pytest.mark.fault


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A sealed folder with a file and one in a folder."""
    folder = tmp_path / "run"
    with partial_folder(folder) as partial:
        (partial / "log").mkdir()
        (partial / "log" / "data").write_bytes(b"first")
        (partial / "map").write_bytes(b"second")
    return folder


def read(path: Path) -> bytes:
    with open_input(path) as file:
        return file.read()


def altered(path: Path) -> None:
    """One bit, and neither size nor time of last change tell."""
    facts = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))


def test_every_written_folder_says_what_its_files_must_be(run: Path) -> None:
    assert sorted(read_sums((run / SUMS).read_bytes())) == [".slamsim", "log/data", "map"]
    done = subprocess.run(["sha256sum", "--check", "--quiet", SUMS], cwd=run, check=False)
    assert done.returncode == 0


def test_what_was_altered_is_refused_and_the_rest_is_read(run: Path) -> None:
    assert read(run / "map") == b"second"
    altered(run / "map")
    with pytest.raises(DataDamaged, match="has changed since slamsim wrote it") as refused:
        read(run / "map")
    assert refused.value.path == run / "map" and refused.value.exit_code == 4
    assert f"slamsim verify {run}`" in str(refused.value)
    assert read(run / "log" / "data") == b"first"
    with open_as_found(run / "map") as file:
        assert len(file.read()) == len(b"second")


def test_a_file_is_found_by_any_of_its_names(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    altered(run / "log" / "data")
    (tmp_path / "whole").symlink_to(run)
    (tmp_path / "part").symlink_to(run / "log")
    (tmp_path / "file").symlink_to(run / "log" / "data")
    monkeypatch.chdir(run / "log")
    for name in ("whole/log/data", "part/data", "file", "run/log/../log/data"):
        with pytest.raises(DataDamaged):
            read(tmp_path / name)
    with pytest.raises(DataDamaged):
        read(Path("data"))
    shutil.move(run / "log" / "data", tmp_path / "elsewhere")
    (run / "log" / "data").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DataDamaged):
        read(run / "log" / "data")


def test_what_was_copied_out_or_added_is_anybodys(run: Path, tmp_path: Path) -> None:
    altered(run / "map")
    shutil.copy(run / "map", tmp_path / "map")
    (run / "notes").write_text("mine")
    assert read(tmp_path / "map") != b"second"
    assert read(run / "notes") == b"mine"
    with pytest.raises(NotFound):
        read(run / "nothing")


def test_sums_that_were_altered_vouch_for_nothing(run: Path) -> None:
    for place in range(len((run / SUMS).read_bytes())):
        data = bytearray((run / SUMS).read_bytes())
        data[place] ^= 4
        (run / SUMS).write_bytes(data)
        with pytest.raises(DataDamaged, match=SUMS):
            read(run / "map")
        data[place] ^= 4
        (run / SUMS).write_bytes(data)
    assert read(run / "map") == b"second"


@pytest.mark.parametrize("name", ["/etc/passwd", "../map", "log/../../map", ".."])
def test_a_seal_tells_of_files_in_its_folder_alone(name: str) -> None:
    with pytest.raises(SumsDamaged):
        read_sums(sums_text({name: "0" * 64}).encode())
    with pytest.raises(SumsDamaged):
        read_sequence(sequence_text({"files": [{"path": name, "sha256": "0" * 64}]}).encode())


def test_a_sequence_is_sealed_by_the_file_that_describes_it(tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "a").write_bytes(b"a")
    facts = [{"path": "truth/a", "size_bytes": 1, "sha256": sha256_of(b"a")}]
    text = sequence_text({"name": "train/000000", "files": facts})
    (tmp_path / SEQUENCE).write_text(text)
    assert read(tmp_path / "truth" / "a") == b"a"
    (tmp_path / "truth" / "a").write_bytes(b"b")
    with pytest.raises(DataDamaged):
        read(tmp_path / "truth" / "a")
    for place in range(len(text)):
        (tmp_path / SEQUENCE).write_text(text[:place] + "#" + text[place + 1 :])
        with pytest.raises(DataDamaged, match=SEQUENCE):
            read(tmp_path / "truth" / "a")


def test_a_damaged_sequence_is_taken_for_absent_and_made_again() -> None:
    spec = draw(0)
    mark = sequence_mark(spec, SequenceFacts({"scans": 12, "overlap": 0.25}, ()))
    row = made_row(spec, mark)
    assert row is not None and row["quality.scans"] == 12
    for place in range(len(mark)):
        assert made_row(spec, mark[:place] + bytes([mark[place] ^ 1]) + mark[place + 1 :]) is None


FOREIGN = (
    "",
    f"{0:064}  map\n",
    f"{0:064}  lines above: 1\n",
    "{}",
    '{"files": [1]}',
    "[" * 99_999,
)


@pytest.mark.parametrize("foreign", [*FOREIGN, "\xff\0"])
def test_files_of_the_same_name_that_others_wrote_are_no_seals(
    tmp_path: Path, foreign: str
) -> None:
    (tmp_path / "map").write_bytes(b"map")
    for name in (SUMS, SEQUENCE):
        (tmp_path / name).write_text(foreign)
    assert read(tmp_path / "map") == b"map"


def test_whatever_else_bears_the_name_of_a_seal_is_none(tmp_path: Path) -> None:
    (tmp_path / "map").write_bytes(b"map")
    (tmp_path / SUMS).mkdir()
    os.mkfifo(tmp_path / SEQUENCE)
    assert seal_in(tmp_path) is None
    require_as_written(tmp_path / "map")


def test_an_overwritten_folder_is_sealed_anew(run: Path) -> None:
    assert read(run / "map") == b"second"
    with partial_folder(run, overwrite=True) as partial:
        (partial / "map").write_bytes(b"second, again")
    assert read(run / "map") == b"second, again"
    assert sorted(read_sums((run / SUMS).read_bytes())) == [".slamsim", "map"]
