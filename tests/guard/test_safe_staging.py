"""Whatever a user has around an output, under whatever names, it is never touched.

Random files, folders and links of odd names beside an output; it is then written, overwritten,
broken off and killed in any order. Each of the user's files must be the same file afterwards.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from fault_nth import quick_folder
from foreign_files import snapshot
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from killed import die, killed

from slamsim.guard import lock, staging
from slamsim.guard.errors import Locked, SlamsimError
from slamsim.guard.lock import lock_of, locked, owner_words, staging_of
from slamsim.guard.output import claimed_folder, partial_file, partial_folder
from slamsim.run.naming import output_folder

RUN, PAGE = "run", "page.html"
FINALS = (RUN, PAGE)

AROUND = (
    *(f"{final}{end}" for final in FINALS for end in (".lock", ".partial", ".old", "~", " ", "\n")),
    *(f".{final}{end}" for final in FINALS for end in (".lock", ".partial", ".old", ".swp", "")),
    *(f".{final}.slamsim-{end}" for final in FINALS for end in ("0" * 16, "x", "lock~", "LOCK")),
    *(f".slamsim-{end}" for end in ("0" * 16, "lock")),
    *("new", "old", staging.MARKER, "SHA256SUMS", "run_2", "\udce9t\udce9"),
)


def _file(path: Path) -> None:
    path.write_bytes(b"mine")


def _folder(path: Path) -> None:
    """As a folder that slamsim wrote looks, and as its staging folder does."""
    for name in ("thesis.tex", ".slamsim", staging.MARKER, "new/a", "old/.slamsim", "old/b"):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_text(f"{name} is mine")


def _like_ours(path: Path) -> None:
    """As the lock file of another output."""
    path.write_bytes(owner_words("lock", "another", path.with_name(f".run.slamsim-{'0' * 16}")))


KINDS: dict[str, Callable[[Path], object]] = {
    "a file": _file,
    "an empty file": Path.touch,
    "a folder": _folder,
    "an empty folder": Path.mkdir,
    "a lock of another name": _like_ours,
    "a link to a file": lambda path: path.symlink_to("thesis.tex"),
    "a link to the folder above": lambda path: path.symlink_to(".."),
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


class Outputs:
    """A run and a page that slamsim writes in a folder. texts: what each holds, while it does."""

    def __init__(self, folder: Path) -> None:
        self.run, self.page = folder / RUN, folder / PAGE
        self.texts: dict[str, str] = {}
        self.count = 0

    def write(self, overwrite: bool, then: Callable[[], object] = lambda: None) -> None:
        """Both; ``then`` is called when all is staged and nothing has its name yet."""
        self.count += 1
        text = f"version {self.count}"
        with (
            partial_folder(self.run, overwrite) as run,
            partial_file(self.page, overwrite) as page,
        ):
            (run / "log").mkdir()
            (run / "log" / "data").write_text(text)
            page.write_text(text)
            then()
        self.texts = {RUN: text, PAGE: text}

    def overwrite(self) -> None:
        self.write(overwrite=True)

    def refuse(self) -> None:
        if self.texts:
            with pytest.raises(SlamsimError, match="is there already"):
                self.write(overwrite=False)

    def break_off(self) -> None:
        def stop() -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            self.write(overwrite=True, then=stop)

    def be_killed(self) -> None:
        killed(lambda: self.write(overwrite=True, then=die))

    def be_killed_between_two_renames(self) -> None:
        """As on a file system that cannot exchange two names."""
        rename = Path.rename

        def last(self: Path, target: Path) -> Path:
            if self.name == staging.NEW:
                die()
            return rename(self, target)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(staging, "exchange", lambda one, other: False)
            patch.setattr(Path, "rename", last)
            killed(self.overwrite)
        if self.texts:  # the page has its name already, the run is where the next writer finds it
            left = staging_of(self.run)
            assert left is not None and (left / "old/log/data").read_text() == self.texts[RUN]
            self.texts[PAGE] = f"version {self.count + 1}"
            with pytest.raises(SlamsimError, match="is there already"), partial_folder(self.run):
                pass

    def meet_a_second(self) -> None:
        with (
            claimed_folder(self.run, overwrite=True),
            locked(self.page, partial(staging.restore, self.page)),
            pytest.raises(Locked, match=f"process {os.getpid()} on"),
        ):
            Outputs.write(self, overwrite=True)

    def keep_a_note(self) -> None:
        """It is the user's, and so is a link: neither goes with the run that it lies in."""
        if not self.texts:
            return
        for make in (_file, _folder, lambda path: path.symlink_to("..")):
            make(note := self.run / "notes")
            before = snapshot(self.run)
            with pytest.raises(SlamsimError, match=r"'notes.*which its SHA256SUMS does not list"):
                self.write(overwrite=True)
            assert snapshot(self.run) == before
            note.rename(taken := self.run.parent / "taken out")
            staging._remove(taken)

    def check(self) -> None:
        if self.texts:
            assert (self.run / "log/data").read_text() == self.texts[RUN]
            assert self.page.read_text() == self.texts[PAGE]
        else:
            assert not os.path.lexists(self.run)


STEPS = tuple(
    (name, step)
    for name, step in vars(Outputs).items()
    if not name.startswith("_") and name not in ("write", "check")
)


