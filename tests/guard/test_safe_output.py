"""The way out: a final name holds a whole result or the old one, whatever happens meanwhile."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from killed import die, killed

from slamsim.guard import staging
from slamsim.guard.errors import DiskFull, SlamsimError
from slamsim.guard.lock import staging_of
from slamsim.guard.output import partial_folder, require_free_space, write_atomic


def run_of(final: Path, text: str, overwrite: bool = False) -> None:
    with partial_folder(final, overwrite) as folder:
        (folder / "log").mkdir()
        (folder / "log" / "data").write_text(text)
        (folder / "map.pgm").write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_whole_folder_appears_under_its_name_and_nothing_beside_it(tmp_path: Path) -> None:
    final = tmp_path / "outputs" / "run"
    with partial_folder(final) as folder:
        (folder / "a").write_text("a")
        assert not final.exists()
        assert folder.parent.parent == final.parent
        assert {path.name[0] for path in final.parent.iterdir()} == {"."}
    assert (final / "a").read_text() == "a"
    assert names(tmp_path / "outputs") == ["run"]


def test_a_relative_name_follows_no_change_of_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with partial_folder(Path("run")) as folder:
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        (folder / "a").touch()
    assert (tmp_path / "run" / "a").is_file()


@pytest.mark.parametrize("fault", [ValueError, KeyboardInterrupt, SystemExit, SlamsimError])
def test_after_an_exception_nothing_is_left(tmp_path: Path, fault: type[BaseException]) -> None:
    final = tmp_path / "run"

    def broken() -> None:
        with partial_folder(final) as folder:
            (folder / "half").touch()
            raise fault("stop")

    with pytest.raises(fault):
        broken()
    assert names(tmp_path) == []
    run_of(final, "old")
    with pytest.raises(fault), partial_folder(final, overwrite=True) as folder:
        (folder / "half").touch()
        raise fault("stop")
    assert names(tmp_path) == ["run"]
    assert (final / "map.pgm").read_text() == "old"


def test_an_existing_run_is_refused_before_any_work(tmp_path: Path) -> None:
    run_of(tmp_path / "run", "old")
    begun = False
    with (
        pytest.raises(SlamsimError, match="is there already"),
        partial_folder(tmp_path / "run"),
    ):
        begun = True
    assert not begun
    assert (tmp_path / "run" / "map.pgm").read_text() == "old"


def test_an_old_run_is_there_until_the_new_one_is_whole(tmp_path: Path) -> None:
    final = tmp_path / "run"
    run_of(final, "old")
    with partial_folder(final, overwrite=True) as folder:
        (folder / "map.pgm").write_text("new")
        assert (final / "map.pgm").read_text() == "old"
    assert (final / "map.pgm").read_text() == "new"
    assert not (final / "log").exists()
    assert names(tmp_path) == ["run"]


def test_what_slamsim_did_not_write_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1").touch()
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "thesis")
    for name, words in [
        ("thesis", "not write, which --overwrite does"),
        ("file", "not a folder"),
        ("link", "folder"),
    ]:
        with pytest.raises(SlamsimError, match=words):
            run_of(tmp_path / name, "x", overwrite=True)
    assert (tmp_path / "thesis" / "chapter1").exists()
    assert names(tmp_path) == ["file", "link", "thesis"]


def test_an_empty_folder_may_be_filled(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    run_of(tmp_path / "run", "x")
    assert (tmp_path / "run" / "map.pgm").exists()


def test_remains_of_a_killed_run_are_cleared_away(tmp_path: Path) -> None:
    def work() -> None:
        with partial_folder(tmp_path / "run") as folder:
            (folder / "half").touch()
            die()

    killed(work)
    assert len(names(tmp_path)) == 2
    run_of(tmp_path / "run", "x")
    assert names(tmp_path) == ["run"]
    assert not (tmp_path / "run" / "half").exists()


def killed_between_the_renames(final: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The staging folder that is left; what stood under the name is in there."""
    run_of(final, "old")
    rename = Path.rename

    def kill_at_the_second(self: Path, target: Path) -> Path:
        if target == final:
            die()
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(staging, "exchange", lambda one, other: False)
        patch.setattr(Path, "rename", kill_at_the_second)
        killed(lambda: run_of(final, "new", overwrite=True))
    assert not final.exists()
    left = staging_of(final)
    assert left is not None and (left / "old" / "map.pgm").read_text() == "old"
    return left


