"""The kernel cache is code: it is used when nobody else can have written it, and never needed."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_jit import MODULE

pytestmark = pytest.mark.slow


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "tmp").mkdir()
    (tmp_path / "kernels.py").write_text(MODULE)
    return tmp_path


def run(place: Path, most_bytes: int | None = None, **environment: str) -> tuple[str, str]:
    """What the module prints and the log says; no file may then be longer than so many bytes."""

    def limit() -> None:
        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    done = subprocess.run(
        [sys.executable, str(place / "kernels.py")],
        env={
            **os.environ,
            "NUMBA_CACHE_DIR": str(place / "cache"),
            "HOME": str(place),
            "TMPDIR": str(place / "tmp"),
            **environment,
        },
        cwd=place / "tmp",
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        preexec_fn=limit,
    )
    return done.stdout.strip(), done.stderr


def the_cache(place: Path) -> Path:
    (folder,) = (place / "cache" / "slamsim").iterdir()
    return folder


def test_nothing_is_written_beside_the_sources(place: Path) -> None:
    place.joinpath("kernels.py").chmod(0o444)
    run(place)
    assert [path.name for path in place.rglob("*.nb?") if "cache" not in path.parts] == []
    assert list((place / "tmp").iterdir()) == []


@pytest.mark.parametrize("mode", [0o777, 0o720])
def test_a_cache_that_others_may_write_to_is_not_run(place: Path, mode: int) -> None:
    assert run(place)[0] == "7.0 True"
    the_cache(place).chmod(mode)
    printed, told = run(place)
    assert printed == "7.0 True"
    assert "can be written to by other users" in told
    assert list((place / "tmp").iterdir()) == []


@pytest.mark.skipif(os.getuid() != 0, reason="gives a folder away, which needs root")
def test_the_cache_of_somebody_else_is_not_run(place: Path) -> None:
    run(place)
    os.chown(the_cache(place), 12345, -1)
    printed, told = run(place)
    assert printed == "7.0 True"
    assert "can be written to by other users" in told


def test_a_full_disk_costs_the_cache_and_not_the_run(place: Path) -> None:
    printed, told = run(place, most_bytes=1000)
    assert printed == "7.0 True"
    assert "could not be cached" in told
    assert run(place)[0] == "7.0 True"
    assert run(place)[0] == "7.0 False"


def test_where_nothing_can_be_written_kernels_are_compiled_each_time(place: Path) -> None:
    blocked = place / "a file, no folder"
    blocked.write_text("")
    folder = place / "gone"
    folder.mkdir()
    code = "import os, runpy, sys, tempfile\n"
    code += "tempfile._candidate_tempdir_list = lambda: ['/nowhere at all']\n"
    code += f"runpy.run_path({str(place / 'kernels.py')!r}, run_name='kernels')\n"
    (place / "wrapped.py").write_text(code)
    done = subprocess.run(
        [sys.executable, str(place / "wrapped.py")],
        env={**os.environ, "NUMBA_CACHE_DIR": str(blocked)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "kernels are not cached" in done.stderr


def test_a_cache_that_vanishes_is_made_anew(place: Path) -> None:
    run(place)
    shutil.rmtree(place / "cache")
    assert run(place)[0] == "7.0 True"
