"""The kernel cache: used when it is whole, made anew when it is not, never in the way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

MODULE = """
from slamsim.core.jit import kernel

@kernel
def inner(x):
    return 2.0 * x

@kernel
def outer(x):
    return inner(x) + 1.0

print(outer(3.0), bool(outer.stats.cache_misses))
"""


def run(folder: Path, cache: Path) -> tuple[str, str]:
    """What the module prints, and what the log says, in a process of its own."""
    script = folder / "kernels.py"
    script.write_text(MODULE)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "HOME": str(folder)}
    done = subprocess.run(
        [sys.executable, str(script)],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.strip(), done.stderr


def test_the_second_run_compiles_nothing(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(tmp_path, cache)[0] == "7.0 True"
    assert run(tmp_path, cache)[0] == "7.0 False"
    folders = list((cache / "slamsim").iterdir())
    assert len(folders) == 1
    assert folders[0].stat().st_mode & 0o077 == 0


def test_a_damaged_entry_is_noticed_and_made_anew(tmp_path: Path) -> None:
    """Cut or with one bit turned, in the index as in the code, which nobody may run then."""
    cache = tmp_path / "cache"
    run(tmp_path, cache)
    for path in (cache / "slamsim").rglob("kernels.outer*.nb?"):
        whole = path.read_bytes()
        for damaged in (whole[:-10], whole[:90] + bytes([whole[90] ^ 1]) + whole[91:]):
            path.write_bytes(damaged)
            printed, told = run(tmp_path, cache)
            assert printed == "7.0 True"
            assert "made anew" in told
    assert run(tmp_path, cache)[0] == "7.0 False"


def test_nowhere_to_write_costs_the_cache_and_not_the_run(tmp_path: Path) -> None:
    blocked = tmp_path / "a file, not a folder"
    blocked.write_text("")
    printed, told = run(tmp_path, blocked)
    assert printed == "7.0 True"
    assert "for this run only" in told
