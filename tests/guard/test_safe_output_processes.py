"""The way out when processes die, meet, or run into limits of the system."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from slamsim.guard.errors import Locked
from slamsim.guard.output import partial_folder


def run_of(final: Path, text: str, overwrite: bool = False) -> None:
    with partial_folder(final, overwrite) as folder:
        (folder / "map.pgm").write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_real_file_size_limit_is_a_full_disk(tmp_path: Path) -> None:
    code = """
    import resource, sys
    from pathlib import Path
    from slamsim.guard.errors import DiskFull
    from slamsim.guard.output import partial_folder, write_atomic
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
    for write in (
        lambda: write_atomic(Path(sys.argv[1]) / "file", b"x" * 20_000),
        lambda: folder(Path(sys.argv[1]) / "run"),
    ):
        def folder(final):
            with partial_folder(final) as partial:
                (partial / "big").write_bytes(b"x" * 20_000)
        try:
            write()
        except DiskFull as error:
            print(error.exit_code)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.split() == ["75", "75"]
    assert names(tmp_path) == []


HOLDER = """
import sys, time
from pathlib import Path
from slamsim.guard.output import partial_folder
with partial_folder(Path(sys.argv[1]), overwrite=True) as folder:
    (folder / "half").write_text("x")
    print("begun", flush=True)
    time.sleep(60)
"""


def holder(final: Path) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(final)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "begun\n"
    return child


def test_a_second_process_is_told_who_writes(tmp_path: Path) -> None:
    child = holder(tmp_path / "run")
    try:
        with pytest.raises(Locked, match=f"process {child.pid} on"):
            run_of(tmp_path / "run", "x", overwrite=True)
        assert child.poll() is None, "it was not waited for"
        run_of(tmp_path / "other", "x")
    finally:
        child.kill()
        child.communicate()


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_process_frees_the_name_and_keeps_the_old_run(
    tmp_path: Path, sent: signal.Signals
) -> None:
    final = tmp_path / "run"
    run_of(final, "old")
    child = holder(final)
    child.send_signal(sent)
    child.communicate(timeout=60)
    assert child.returncode != 0
    assert (final / "map.pgm").read_text() == "old"
    if sent == signal.SIGINT:
        assert names(tmp_path) == ["run"]
    run_of(final, "new", overwrite=True)
    assert (final / "map.pgm").read_text() == "new"
    assert names(tmp_path) == ["run"]


def test_of_many_at_once_one_writes(tmp_path: Path) -> None:
    code = """
    import sys, time
    from pathlib import Path
    from slamsim.guard.errors import SlamsimError
    from slamsim.guard.output import partial_folder
    wrote = refused = 0
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        try:
            with partial_folder(Path(sys.argv[1]) / "run", overwrite=True) as folder:
                for name in "abc":
                    (folder / name).write_text(sys.argv[2])
                wrote += 1
        except SlamsimError as error:
            assert error.exit_code == 11, error
            refused += 1
    print(wrote, refused)
    """
    children = [
        subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code), str(tmp_path), str(number)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(4)
    ]
    counts = [child.communicate(timeout=60)[0].split() for child in children]
    assert all(child.returncode == 0 for child in children)
    assert sum(int(wrote) for wrote, _ in counts) > 0
    assert names(tmp_path) == ["run"]
    assert len({(tmp_path / "run" / name).read_text() for name in "abc"}) == 1
