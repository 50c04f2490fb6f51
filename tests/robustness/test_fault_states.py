"""A run's folder and a data set's through any sequence of good and bad days, beside a simple model.

The model is what lies there, file by file. Whatever is made, killed, starved, damaged, deleted,
verified or repaired: what stands under the final name is the old or the new in whole, what
``slamsim verify`` finds whole is byte for byte as it was made, and the next run needs no hand work.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp, mkstemp
from typing import ClassVar

import log_data
import pytest
from fault_disk import Outcome, require_watching, watched
from fault_nth import FAULTS, quick_folder, vouched
from fault_stages import contents, dataset_of
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.make.identity import IDENTITY
from slamsim.dataset.store.store import open_store
from slamsim.guard.errors import InputRefused, Locked, SlamsimError
from slamsim.guard.lock import locked
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.guard.seal import SUMS
from slamsim.guard.staging import restore
from slamsim.io.open import read_recording
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording
from slamsim.run.dataset.telling import repair_plan
from slamsim.run.verifying import verify_path
from slamsim.simulation.log_writer import LogWriter

pytestmark = pytest.mark.fault
MARK, LOG = ".slamsim", "log"
WHERE = st.integers(0, 10**6)
WHEN = st.integers(0, 60)
Files = dict[str, bytes]


def write_run(version: int, overwrite: bool, out: Path) -> None:
    """A log of so many tenths of a second, and a file beside it."""
    with partial_folder(out, overwrite) as folder:
        with LogWriter(folder / LOG, log_data.header()) as log:
            end_s = 0.1 * version
            log.write(log_data.readings(0.0, end_s, beams=8), log_data.drive(0.0, end_s))
        write_atomic(folder / "report.json", b"%d" % version)


@cache
def run_of(version: int) -> Files:
    place = Path(mkdtemp(dir=quick_folder()))
    try:
        write_run(version, False, place / "run")
        return contents(place / "run")
    finally:
        shutil.rmtree(place)


@cache
def messages_of(version: int) -> int:
    place = Path(mkdtemp(dir=quick_folder()))
    try:
        write_run(version, False, place / "run")
        with partial_folder(place / "new") as folder:
            return recover(damaged_recording(place / "run" / LOG), folder).messages
    finally:
        shutil.rmtree(place)


@cache
def dataset_files(count: int) -> Files:
    place = Path(mkdtemp(dir=quick_folder()))
    try:
        dataset_of(count, place / "set")
        return contents(place / "set")
    finally:
        shutil.rmtree(place)


class Folder(RuleBasedStateMachine):
    """What can happen to a folder of either kind."""

    name: ClassVar[str]

    def __init__(self) -> None:
        super().__init__()
        self.place = Path(mkdtemp(dir=quick_folder()))
        self.out = self.place / self.name
        self.left: Files = {}
        self.harmed = self.was_whole = False

    def is_whole(self) -> bool:
        raise NotImplementedError

    def note_harm(self) -> None:
        """Before the first: was everything there?"""
        if not self.harmed:
            self.harmed, self.was_whole = True, self.is_whole()

    def teardown(self) -> None:
        shutil.rmtree(self.place)

    def struck(self, work: Callable[[Path], object], fault: str, number: int) -> Outcome:
        return watched(partial(work, self.out), self.place, partial(FAULTS[fault], number))

    def any_file(self, where: int) -> str:
        return sorted(self.left)[where % len(self.left)]

    @precondition(lambda self: self.left)
    @rule(where=WHERE, at=WHERE, change=st.integers(1, 255))
    def damage(self, where: int, at: int, change: int) -> None:
        """One byte of one file; the file's times change, as they would."""
        name = self.any_file(where)
        if not (data := bytearray(self.left[name])):
            return
        data[at % len(data)] ^= change
        rewritten(self.out / name, bytes(data))
        self.note_harm()
        self.left[name] = bytes(data)

    @precondition(lambda self: len(self.left) > 1)
    @rule(where=WHERE)
    def delete(self, where: int) -> None:
        name = self.any_file(where)
        (self.out / name).unlink()
        self.note_harm()
        del self.left[name]

    @invariant()
    def is_as_the_model_says(self) -> None:
        assert contents(self.out) == self.left


def rewritten(path: Path, data: bytes) -> None:
    descriptor, beside = mkstemp(dir=path.parent)
    os.write(descriptor, data)
    os.close(descriptor)
    Path(beside).replace(path)


