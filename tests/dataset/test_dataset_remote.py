"""Data sets behind a URL: a server that speaks S3, over HTTP."""

from __future__ import annotations

import importlib.util
import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from dataset_remote_life import downloaded, live_through
from dataset_run import end, make, start, tree
from dataset_whole import KeptEngine
from waiting import wait_for

from slamsim.dataset.make.engines.local import LocalEngine, WorkEngine
from slamsim.dataset.make.shard import shard_path
from slamsim.dataset.store.remote import LOCK, RemoteStore
from slamsim.guard.errors import Locked, SlamsimError

moto_server = pytest.importorskip("moto.server")
pytest.importorskip("s3fs")
COUNT = 6


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    settings = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
        "NO_PROXY": "127.0.0.1",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in settings.items():
            patch.setenv(name, value)
        yield "s3://bucket"
    server.stop()


@pytest.fixture(scope="module")
def worker(bucket: str) -> Iterator[WorkEngine]:
    """One that knows the server."""
    with LocalEngine(1) as engine:
        yield KeptEngine(engine)


@pytest.mark.long
def test_what_is_uploaded_is_what_a_folder_would_hold(
    bucket: str, worker: WorkEngine, orders: Path, tmp_path: Path
) -> None:
    address = f"{bucket}/a/set"
    make(tmp_path / "set", orders, COUNT, worker)
    (orders / "2").write_text("refuse")
    summary = make(address, orders, COUNT, worker)
    assert (summary.made, summary.failures) == (COUNT, ())
    assert downloaded(address, tmp_path / "down") == tree(tmp_path / "set")


def test_what_was_cut_on_the_way_counts_for_nothing(
    bucket: str, worker: WorkEngine, orders: Path, tmp_path: Path
) -> None:
    address = f"{bucket}/cut"
    store = RemoteStore(address)
    make(address, orders, COUNT, worker)
    whole = downloaded(address, tmp_path / "before")
    for name in ("dataset.yaml", shard_path(0), "val/000001/sequence.json"):
        store.write(name, whole[name][:-20])
    store._files.rm_file(store._at("test/000002/sequence.json"))
    store.write("val/000001/log/data.bin", b"half")
    make(address, orders, COUNT, worker)
    assert downloaded(address, tmp_path / "after") == whole


@pytest.mark.slow
def test_a_killed_run_is_gone_on_with(
    bucket: str, worker: WorkEngine, orders: Path, tmp_path: Path
) -> None:
    address = f"{bucket}/killed"
    store = RemoteStore(address)
    with start(address, orders, COUNT, 1, 0.2) as process:
        wait_for(lambda: store.names("train"))
        end(process.pid, signal.SIGKILL)
    assert make(address, orders, COUNT, worker).failures == ()
    make(tmp_path / "set", orders, COUNT, worker)
    assert downloaded(address, tmp_path / "down") == tree(tmp_path / "set")


@pytest.mark.long
def test_a_data_set_there_is_made_read_verified_and_repaired(
    bucket: str, worker: WorkEngine, tmp_path: Path
) -> None:
    live_through(f"{bucket}/lived", worker, tmp_path)


def test_the_lock_of_a_run_elsewhere_holds_until_it_is_forgotten(
    bucket: str, worker: WorkEngine, orders: Path
) -> None:
    store = RemoteStore(f"{bucket}/locked")
    owner = {"slamsim": "lock of a data set", "owner": "process 1 on elsewhere"}
    lock = {**owner, "key": "x", "renewed_s": time.time()}
    store.write(LOCK, json.dumps(lock).encode())
    with pytest.raises(Locked, match="is being written by process 1 on elsewhere"):
        make(store.address, orders, 1, worker)
    store.write(LOCK, json.dumps({**lock, "renewed_s": time.time() - 1000.0}).encode())
    assert make(store.address, orders, 1, worker).made == 1
    assert store.read(LOCK) is None
    store.write(LOCK, b'{"mine": 1}')
    with pytest.raises(SlamsimError, match="slamsim did not write it"):
        make(store.address, orders, 1, worker)
    assert store.read(LOCK) == b'{"mine": 1}'


@pytest.mark.long
def test_a_place_that_cannot_be_is_refused(
    bucket: str, orders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamsim.dataset.store.remote._PAUSES_S", ())
    has_sftp = importlib.util.find_spec("paramiko") is not None
    for address, says in (
        ("nonsense://x/y", "nonsense"),
        (f"{bucket}/../other", r"has '\.\.' in it"),
        ("sftp://127.0.0.1:1/tmp/x", "cannot be reached or written" if has_sftp else "paramiko"),
    ):
        with pytest.raises(SlamsimError, match=says):
            make(address, orders, 1)