@pytest.mark.long
@pytest.mark.parametrize("unnamed", [True, False], ids=["Linux", "elsewhere"])
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    around=st.dictionaries(st.sampled_from(AROUND), st.sampled_from(sorted(KINDS)), max_size=8),
    steps=st.lists(st.sampled_from(STEPS), min_size=1, max_size=6),
)
def test_what_is_around_an_output_is_never_touched(
    unnamed: bool, around: dict[str, str], steps: list[tuple[str, Callable[[Outputs], None]]]
) -> None:
    """Also where a lock file cannot be made without a name at first."""
    with TemporaryDirectory(dir=quick_folder()) as place, pytest.MonkeyPatch.context() as patch:
        if not unnamed:
            patch.setattr(lock, "_UNNAMED", 0)
        folder = Path(place) / "work"
        folder.mkdir()
        for name, kind in around.items():
            KINDS[kind](folder / name)
        before = snapshot(Path(place))
        outputs = Outputs(folder)
        for _, step in steps:
            step(outputs)
            outputs.check()
            now = snapshot(Path(place))
            assert {name: now.get(name) for name in before} == before
        outputs.overwrite()
        outputs.check()
        assert names(folder) == {*around, RUN, PAGE}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("final", FINALS)
def test_a_foreign_file_under_the_name_of_the_lock_is_refused(
    kind: str, final: str, tmp_path: Path
) -> None:
    KINDS[kind](lock_of(tmp_path / final))
    before = snapshot(tmp_path)
    for write in (partial_folder, partial_file):
        with (
            pytest.raises(SlamsimError, match="slamsim did not write it; move it away") as caught,
            write(tmp_path / final, overwrite=True),
        ):
            pass
        assert "\n" not in str(caught.value)
    assert snapshot(tmp_path) == before


def test_what_a_kill_leaves_beside_a_finished_run_goes_with_the_next_default_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = tmp_path.resolve() / "outputs" / RUN

    def finish() -> None:
        with partial_folder(run) as new:
            (new / "log").mkdir()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slamsim.guard.output.remove_staging", die)
        killed(finish)
    assert (run / "log").is_dir() and staging_of(run) is not None
    with output_folder(None, RUN, overwrite=False) as folder:
        assert folder == Path("outputs") / f"{RUN}_2"
        assert not lock_of(run).exists()
    assert names(tmp_path / "outputs") == {RUN}


def test_what_a_kill_leaves_unfinished_stays_for_recover(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outputs = Outputs(tmp_path / "outputs")
    outputs.overwrite()
    outputs.be_killed()
    staging = staging_of(outputs.run.resolve())
    with output_folder(None, RUN, overwrite=False):
        pass
    assert staging is not None and (staging / "new" / "log" / "data").is_file()


def test_a_lock_of_ours_that_was_altered_is_not_ours(tmp_path: Path) -> None:
    """Nor does it make us remove what it names."""
    words = json.loads(owner_words("lock", RUN, tmp_path / f".run.slamsim-{'0' * 16}"))
    (tmp_path / "thesis").mkdir()
    for change in (
        {"staging": "thesis"},
        {"staging": f"../.run.slamsim-{'0' * 16}"},
        {"staging": ".run.slamsim-0"},
        {"staging": 7},
        {"slamsim": "lock of other"},
    ):
        lock_of(tmp_path / RUN).write_text(json.dumps({**words, **change}))
        before = snapshot(tmp_path)
        with (
            pytest.raises(SlamsimError, match="slamsim did not write it"),
            partial_folder(tmp_path / RUN),
        ):
            pass
        assert snapshot(tmp_path) == before


def test_a_refusal_touches_not_even_the_folder_it_is_in(tmp_path: Path) -> None:
    with partial_folder(tmp_path / RUN):
        pass
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis").touch()
    _file(tmp_path / PAGE)
    (tmp_path / "link").symlink_to(RUN)
    before, changed_ns = snapshot(tmp_path), tmp_path.stat().st_mtime_ns
    for final in (RUN, "mine", PAGE, "link"):
        with pytest.raises(SlamsimError), partial_folder(tmp_path / final):
            pass
    for final, overwrite in ((PAGE, False), (RUN, True), ("link", True), ("run/SHA256SUMS", True)):
        with pytest.raises(SlamsimError), partial_file(tmp_path / final, overwrite):
            pass
    assert (snapshot(tmp_path), tmp_path.stat().st_mtime_ns) == (before, changed_ns)


def test_what_takes_the_name_during_the_work_stays(tmp_path: Path) -> None:
    with pytest.raises(SlamsimError, match="did not write"), partial_folder(tmp_path / RUN):
        _folder(tmp_path / RUN / "mine")
    with (
        pytest.raises(SlamsimError, match="is there already"),
        partial_file(tmp_path / PAGE) as new,
    ):
        new.write_text("new")
        _file(tmp_path / PAGE)
    assert (tmp_path / PAGE).read_text() == "mine"
    assert (tmp_path / RUN / "mine" / "thesis.tex").is_file()
    assert names(tmp_path) == {PAGE, RUN}


@pytest.mark.parametrize("harm", ["removed", "damaged"])
def test_a_run_whose_seal_is_lost_is_not_replaced(harm: str, tmp_path: Path) -> None:
    with partial_folder(tmp_path / RUN) as run:
        _file(run / "data")
    sums = tmp_path / RUN / "SHA256SUMS"
    if harm == "removed":
        sums.unlink()
    else:
        sums.write_bytes(sums.read_bytes()[:-3])
    before = snapshot(tmp_path)
    with (
        pytest.raises(SlamsimError, match="nothing tells what in it is yours"),
        partial_folder(tmp_path / RUN, overwrite=True),
    ):
        pass
    assert snapshot(tmp_path) == before


def test_a_lock_that_somebody_put_another_file_in_place_of_is_left_alone(tmp_path: Path) -> None:
    path = lock_of(tmp_path / RUN)
    with partial_folder(tmp_path / RUN):
        path.unlink()
        _file(path)
    assert path.read_text() == "mine"
    assert names(tmp_path) == {path.name, RUN}
