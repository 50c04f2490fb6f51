"""Attempts of recordings to reach outside their folder."""

from __future__ import annotations

import os
from pathlib import Path

import bag_data
import pyarrow.parquet as pq
import recording_data
from fault_paths import Action, Reference, Scene, attempt, ways
from rosbags.rosbag2 import StoragePlugin

from slamsim.guard.lock import lock_of, owner_words
from slamsim.guard.output import partial_folder
from slamsim.guard.staging import NEW
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_log, read_recording
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording


def _bag(folder: Path, plugin: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    return bag_data.as_rosbag2(folder, bag_data.Robot(bag_data.ROS2).drive(), plugin)


def _renamed(scene: Scene, way: Reference, plugin: StoragePlugin, suffix: str) -> Action:
    """A recording whose metadata name a file of outside; its own is gone."""
    other, bag = _bag(scene.outside / "other", plugin), _bag(scene.inputs / "bag", plugin)
    (other / f"other{suffix}").rename(scene.outside / f"o{suffix}")
    (bag / f"bag{suffix}").unlink()
    inner = Scene(scene.root)
    name = way(inner, f"o{suffix}").replace("../outside", "../../outside")
    for link in scene.inputs.glob("link-*"):
        link.rename(bag / link.name)
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace(f"bag{suffix}", name))
    return lambda: (read_log(bag), read_recording(bag))


@ways("the file of a rosbag2 folder, SQLite", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    return _renamed(scene, way, StoragePlugin.SQLITE3, ".db3")


@ways("the file of a rosbag2 folder, MCAP", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    return _renamed(scene, way, StoragePlugin.MCAP, ".mcap")


@attempt("a rosbag2 folder whose metadata are a link")
def _(scene: Scene) -> Action:
    bag, other = _bag(scene.inputs / "bag"), scene.outside / "metadata.yaml"
    (bag / "metadata.yaml").rename(other)
    (bag / "metadata.yaml").symlink_to(other)
    return lambda: (read_log(bag), read_recording(bag))


@attempt("a run whose log is a link")
def _(scene: Scene) -> Action:
    (scene.inputs / "log").symlink_to(_bag(scene.outside / "bag"), target_is_directory=True)
    return lambda: (read_log(scene.inputs), read_recording(scene.inputs))


@attempt("a journal of an SQLite recording that names another file")
def _(scene: Scene) -> Action:
    bag, secret = _bag(scene.inputs / "bag"), scene.outside / "secret"
    secret.write_bytes(b"secret")
    name = os.fsencode(secret)
    header = bytes.fromhex("d9d505f920a163d7") + bytes(20)
    tail = len(name).to_bytes(4) + (sum(name) & 0xFFFFFFFF).to_bytes(4) + header[:8]
    journal = header.ljust(512, b"\0") + (1).to_bytes(4) + name + tail
    (bag / "bag.db3-journal").write_bytes(journal)
    return lambda: read_log(bag)


def _mcap(scene: Scene, definitions: dict[str, str]) -> Action:
    messages = bag_data.Robot(bag_data.ROS2).drive()
    path = bag_data.as_mcap(scene.inputs / "a.mcap", messages, definitions=definitions)
    return lambda: (read_log(path), read_recording(path))


@ways("a message definition that includes a file", "relative", "absolute")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "d.idl").write_text("module x { struct y { long z; }; };")
    text = f'#include "{way(scene, "d.idl")}"\nfloat64 x\n'
    return _mcap(scene, {"sensor_msgs/msg/LaserScan": text})


@ways("a field whose type is a path", "relative", "absolute")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "T.msg").write_text("float64 x\n")
    return _mcap(scene, {"sensor_msgs/msg/LaserScan": f"{way(scene, 'T')} x\n"})


@ways("topics and frames that are paths, written again", "relative", "absolute")
def _(scene: Scene, way: Reference) -> Action:
    robot, name = bag_data.Robot(bag_data.ROS2), way(scene, "scan")
    scans = [
        (name, t, robot.scan(message.header.stamp.sec * 10**9, frame=name))
        for _, t, message in robot.scans()
    ]
    path = bag_data.as_mcap(scene.inputs / "a.mcap", [robot.mounting(), *scans])

    def act() -> None:
        recording = read_recording(path)
        with partial_folder(scene.out / "copy") as folder:
            write_recording(recording, folder)
            with ParquetLog(folder / "parquet") as written:
                written.write(recording)

    return act


def _recovered(path: Path, scene: Scene) -> object:
    with partial_folder(scene.out / "recovered") as folder:
        return recover(damaged_recording(path), folder)


@ways("a file of a recording to recover", "link", "linked folder")
def _(scene: Scene, way: Reference) -> Action:
    other, bag = _bag(scene.outside / "other", StoragePlugin.MCAP), scene.inputs / "bag"
    bag.mkdir()
    (other / "other.mcap").rename(scene.outside / "o.mcap")
    name = way(scene, "o.mcap")
    (scene.inputs / name.split("/")[0]).rename(bag / ("log" if "/" in name else name))
    return lambda: _recovered(bag, scene)


@attempt("a recording to recover whose metadata are a link")
def _(scene: Scene) -> Action:
    bag, other = _bag(scene.inputs / "bag", StoragePlugin.MCAP), scene.outside / "metadata.yaml"
    (bag / "metadata.yaml").rename(other)
    (bag / "metadata.yaml").symlink_to(other)
    return lambda: _recovered(bag, scene)


@attempt("what a killed run left of a recording is a link")
def _(scene: Scene) -> Action:
    bag = _bag(scene.outside / "bag", StoragePlugin.MCAP)
    run = scene.inputs / "run"
    (staging := run.with_name(f".run.slamsim-{'0' * 16}")).mkdir()
    lock_of(run).write_bytes(owner_words("lock", "run", staging))
    (staging / NEW).symlink_to(bag, target_is_directory=True)
    return lambda: _recovered(scene.inputs / "run", scene)


def tables(folder: Path) -> Path:
    with ParquetLog(folder) as log:
        log.write(recording_data.recording(2.0))
    return folder


@attempt("a Parquet table that is a link")
def _(scene: Scene) -> Action:
    here, other = tables(scene.inputs / "tables"), tables(scene.outside / "tables")
    for table in here.glob("*.parquet"):
        table.unlink()
        table.symlink_to(other / table.name)
    return lambda: (read_log(here), read_recording(here))


@attempt("a Parquet table whose pages lie in another file")
def _(scene: Scene) -> Action:
    here, other = tables(scene.inputs / "tables"), tables(scene.outside / "tables")
    footer = pq.read_metadata(other / "scans.parquet")
    footer.set_file_path("../../outside/tables/scans.parquet")
    footer.write_metadata_file(here / "scans.parquet")
    return lambda: read_log(here)
