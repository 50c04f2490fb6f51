"""The kernel cache: used when it is whole, made anew when it is not, never in the way."""

from __future__ import annotations

import ast
import gc
import importlib
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError
from sources import tree_of

from slamsim.core import jit

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


@pytest.mark.long
def test_the_second_run_compiles_nothing(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(tmp_path, cache)[0] == "7.0 True"
    assert run(tmp_path, cache)[0] == "7.0 False"
    folders = list((cache / "slamsim").iterdir())
    assert len(folders) == 1
    assert folders[0].stat().st_mode & 0o077 == 0


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the user's; modules of the test are found beside it."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(jit, "_cache_folder", lambda: folder)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "kernels.py").write_text(MODULE)
    return folder


def imported() -> None:
    """As a new process would."""
    sys.modules.pop("kernels", None)
    importlib.import_module("kernels")


def test_a_damaged_entry_is_noticed_and_made_anew(
    cache: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Cut or with one bit turned, in the index as in the code, which nobody may run then."""
    imported()
    entries = list(cache.glob("kernels.outer*.nb?"))
    assert len(entries) == 2 and capsys.readouterr().out == "7.0 True\n"
    for path in entries:
        whole = path.read_bytes()
        for damaged in (whole[:-10], whole[:90] + bytes([whole[90] ^ 1]) + whole[91:]):
            path.write_bytes(damaged)
            caplog.clear()
            imported()
            assert capsys.readouterr().out == "7.0 True\n"
            assert "made anew" in caplog.text
    imported()
    assert capsys.readouterr().out == "7.0 False\n"


def test_checkouts_share_what_they_compile(
    cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever they are; but not two modules of one name."""
    for place, compiles in (("one/a", True), ("two/a", False), ("two/b", True)):
        folder = cache.parent / place
        folder.mkdir(parents=True)
        (folder / "kernels.py").write_text(MODULE)
        monkeypatch.setattr(jit, "_PACKAGE", folder.parent)
        monkeypatch.syspath_prepend(str(folder))
        imported()
        assert capsys.readouterr().out == f"7.0 {compiles}\n"


def test_modules_beside_the_package_are_told_by_their_path(
    cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they call besides our kernels may differ, even where a folder begins with our name."""
    for place in ("one", "two"):
        folder = cache.parent / place / "slamsim_more"
        folder.mkdir(parents=True)
        (folder / "kernels.py").write_text(MODULE)
        monkeypatch.setattr(jit, "_PACKAGE", cache.parent / place / "slamsim")
        monkeypatch.syspath_prepend(str(folder))
        imported()
        assert capsys.readouterr().out == "7.0 True\n"


def test_an_entry_that_another_process_wrote_over_is_not_run(tmp_path: Path) -> None:
    """Both found no index, and took the same number for the code of different types."""
    one, other = (jit._CheckedFile(str(tmp_path), "kernel", b"source") for _ in range(2))
    one.save("of integers", "code for integers")
    (tmp_path / one._index_name).unlink()
    code = tmp_path.joinpath("kernel.1.nbc").read_bytes()
    other.save("of floats", "code for floats")
    assert other.load("of floats") == "code for floats"
    tmp_path.joinpath("kernel.1.nbc").write_bytes(code)
    assert other.load("of floats") is None
    other.save("of floats", "code for floats")
    assert other.load("of floats") == "code for floats"


def test_what_is_compiled_while_sources_are_edited_is_not_kept(
    cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A caller may be of one state and what it calls of another."""
    source = cache.parent / "kernels.py"
    monkeypatch.setattr(jit, "_read_ns", {source: source.stat().st_mtime_ns - 1})
    for _ in range(2):
        imported()
        assert capsys.readouterr().out == "7.0 True\n"
    assert list(cache.iterdir()) == []
    monkeypatch.setattr(jit, "_read_ns", {source: source.stat().st_mtime_ns})
    for compiles in (True, False):
        imported()
        assert capsys.readouterr().out == f"7.0 {compiles}\n"


def test_environments_share_only_what_their_libraries_make_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(jit, "_read_ns", {})
    usual = jit._cache_folder.__wrapped__()
    assert jit._cache_folder.__wrapped__() == usual
    monkeypatch.setattr(jit.config, "USING_SVML", not jit.config.USING_SVML)
    vectors = jit._cache_folder.__wrapped__()
    monkeypatch.setattr(np, "__version__", "another")
    assert len({usual, vectors, jit._cache_folder.__wrapped__()}) == 3


def test_an_edit_costs_the_kernels_that_depend_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By way of other modules too, whichever of two it was that said it."""
    monkeypatch.setattr(jit, "_PACKAGE", tmp_path)
    texts = {
        "top": "from slamsim.rooms.middle import f\nfrom slamsim.words import w\n@kernel",
        "rooms/middle": "from slamsim.leaf import (\n  g)\nfrom slamsim.other import h\n@kernel",
        "leaf": "from slamsim.rooms.middle import f\n@kernel",
        "other": "@kernel # other",
        "alone": "@kernel",
        "words": "from slamsim.more import w",
    }
    (tmp_path / "rooms").mkdir()

    def stamps(**edited: str) -> dict[str, bytes]:
        for name, text in (texts | edited).items():
            (tmp_path / f"{name}.py").write_text(text)
        jit._source.cache_clear()
        return {name: jit._source_stamp(tmp_path / f"{name}.py") for name in texts}

    before = stamps()
    depend = {"leaf": {"top", "rooms/middle", "leaf"}, "alone": {"alone"}, "words": {"words"}}
    for name, those in depend.items():
        after = stamps(**{name: texts[name] + " edited"})
        assert {one for one in texts if after[one] != before[one]} == those
    swapped = stamps(leaf=texts["other"], other=texts["leaf"])
    assert swapped["top"] != before["top"]
    assert stamps() == before


def test_what_is_compiled_is_told_once_in_plain_words(
    cache: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("INFO", "slamsim")
    jit._announce_compilation.cache_clear()

    def body(x: float) -> float:
        return x

    monkeypatch.setattr(body, "__module__", "slamsim.check.map_quality.entropy")
    compiled = jit.kernel(body)
    assert compiled(1.0) == compiled(1) == 1
    told = [record.getMessage() for record in caplog.records]
    assert told == ["compiling the numeric code of check map quality for its first use"]


def test_nowhere_to_write_costs_the_cache_and_not_the_run(tmp_path: Path) -> None:
    blocked = tmp_path / "a file, not a folder"
    blocked.write_text("")
    printed, told = run(tmp_path, blocked)
    assert printed == "7.0 True"
    assert "for this run only" in told


def test_kernels_take_no_numbers_from_modules_without_kernels() -> None:
    """The names in the cache are made of modules with kernels alone: what another says would stay
    as it was when they were compiled."""
    package = Path(jit.__file__).parents[1]
    trees = {
        "slamsim." + ".".join(path.relative_to(package).with_suffix("").parts): tree_of(path)
        for path in package.rglob("*.py")
        if "@kernel" in path.read_text()
    }
    assert "slamsim.models.blocks" in trees
    for module, tree in trees.items():
        imports = [one for one in tree.body if isinstance(one, ast.ImportFrom)]
        strange = {
            alias.name
            for one in imports
            if (one.module or "").startswith("slamsim") and one.module not in trees
            for alias in one.names
        }
        for function in tree.body:
            if isinstance(function, ast.FunctionDef) and any(
                isinstance(one, ast.Name) and one.id == "kernel" for one in function.decorator_list
            ):
                nodes = [node for line in function.body for node in ast.walk(line)]
                used = {node.id for node in nodes if isinstance(node, ast.Name)}
                assert not used & strange, f"{module}.{function.name}"


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("fails", [True, False])
def test_no_garbage_collection_while_compiling(
    cache: Path, monkeypatch: pytest.MonkeyPatch, enabled: bool, fails: bool
) -> None:
    def body(x: float) -> float:
        return x.missing if fails else x + 1.0  # type: ignore[attr-defined]

    seen: list[bool] = []
    compiled = jit.kernel(body)
    compiler = compiled._compiler  # type: ignore[attr-defined]
    original = compiler.compile

    def watched(*given: object) -> object:
        seen.append(gc.isenabled())
        return original(*given)

    monkeypatch.setattr(compiler, "compile", watched)
    was_enabled = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        with pytest.raises(TypingError) if fails else nullcontext():
            compiled(1.0)
        assert seen == [False]
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()