class Run(Folder):
    """``partial_folder``, ``slamsim verify`` and ``slamsim recover``."""

    name = "run"

    def __init__(self) -> None:
        super().__init__()
        self.version = 0

    def is_whole(self) -> bool:
        return self.version > 0 and self.left == run_of(self.version)

    def is_free(self, overwrite: bool) -> bool:
        """What replaces it must be told that nothing in it is somebody else's."""
        sealed = self.left.get(SUMS) == run_of(self.version or 1)[SUMS]
        return not self.left or (overwrite and MARK in self.left and sealed)

    @rule(version=st.integers(1, 3), overwrite=st.booleans())
    def make(self, version: int, overwrite: bool) -> None:
        if not self.is_free(overwrite):
            with pytest.raises(SlamsimError, match=r"there already|did not write|not replaced"):
                write_run(version, overwrite, self.out)
            return
        write_run(version, overwrite, self.out)
        self.left, self.version = dict(run_of(version)), version
        assert [path.name for path in self.place.iterdir()] == [self.name]

    @rule(
        version=st.integers(1, 3),
        overwrite=st.booleans(),
        fault=st.sampled_from(sorted(FAULTS)),
        number=WHEN,
    )
    def fail(self, version: int, overwrite: bool, fault: str, number: int) -> None:
        outcome = self.struck(partial(write_run, version, overwrite), fault, number)
        found = contents(self.out)
        if outcome.code == 0 or found != self.left:
            assert self.is_free(overwrite) and found == run_of(version)
        if found != self.left:
            self.left, self.version = found, version

    @rule(version=st.integers(1, 3))
    def second_writer(self, version: int) -> None:
        with (
            locked(self.out, partial(restore, self.out)),
            pytest.raises(Locked if self.is_free(True) else SlamsimError),
        ):
            write_run(version, True, self.out)

    @rule()
    def verify(self) -> None:
        if self.left:
            assert vouched(self.out) == self.is_whole()

    @precondition(lambda self: SUMS in self.left)
    @rule()
    def read(self) -> None:
        whole = run_of(self.version)
        names = {name for name in whole if name.startswith(f"{LOG}/")}
        sound = self.left[SUMS] == whole[SUMS]
        sound &= all(self.left.get(name) == whole[name] for name in names)
        if not sound:
            with pytest.raises(SlamsimError):
                list(read_recording(self.out / LOG).scans)
        else:
            assert read_recording(self.out / LOG).scans

    @rule()
    def recover(self) -> None:
        """What is whole comes back, and what it came from is left as it is."""
        try:
            source = damaged_recording(self.out)
        except SlamsimError:
            assert not any(name.endswith(".mcap") for name in self.left)
            return
        new = self.place / "recovered"
        try:
            with partial_folder(new) as folder:
                found = recover(source, folder)
            assert verify_path(new).whole
            whole = run_of(self.version) if self.version else {}
            mcap = next(name for name in run_of(1) if name.endswith(".mcap"))
            if self.left and self.left.get(mcap) == whole.get(mcap):
                assert found.messages == messages_of(self.version)
        except InputRefused:
            assert self.left == {} or self.left != run_of(self.version)
        shutil.rmtree(new, ignore_errors=True)


class DataSet(Folder):
    """``dataset make`` and ``dataset verify``, which says how damage is repaired."""

    name = "set"

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def is_whole(self) -> bool:
        return self.count > 0 and self.left == dataset_files(self.count)

    def look(self, count: int) -> None:
        """Take over what came of an attempt: of each file the old, or the one it is to be."""
        self.was_whole = False
        found, whole = contents(self.out), dataset_files(count)
        for name, data in found.items():
            assert data in (self.left.get(name), whole[name])
        if found.get(IDENTITY) == whole[IDENTITY]:
            self.count = count
        self.left = found

    @rule(count=st.integers(1, 3))
    def make(self, count: int) -> None:
        try:
            dataset_of(count, self.out)
        except SlamsimError:
            assert self.harmed or count < self.count
            self.look(max(count, self.count))
            return
        self.look(count)
        if not self.harmed:
            assert self.left == dataset_files(count)
            assert [path.name for path in self.place.iterdir()] == [self.name]

    @rule(count=st.integers(1, 3), fault=st.sampled_from(sorted(FAULTS)), number=WHEN)
    def fail(self, count: int, fault: str, number: int) -> None:
        outcome = self.struck(partial(dataset_of, count), fault, number)
        self.look(max(count, self.count))
        if outcome.code == 0 and not self.harmed:
            assert self.left == dataset_files(count)

    @rule()
    def second_writer(self) -> None:
        expected = SlamsimError if self.harmed else Locked
        with open_store(str(self.out)).owned(), pytest.raises(expected):
            dataset_of(3, self.out)

    @rule()
    def verify(self) -> None:
        assert vouched(self.out) == self.is_whole()

    @precondition(lambda self: self.left.keys() & {IDENTITY, SUMS})
    @rule()
    def repair(self) -> None:
        """What verify says is to be removed, and the same command again.

        It helps unless dataset.yaml is lost before anything vouches for it.
        """
        for path in repair_plan(verify(str(self.out))).remove:
            target = self.out / path
            (shutil.rmtree if target.is_dir() else os.unlink)(target)
        self.left = contents(self.out)
        try:
            dataset_of(self.count, self.out)
        except SlamsimError:
            assert self.harmed and not self.was_whole
            return
        assert contents(self.out) == dataset_files(self.count)
        self.left, self.harmed = dict(dataset_files(self.count)), False


SETTINGS = settings(
    max_examples=5,
    stateful_step_count=14,
    derandomize=True,
    report_multiple_bugs=False,
    phases=(Phase.explicit, Phase.generate),
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
MACHINES = {"a run": Run, "a data set": DataSet}


@pytest.mark.long
@pytest.mark.parametrize("kind", MACHINES)
def test_any_sequence_of_days(kind: str) -> None:
    require_watching()
    run_state_machine_as_test(MACHINES[kind], settings=SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MACHINES)
def test_many_sequences_of_days(kind: str) -> None:
    require_watching()
    run_state_machine_as_test(
        MACHINES[kind], settings=settings(SETTINGS, max_examples=300, stateful_step_count=30)
    )