def test_a_kill_between_the_two_renames_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    final = tmp_path / "run"
    killed_between_the_renames(final, monkeypatch)
    with pytest.raises(SlamsimError, match="is there already"):
        run_of(final, "new")
    assert (final / "map.pgm").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_what_took_the_name_between_the_two_renames_loses_nothing_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    final = tmp_path / "run"
    left = killed_between_the_renames(final, monkeypatch)
    final.mkdir()
    with pytest.raises(SlamsimError, match="took the name of a run"):
        run_of(final, "new")
    assert (left / "old" / "map.pgm").read_text() == "old"
    final.rmdir()
    with pytest.raises(SlamsimError, match="is there already"):
        run_of(final, "new")
    assert names(tmp_path) == ["run"]


def test_a_failing_rename_brings_the_old_run_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    final = tmp_path / "run"
    run_of(final, "old")
    rename = Path.rename

    def fail_for_partial(self: Path, target: Path) -> Path:
        if self.name == staging.NEW:
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_partial)
    monkeypatch.setattr(staging, "exchange", lambda one, other: False)
    with pytest.raises(SlamsimError, match="Input/output error"):
        run_of(final, "new", overwrite=True)
    assert (final / "map.pgm").read_text() == "old"
    assert names(tmp_path) == ["run"]


FAULTS: dict[str, Callable[[], BaseException]] = {
    "full": lambda: OSError(errno.ENOSPC, "No space left on device"),
    "quota": lambda: OSError(errno.EDQUOT, "Disk quota exceeded"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_full_disk_is_told_as_such(tmp_path: Path, fault: str, wrapped: bool) -> None:
    def fail() -> None:
        with partial_folder(tmp_path / "run"):
            try:
                raise FAULTS[fault]()
            except OSError as error:
                if wrapped:
                    raise RuntimeError("flush failed") from error
                raise

    with pytest.raises(DiskFull, match=r"B are free"):
        fail()
    assert names(tmp_path) == []


def test_other_errors_of_the_writer_pass_unchanged(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), partial_folder(tmp_path / "run") as folder:
        (folder / "absent" / "file").write_text("x")


@pytest.mark.parametrize("step", ["fsync", "mkdir", "write_text"])
def test_each_failing_step_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    final = tmp_path / "run"
    with monkeypatch.context() as patch:
        if step == "fsync":
            patch.setattr(os, "fsync", fail)
        elif step == "mkdir":
            mkdir = Path.mkdir
            patch.setattr(
                Path,
                "mkdir",
                lambda p, *a, **k: fail() if p.name == staging.NEW else mkdir(p, *a, **k),
            )
        else:
            patch.setattr(Path, "write_text", fail)
        with pytest.raises(DiskFull), partial_folder(final) as folder:
            (folder / "data").write_bytes(b"x")
    assert names(tmp_path) == []


def test_write_atomic_replaces_whole_files_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "made" / "on" / "the way.png"
    write_atomic(path, b"old")
    write_atomic(path, b"new")
    assert path.read_bytes() == b"new"

    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(DiskFull):
        write_atomic(path, b"newer")
    assert path.read_bytes() == b"new"
    assert names(path.parent) == ["the way.png"]


def test_names_that_cannot_be_written_are_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    attempts: list[Callable[[], None]] = [
        lambda: write_atomic(tmp_path / "file" / "below", b""),
        lambda: write_atomic(tmp_path, b""),
        lambda: write_atomic(Path("/dev/null"), b""),
        lambda: write_atomic(tmp_path / ("x" * 300), b""),
        lambda: write_atomic(tmp_path / "nul\0", b""),
        lambda: run_of(tmp_path / "file" / "below", "x"),
        lambda: run_of(tmp_path / "file", "x", overwrite=True),
        lambda: run_of(Path("/"), "x", overwrite=True),
        lambda: run_of(tmp_path / ("x" * 300), "x"),
    ]
    for attempt in attempts:
        with pytest.raises(SlamsimError) as caught:
            attempt()
        assert "\n" not in str(caught.value)
    assert names(tmp_path) == ["file"]


def test_free_space_is_asked_for_beforehand(tmp_path: Path) -> None:
    require_free_space(tmp_path / "not" / "there yet", 1)
    with pytest.raises(DiskFull, match="are needed"):
        require_free_space(tmp_path, 10**18)
