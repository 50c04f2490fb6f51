"""Attempts of the folders of runs to reach outside."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from fault_paths import Action, Reference, Scene, attempt, ways
from test_world_import import ROOM, write_map

from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import Trajectory
from slamsim.guard.seal import sums_text
from slamsim.io.text.tum import write_tum
from slamsim.report.viewer.process import recording_of
from slamsim.run.continuing import read_earlier
from slamsim.run.evaluation import evaluate_run
from slamsim.run.localising import read_known_map
from slamsim.run.mapping import _origin_beside
from slamsim.run.verifying import verify_path
from slamsim.simulation.own_files import write_config

TRAJECTORY = Trajectory(
    np.arange(1, 4, dtype=np.int64) * 10**9, np.zeros((3, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
)


def _run(folder: Path) -> Path:
    """What is read of a mapped run, as far as these attempts need it."""
    folder.mkdir(exist_ok=True)
    (folder / "parts").mkdir()
    for name in ("trajectory", "odometry", "ground_truth", "parts/matching"):
        write_tum(folder / f"{name}.tum", TRAJECTORY)
    write_map(folder, ROOM)
    for name in ("session.npz", "run.rrd"):
        (folder / name).write_bytes(b"RRF2")
    (folder / "world.yaml").write_text("maze: {rows: 2, columns: 2}\n")
    write_config(folder, RunConfig())
    return folder


READERS: dict[str, Callable[[Path], object]] = {
    "trajectory.tum": lambda run: evaluate_run(run, None, None, _reporter()),
    "odometry.tum": lambda run: evaluate_run(run, None, None, _reporter()),
    "ground_truth.tum": lambda run: evaluate_run(run, None, None, _reporter()),
    "parts/matching.tum": lambda run: evaluate_run(run, None, None, _reporter()),
    "map.yaml": lambda run: evaluate_run(run, None, None, _reporter()),
    "world.yaml": lambda run: (
        _origin_beside(run / "log"),
        evaluate_run(run, None, None, _reporter()),
    ),
    "config.yaml": lambda run: (
        _origin_beside(run / "log"),
        evaluate_run(run, None, None, _reporter()),
    ),
    "session.npz": lambda run: (read_known_map(run), read_earlier(run, None)),
    "run.rrd": recording_of,
}


def _reporter() -> Reporter:
    return Reporter(quiet=True, as_json=False)


def _of_run(name: str) -> None:
    @attempt(f"the file {name} of a run is a link")
    def _(scene: Scene) -> Action:
        run, other = _run(scene.inputs), _run(scene.outside)
        (run / name).unlink()
        (run / name).symlink_to(other / name)
        return lambda: READERS[name](run)


for each in READERS:
    _of_run(each)


@attempt("the folder of a run's parts is a link")
def _(scene: Scene) -> Action:
    run, other = _run(scene.inputs), _run(scene.outside)
    (run / "parts" / "matching.tum").unlink()
    (run / "parts").rmdir()
    (run / "parts").symlink_to(other / "parts", target_is_directory=True)
    return lambda: evaluate_run(run, None, None, _reporter())


@attempt("the map.yaml of a run without a session is a link, to localise in")
def _(scene: Scene) -> Action:
    run, other = _run(scene.inputs), _run(scene.outside)
    (run / "session.npz").unlink()
    (run / "map.yaml").unlink()
    (run / "map.yaml").symlink_to(other / "map.yaml")
    return lambda: read_known_map(run)


@ways("a line of SHA256SUMS of a run", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    secret = scene.outside / "secret"
    secret.write_bytes(b"secret")
    run = _run(scene.inputs)
    (run / ".slamsim").write_text("")
    (run / "SHA256SUMS").write_text(
        sums_text({way(scene, "secret"): hashlib.sha256(b"secret").hexdigest()})
    )
    return lambda: verify_path(run)


@attempt("members of a saved map that are paths")
def _(scene: Scene) -> Action:
    path = scene.inputs / "session.npz"
    names = ("../outside/a", str(scene.outside / "b"))
    np.savez(path, allow_pickle=False, **dict.fromkeys(names, np.zeros(3)))
    return lambda: read_earlier(path, None)
