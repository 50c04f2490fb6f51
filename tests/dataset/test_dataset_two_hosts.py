"""A cluster of two hosts, each a network of its own, one of which is lost while it works."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import yaml
from dataset_run import end, tree, workers_of

from slamsim.dataset.make.engines.local import LocalEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.process.instructions import _SAME, has_avx2

pytest.importorskip("distributed")
COUNT = 12
BRIDGE, NET, HOSTS = "slamsim0", "10.213.77", ("slamsim1", "slamsim2")
CLUSTERS = Path(__file__).parents[2] / "docs" / "clusters.md"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.geteuid() != 0, reason="only root may make networks"),
    pytest.mark.skipif(shutil.which("ip") is None, reason="iproute2 is not installed"),
]


def _run(line: str) -> None:
    subprocess.run(line.split(), check=True, capture_output=True)


@contextmanager
def _network() -> Iterator[None]:
    """A bridge here, .1, and on it two hosts, .2 and .3."""
    with ExitStack() as undo:
        try:
            _run(f"ip link add {BRIDGE} type bridge")
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no network can be made here: {error.stderr.decode().strip()}")
        undo.callback(_run, f"ip link del {BRIDGE}")
        _run(f"ip addr add {NET}.1/24 dev {BRIDGE}")
        _run(f"ip link set {BRIDGE} up")
        for number, host in enumerate(HOSTS, start=2):
            _run(f"ip netns add {host}")
            undo.callback(_run, f"ip netns del {host}")
            _run(f"ip link add {host} type veth peer name eth0 netns {host}")
            _run(f"ip link set {host} master {BRIDGE} up")
            _run(f"ip -n {host} addr add {NET}.{number}/24 dev eth0")
            _run(f"ip -n {host} link set eth0 up")
            _run(f"ip -n {host} link set lo up")
        yield


@contextmanager
def _started(words: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        end(process.pid, signal.SIGKILL)
        process.wait()


def _settings(folder: Path) -> dict[str, str]:
    """The environment of scheduler and workers, with Dask set as the documentation says."""
    block = CLUSTERS.read_text().partition("```yaml\n")[2].partition("```")[0]
    assert yaml.safe_load(block)["distributed"]["worker"]["profile"] == {"enabled": False}
    (folder / "slamsim.yaml").write_text(block)
    return {**os.environ, "DASK_CONFIG": str(folder)}


@contextmanager
def _cluster(folder: Path) -> Iterator[str]:
    """The address of a scheduler here, with a worker in each host."""
    environment = _settings(folder)
    dask = [sys.executable, "-m", "dask"]
    address = f"tcp://{NET}.1:8786"
    with ExitStack() as running:
        running.enter_context(_network())
        options = ["scheduler", "--host", f"{NET}.1", "--port", "8786", "--no-dashboard"]
        running.enter_context(_started([*dask, *options], environment))
        for host in HOSTS:
            running.callback(_lose, host)
            alone = ["unshare", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc"]
            named = ["sh", "-c", f'hostname {host}; exec "$@"', "sh"]
            worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard"]
            inside = ["ip", "netns", "exec", host, *alone, *named, *worker]
            running.enter_context(_started(inside, environment))
        _await_workers(address)
        yield address


def _await_workers(address: str) -> None:
    from distributed import Client

    end_s = time.monotonic() + 60.0
    while True:
        try:
            with Client(address, timeout=2.0, set_as_default=False) as client:  # type: ignore[no-untyped-call]
                client.wait_for_workers(len(HOSTS), timeout=60.0)
                return
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.5)


def _processes(host: str) -> list[int]:
    found = subprocess.run(["ip", "netns", "pids", host], capture_output=True, check=True)
    return [int(process) for process in found.stdout.split()]


def _lose(host: str) -> None:
    """Unplugged first: nobody is told that its connections end."""
    _run(f"ip link set {host} down")
    for process in _processes(host):
        end(process, signal.SIGKILL)


def _makers(host: str) -> list[dict[str, str]]:
    """The environments of the processes that make sequences: children of a Dask worker's."""
    spawned = [child for process in _processes(host) for child in workers_of(process)]
    makers = [child for process in spawned for child in workers_of(process)]
    told = [Path(f"/proc/{process}/environ").read_text().split("\0") for process in makers]
    return [dict(line.split("=", 1) for line in lines if "=" in line) for lines in told]


def test_a_host_lost_in_the_middle_costs_nothing_and_changes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "set"
    command = [sys.executable, "-c", "from slamsim.entry import main; main()"]
    options = f"dataset make tiny -n {COUNT} --quiet --out {out} --engine dask --scheduler".split()
    with _cluster(tmp_path) as address:
        making = subprocess.Popen([*command, *options, address], stderr=subprocess.PIPE, text=True)
        while making.poll() is None and not _works_amid_it_all(out, HOSTS[0]):
            time.sleep(0.02)
        lost = _makers(HOSTS[0])
        _lose(HOSTS[0])
        made_by_then = len(list(out.glob("t*/*/sequence.json")))
        _, told = making.communicate()
    assert (making.returncode, told) == (0, "")
    assert lost and 0 < made_by_then < COUNT
    if has_avx2():
        assert all(maker.items() >= _SAME.items() for maker in lost)
    make_dataset(load_recipe("tiny"), COUNT, str(tmp_path / "here"), LocalEngine(2))
    assert tree(out) == tree(tmp_path / "here")
    assert not list(out.parent.glob(".*")) and not list(out.glob(".slamsim-*"))


def _works_amid_it_all(out: Path, host: str) -> bool:
    """Whether some sequences are there, and the host is at another."""
    if len(list(out.glob("t*/*/sequence.json"))) < 3:
        return False
    return bool(list(out.glob(f".slamsim-*/*.{host}-*/log")))
