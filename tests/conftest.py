"""Random examples have no deadline: compiling, or a busy machine, is no failure. Where CI is set
Hypothesis draws the same examples for the same code, elsewhere new ones in each run. SIGINT and
SIGQUIT are heard in child processes also where the tests run in the background, which has them
ignored. What takes long to make and is only looked at is made once for all files. Modules that are
compiled are kept, as a child process without them spends a second on it. What was imported until
the tests are collected stays, and no collection of garbage need look at it; it is looked for less
often than Python does."""

from __future__ import annotations

import fcntl
import functools
import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import typer.main
import typer.testing
from hypothesis import settings

if TYPE_CHECKING:
    from dataset_whole import KeptEngine

    from slamsim.core.types import FloatArray

settings.register_profile("any machine", settings(), deadline=None)
settings.load_profile("any machine")

# What can be typed is the same for each command that a test types: 22 ms each time.
_command = functools.cache(typer.main.get_command)
for _module, _name in ((typer.main, "get_command"), (typer.testing, "_get_command")):
    setattr(_module, _name, _command)

# Before numpy is loaded, and for child processes: tests run on all cores side by side, and threads
# of BLAS spin where they wait for one another. On two busy cores a fit of a camera's mount and the
# start of its test took 18 s of processor time instead of 7 s.
for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGQUIT) is signal.SIG_IGN:
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)


gc.set_threshold(100_000, 50, 100)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


@pytest.fixture(scope="session")
def one_worker() -> Iterator[KeptEngine]:
    """An engine whose worker has been started, and stays."""
    from dataset_whole import KeptEngine

    from slamsim.dataset.make.engines.local import LocalEngine

    with LocalEngine(1) as engine:
        yield KeptEngine(engine)


@pytest.fixture(scope="module")
def drives_here() -> Iterator[None]:
    """Simulations drive in this process, see ``drive_here.py``."""
    from drive_here import driving_here

    with driving_here():
        yield


@pytest.fixture(scope="module")
def undrawn_figures() -> Iterator[None]:
    """Pages have empty figures: to draw them takes more than half of what a short log's map does.
    Those of ``tests/report`` and of commands in processes of their own are drawn."""
    from matplotlib.figure import Figure

    save = Figure.savefig

    def empty(figure: Figure, file: Any, **options: Any) -> None:
        if options.get("format") == "svg":
            file.write("<svg></svg>")
        else:
            save(figure, file, **options)

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(Figure, "savefig", empty)
        yield


@pytest.fixture
def made_by_one_worker(one_worker: KeptEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Data sets and their pilots are, whatever number of workers is asked for: each would load
    libraries anew."""
    from dataset_whole import LentWorker

    monkeypatch.setattr("slamsim.run.dataset.making._engine", lambda *_: one_worker)
    monkeypatch.setattr("slamsim.dataset.recipe.plan.Worker", lambda *_: LentWorker(one_worker))


@pytest.fixture
def tried_by_one_worker(one_worker: KeptEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of scenarios and cases of campaigns are, for the same reason by that of data sets."""
    for module in ("slamsim.scenarios.run", "slamsim.bench.robustness.campaign"):
        monkeypatch.setattr(f"{module}.Workers", lambda *_: one_worker.workers)


@pytest.fixture
def orders(tmp_path: Path) -> Path:
    """Where orders for ``dataset_stub.Stub`` lie: what sequences do instead of being made."""
    folder = tmp_path / "orders"
    folder.mkdir()
    return folder


@pytest.fixture(scope="session")
def small_set(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished data set, as ``dataset_whole`` makes it: to be read, not to be changed. The first
    process that asks for it makes it for all."""
    from dataset_whole import make_small

    root = tmp_path_factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root
    place = root / "small_set"
    with (root / "small_set.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not place.exists():
            make_small(root / "small_set.new", request.getfixturevalue("one_worker"))
            (root / "small_set.new").rename(place)
    return place


@pytest.fixture(scope="session")
def room_images(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray]:
    """A folder of colour and depth images, and where the camera was: to be read, not changed."""
    from rgbd_room import write_images

    folder = tmp_path_factory.mktemp("room")
    return folder, write_images(folder)
