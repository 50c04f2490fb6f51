"""Data sets of stub sequences: workers that die, places that are taken, runs that are killed."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from dataset_run import SHARD, end, make, runs, start, tree, workers_of
from killed import die, killed
from waiting import wait_for

from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.identity import Identity, read_identity
from slamsim.dataset.make.shard import Unwatched, shard_path
from slamsim.dataset.store.lazy_table import rows_from_parquet
from slamsim.dataset.store.store import LocalStore, open_store
from slamsim.guard.errors import DiskFull, Locked, SlamsimError

COUNT = 14


class Notes(Unwatched):
    """Remembers which sequences did not succeed at once."""

    def __init__(self) -> None:
        self.reasons: dict[int, list[str]] = {}

    def tried(self, index: int, reason: str, tries: int) -> None:
        self.reasons.setdefault(index, []).append(reason)


@pytest.fixture(scope="module")
def undisturbed(
    tmp_path_factory: pytest.TempPathFactory, one_worker: WorkEngine
) -> dict[str, bytes]:
    """What every run of ``COUNT`` sequences must leave, whatever happened to it."""
    folder = tmp_path_factory.mktemp("undisturbed")
    summary = make(folder / "set", folder, COUNT, one_worker)
    assert (summary.made, summary.already, summary.failures) == (COUNT, 0, ())
    assert summary.simulated_s == COUNT * 60.0
    return tree(folder / "set")


def test_a_data_set_has_its_identity_its_sequences_and_its_rows(
    undisturbed: dict[str, bytes],
) -> None:
    assert len([name for name in undisturbed if name.endswith("sequence.json")]) == COUNT
    rows = [
        row
        for shard in range(-(-COUNT // SHARD))
        for row in rows_from_parquet(undisturbed[shard_path(shard)])
    ]
    assert [row["index"] for row in rows] == list(range(COUNT))
    assert {row["status"] for row in rows} == {"made"}
    assert rows[3]["drawn.size"] == 1.5 and rows[3]["name"] == "train/000003"
    assert not [name for name in undisturbed if "slamsim" in name or "lock" in name]


def test_workers_that_die_cost_nothing_but_a_retry(
    orders: Path, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    misdeeds = {1: "break", 2: "crash", 4: "kill kill", 6: "eat", 7: "hang", 9: "leave"}
    for index, words in misdeeds.items():
        (orders / str(index)).write_text(words)
    notes = Notes()
    summary = make(tmp_path / "set", orders, COUNT, limit_s=2.0, watch=notes)
    assert summary.failures == () and summary.made == COUNT
    assert tree(tmp_path / "set") == undisturbed
    assert notes.reasons == {
        1: ["KeyError: 'told to'"],
        2: ["its process was ended by SIGSEGV"],
        4: ["its process was ended by SIGKILL"] * 2,
        6: ["out of memory"],
        7: ["it took longer than 2 s"],
        9: ["its process ended"],
    }
    log = (tmp_path / "set" / "logs" / "00000.log").read_text()
    assert "Segmentation fault" in log and "_crash" in log
    log = (tmp_path / "set" / "logs" / "00001.log").read_text()
    assert "out of memory\na worker has 2,000 MB of memory" in log


@pytest.mark.long
def test_a_sequence_that_fails_three_times_is_recorded_and_the_rest_goes_on(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    (orders / "5").write_text("refuse refuse crash")
    (orders / "6").write_text("refuse refuse refuse")
    summary = make(tmp_path / "set", orders, COUNT)
    assert [(failure.index, failure.reason) for failure in summary.failures] == [
        (5, "its process was ended by SIGSEGV"),
        (6, "the robot is stuck"),
    ]
    rows = rows_from_parquet((tmp_path / "set" / shard_path(1)).read_bytes())
    assert [row["status"] for row in rows] == ["made", "failed", "failed", "made"]
    assert rows[1]["command"] == "make --only 5" and rows[1]["seed"] == 5
    assert not (tmp_path / "set" / "test" / "000005").exists()

    again = make(tmp_path / "set", orders, COUNT, one_worker)  # the same command tries them again
    assert (again.already, again.made, again.failures) == (COUNT - 2, 2, ())
    assert tree(tmp_path / "set") == undisturbed


def test_the_reason_of_a_failure_is_the_same_wherever_it_happens(
    orders: Path, one_worker: WorkEngine, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        (orders / "1").write_text("lose lose lose")
        summary = make(tmp_path / name, orders, 2, one_worker)
        lost = "FileNotFoundError: [Errno 2] No such file or directory: 'log/lost'"
        assert [failure.reason for failure in summary.failures] == [lost]
        assert f"{tmp_path / name}/.slamsim-" in (tmp_path / name / "logs/00000.log").read_text()
    assert tree(tmp_path / "a")[shard_path(0)] == tree(tmp_path / "b")[shard_path(0)]


def test_one_sequence_alone(orders: Path, one_worker: WorkEngine, tmp_path: Path) -> None:
    summary = make(tmp_path / "set", orders, COUNT, one_worker, only=[3, 3])
    assert (summary.already, summary.made) == (0, 1)
    assert [path.name for path in (tmp_path / "set").glob("t*/*")] == ["000003"]
    assert not (tmp_path / "set" / "shards").exists()


def test_a_larger_data_set_keeps_what_is_there(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    make(tmp_path / "set", orders, 6, one_worker)
    kept = (tmp_path / "set" / "train" / "000003" / "log" / "data.bin").stat().st_mtime_ns
    summary = make(tmp_path / "set", orders, COUNT, one_worker)
    assert (summary.already, summary.made) == (6, COUNT - 6)
    assert tree(tmp_path / "set") == undisturbed
    assert (tmp_path / "set/train/000003/log/data.bin").stat().st_mtime_ns == kept
    with pytest.raises(SlamsimError, match="it can grow, not shrink"):
        make(tmp_path / "set", orders, 6, one_worker)


def test_what_was_cut_is_made_again(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    folder = tmp_path / "set"
    make(folder, orders, COUNT, one_worker)
    for name in ("dataset.yaml", shard_path(1), "train/000006/sequence.json"):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: len(data) // 2])
    (folder / "val" / "000004" / "sequence.json").unlink()
    (folder / ".partial").mkdir()
    (folder / ".partial" / "mine").write_text("mine")
    assert make(folder, orders, COUNT, one_worker).failures == ()
    assert tree(folder) == {**undisturbed, ".partial/mine": b"mine"}


def test_what_a_user_put_into_a_sequence_is_not_made_away_with(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    folder = tmp_path / "set"
    make(folder, orders, COUNT, one_worker)
    sequence = folder / "train" / "000006"
    (sequence / "notes.txt").write_text("mine")
    (sequence / "sequence.json").unlink()
    (folder / shard_path(1)).unlink()
    (failure,) = make(folder, orders, COUNT, one_worker).failures
    assert failure.index == 6 and "holds 'notes.txt', which is no part of it" in failure.reason
    assert (sequence / "notes.txt").read_text() == "mine"
    (sequence / "notes.txt").unlink()
    assert make(folder, orders, COUNT, one_worker).failures == ()
    assert tree(folder) == undisturbed


def _foreign(folder: Path) -> None:
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")


def _work_of_others(folder: Path) -> None:
    for name in (".partial", "logs"):
        (folder / name).mkdir(parents=True)
        (folder / name / "00000.log").write_text("mine")


def _file(folder: Path) -> None:
    folder.write_text("mine")


def _garbage(folder: Path) -> None:
    folder.mkdir()
    (folder / "dataset.yaml").write_text("kind: something else\n")


@pytest.mark.parametrize(
    ("prepare", "says"),
    [
        (_foreign, "holds files that are no data set, such as 'thesis.tex'"),
        (_work_of_others, "holds files that are no data set, such as '.partial'"),
        (_file, "is a file"),
        (_garbage, "does not begin with"),
    ],
)
def test_a_place_that_holds_something_else_is_refused(
    prepare: Callable[[Path], None], says: str, orders: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "set"
    prepare(folder)
    before = tree(tmp_path)
    with pytest.raises(SlamsimError, match=says):
        make(folder, orders, COUNT)
    assert tree(tmp_path) == before


def test_another_recipe_and_other_software_are_refused(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path / "set", orders, 2, one_worker)
    with pytest.raises(SlamsimError, match=r"another data set \(clutter of its recipe is None"):
        make(tmp_path / "set", orders, 2, one_worker, clutter=0.5)
    text = (tmp_path / "set" / "dataset.yaml").read_text()
    (tmp_path / "set" / "dataset.yaml").write_text(text.replace("pybullet: ", "pybullet: 1."))
    with pytest.raises(SlamsimError, match=r"other software: here is pybullet 3.*instead of 1\.3"):
        make(tmp_path / "set", orders, 2, one_worker)


def test_the_identity_reads_back(tmp_path: Path) -> None:
    identity = Identity("named", 7, {"a": [1, 2.5, "x"], "b": {"c": None, "d": 1e-9}})
    store = open_store(str(tmp_path / "set"))
    store.write("dataset.yaml", identity.text().encode())
    found = read_identity(store)
    assert found is not None
    assert (found["name"], found["sequences"], found["recipe"]) == ("named", 7, identity.recipe)


@pytest.mark.long
def test_a_full_disk_stops_the_run_and_the_same_command_goes_on(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    (orders / "6").write_text("fill")
    with pytest.raises(DiskFull, match="No space left"):
        make(tmp_path / "set", orders, COUNT)
    assert make(tmp_path / "set", orders, COUNT, one_worker).failures == ()
    assert tree(tmp_path / "set") == undisturbed


def test_a_second_run_and_a_worker_that_lives_on_keep_others_out(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamsim.dataset.store.store._ORPHANS_END_S", 0.2)
    store = LocalStore(str(tmp_path / "set"))
    with store.owned(), pytest.raises(Locked, match="is being written by process"):
        make(tmp_path / "set", orders, 2, one_worker)

    def work() -> None:
        with store.owned(), store.used():
            die()

    killed(work)
    (staging,) = (tmp_path / "set").glob(".slamsim-*")
    worker = LocalStore(store.address, staging.name)
    with worker.used(), pytest.raises(Locked, match="workers of an earlier run"):
        make(tmp_path / "set", orders, 2, one_worker)
    assert make(tmp_path / "set", orders, 2, one_worker).made == 2


def _wait_for_sequences(folder: Path, count: int, process: subprocess.Popen[str]) -> None:
    while process.poll() is None and len(list(folder.glob("t*/*/sequence.json"))) < count:
        time.sleep(0.05)


@pytest.mark.long
def test_ctrl_c_ends_it_and_the_same_command_goes_on(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    folder = tmp_path / "set"
    (orders / "5").write_text("hang")
    with start(folder, orders, COUNT, 2, 0.05) as process:
        _wait_for_sequences(folder, 4, process)
        workers = workers_of(process.pid)
        end(process.pid, signal.SIGINT)
        assert process.wait(60) == 130
    assert workers and not any(map(runs, workers))
    assert not list(folder.glob(".slamsim-*"))
    (orders / "5").unlink()
    make(folder, orders, COUNT, one_worker)
    assert tree(folder) == undisturbed


@pytest.mark.long
def test_a_killed_run_leaves_no_worker_and_the_same_command_goes_on(
    orders: Path, one_worker: WorkEngine, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    folder = tmp_path / "set"
    with start(folder, orders, COUNT, 1, 0.1) as process:
        _wait_for_sequences(folder, 3, process)
        workers = workers_of(process.pid)
        process.kill()
    assert workers
    wait_for(lambda: not any(map(runs, workers)))
    make(folder, orders, COUNT, one_worker)
    assert tree(folder) == undisturbed
