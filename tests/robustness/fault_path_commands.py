"""Attempts to reach outside a folder by what is typed on the command line."""

from __future__ import annotations

from pathlib import Path

import trimesh
from fault_path_recordings import tables
from fault_paths import Action, Scene, attempt
from test_world_import import ROOM, write_map

from slamsim.cli.main import app
from slamsim.guard.errors import SlamsimError


def _typed(*words: str | Path) -> Action:
    """A command, up to the sentence that it ends with."""

    def act() -> None:
        try:
            app([str(word) for word in words], standalone_mode=False)
        except SystemExit as end:
            raise SlamsimError(f"exit code {end.code}") from None

    return act


@attempt("slamsim world: a mesh")
def _(scene: Scene) -> Action:
    trimesh.creation.box((4.0, 4.0, 1.0)).export(scene.outside / "box.stl")
    (scene.inputs / "w.yaml").write_text("mesh: {file: ../outside/box.stl}\n")
    return _typed("world", scene.inputs / "w.yaml", "--out", scene.out / "w", "-q")


@attempt("slamsim config: a preset")
def _(scene: Scene) -> Action:
    (scene.outside / "r.yaml").write_text("name: other\n")
    (scene.inputs / "c.yaml").write_text("robot: ../outside/r.yaml\n")
    return _typed("config", "tiny", "--config", scene.inputs / "c.yaml")


@attempt("slamsim check: a table")
def _(scene: Scene) -> Action:
    here, other = tables(scene.inputs / "tables"), tables(scene.outside / "tables")
    (here / "imu.parquet").unlink()
    (here / "imu.parquet").symlink_to(other / "imu.parquet")
    return _typed("check", here, "-q")


@attempt("slamsim fault: a fault beside the recording")
def _(scene: Scene) -> Action:
    here = tables(scene.inputs / "tables")
    (scene.inputs / "log").symlink_to(scene.outside, target_is_directory=True)
    return _typed("fault", here, scene.out / "damaged", "--fault", "laser_yaw:../../outside", "-q")


@attempt("slamsim localise: the map of a run")
def _(scene: Scene) -> Action:
    here = tables(scene.inputs / "tables")
    write_map(scene.outside, ROOM)
    (scene.inputs / "run").mkdir()
    (scene.inputs / "run" / "map.yaml").symlink_to(scene.outside / "map.yaml")
    return _typed("localise", here, "--in", scene.inputs / "run", "--out", scene.out / "l", "-q")


@attempt("slamsim evaluate: a trajectory")
def _(scene: Scene) -> Action:
    (scene.outside / "t.tum").write_text("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n")
    (scene.inputs / "trajectory.tum").symlink_to(scene.outside / "t.tum")
    return _typed("evaluate", scene.inputs, "-q")


@attempt("slamsim verify: a folder with a link in it")
def _(scene: Scene) -> Action:
    (scene.outside / "secret").write_text("secret")
    (scene.inputs / "here").symlink_to(scene.outside, target_is_directory=True)
    (scene.inputs / ".slamsim").write_text("")
    return _typed("verify", scene.inputs, "-q")


@attempt("slamsim view: a recording")
def _(scene: Scene) -> Action:
    (scene.outside / "a.rrd").write_bytes(b"RRF2")
    (scene.inputs / "run.rrd").symlink_to(scene.outside / "a.rrd")
    return _typed("view", scene.inputs)
