"""Attempts of data sets to reach outside their folder, reading or writing."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import pyarrow.parquet as pq
from fault_path_recordings import tables
from fault_paths import Action, Reference, Scene, attempt, ways

from slamsim.dataset.catalogue.statistics import MANIFEST, manifest
from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.make.identity import IDENTITY, Identity
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.recipe.sequence import Cell
from slamsim.dataset.store.lazy_table import rows_to_parquet, table_from_parquet, table_to_parquet
from slamsim.dataset.store.reader import open_dataset
from slamsim.dataset.store.store import LocalStore
from slamsim.guard.errors import SlamsimError
from slamsim.guard.lock import lock_of, owner_words
from slamsim.guard.seal import SEQUENCE, SUMS, sequence_text, sums_text

NAME = "train/000000"


def _dataset(folder: Path, name: str) -> None:
    """A data set of one sequence of that name, as far as its catalogue tells."""
    row: dict[str, Cell] = {
        "index": 0,
        "name": name,
        "split": "train",
        "world_index": 0,
        "seed": 0,
        "status": MADE,
        "faults": "",
        "sha256": hashlib.sha256(_mark("log/data.bin")).hexdigest(),
        "reason": None,
        "command": None,
        "files": 1,
        "size_bytes": 6,
    }
    table = manifest([table_from_parquet(rows_to_parquet([row]))], {"slamsim": "0"})
    (folder / MANIFEST).write_bytes(table_to_parquet(table))
    (folder / IDENTITY).write_text(Identity("d", 1, {}).text())
    files = {path: _sha256(folder / path) for path in (MANIFEST, IDENTITY)}
    (folder / SUMS).write_text(sums_text(files))


def _mark(path: str) -> bytes:
    facts = {"path": path, "size_bytes": 6, "sha256": hashlib.sha256(b"secret").hexdigest()}
    return sequence_text({"index": 0, "name": NAME, "files": [facts]}).encode()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _sequence(folder: Path, path: str = "log/data.bin") -> None:
    (folder / "log").mkdir(parents=True)
    (folder / "log" / "data.bin").write_bytes(b"secret")
    (folder / SEQUENCE).write_bytes(_mark(path))
    tables(folder / "parquet")
    (folder / "config.yaml").write_text("{}\n")


def _read(folder: Path) -> None:
    """All that is ever read of its one sequence."""
    with suppress(SlamsimError):
        verify(str(folder))
    sequence = open_dataset(folder)[0]
    for read in (lambda: sequence.scans, lambda: sequence.config, lambda: sequence.log):
        try:
            read()
        except SlamsimError:
            continue


@ways("the name of a sequence in a manifest", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    _sequence(scene.outside / "seq")
    _dataset(scene.inputs, way(scene, "seq"))
    return lambda: _read(scene.inputs)


@attempt("a split of a data set is a link")
def _(scene: Scene) -> Action:
    _sequence(scene.outside / NAME)
    (scene.inputs / "train").symlink_to(scene.outside / "train", target_is_directory=True)
    _dataset(scene.inputs, NAME)
    return lambda: _read(scene.inputs)


@ways("a file of a sequence in its sequence.json", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "secret").write_bytes(b"secret")
    name = way(scene, "secret").replace("../outside", "../../../outside")
    _sequence(scene.inputs / NAME, name)
    for link in scene.inputs.glob("link-*"):
        link.rename(scene.inputs / NAME / link.name)
    _dataset(scene.inputs, NAME)
    told = json.loads((scene.inputs / NAME / SEQUENCE).read_text())
    row = pq.read_table(scene.inputs / MANIFEST).to_pylist()[0]
    row["sha256"] = _sha256(scene.inputs / NAME / SEQUENCE)
    assert told["files"][0]["path"] == name
    table = manifest([table_from_parquet(rows_to_parquet([row]))], {})
    (scene.inputs / MANIFEST).write_bytes(table_to_parquet(table))
    (scene.inputs / SUMS).unlink()
    return lambda: verify(str(scene.inputs))


@ways("a line of SHA256SUMS", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "secret").write_bytes(b"secret")
    _dataset(scene.inputs, NAME)
    sums = {way(scene, "secret"): hashlib.sha256(b"secret").hexdigest()}
    (scene.inputs / SUMS).write_text(sums_text(sums))
    return lambda: verify(str(scene.inputs))


@attempt("the manifest of a data set is a link")
def _(scene: Scene) -> Action:
    _dataset(scene.outside, NAME)
    (scene.inputs / MANIFEST).symlink_to(scene.outside / MANIFEST)
    return lambda: len(open_dataset(scene.inputs))


@attempt("a data set to go on with, whose split is a link")
def _(scene: Scene) -> Action:
    (scene.outside / "precious").mkdir()
    (scene.out / "train").symlink_to(scene.outside, target_is_directory=True)
    store = LocalStore(str(scene.out))

    def act() -> None:
        with store.owned(), store.used(), store.working_folder("train/precious") as folder:
            (folder / SEQUENCE).write_text("{}")
            store.publish(folder, "train/precious")

    return act


@attempt("a data set to go on with, whose place of work is a link")
def _(scene: Scene) -> Action:
    staging = scene.out / f".slamsim-{'0' * 16}"
    lock_of(scene.out).write_bytes(owner_words("lock", scene.out.name, staging))
    staging.symlink_to(scene.outside, target_is_directory=True)
    store = LocalStore(str(scene.out))

    def act() -> None:
        with store.owned(), store.used(), store.working_folder(NAME) as folder:
            (folder / SEQUENCE).write_text("{}")
            store.publish(folder, NAME)

    return act


@attempt("a data set to go on with, whose log is a link")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (scene.out / "logs").mkdir()
    (scene.out / "logs" / "production.jsonl").symlink_to(scene.outside / "notes")
    return lambda: LocalStore(str(scene.out)).append("logs/production.jsonl", "line\n")
