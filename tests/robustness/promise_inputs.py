"""Inputs of every kind, made once: ``promise_tree`` copies some of them into the tree of each case.

What slamsim itself makes comes from its command line. The drive, its map and the data set take a
minute or two, so the default suite has a sealed world and a sealed copy of a recording in their
place.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

_STAMPED = "\n".join(f"{0.2 * i:.1f} {0.05 * i:.2f} 0 0 0 0 0 1" for i in range(15)) + "\n"
_TEXTS: Mapping[str, str] = {
    "path.tum": _STAMPED,
    "pairs.relations": "0.2 2.0 0.45 0 0 0 0 0\n0.4 2.4 0.5 0 0 0 0 0\n",
    "tiny.yaml": "name: tiny\nmaze: {rows: 2, columns: 2}\n",
    "config.yaml": "drive: {route: {max_duration_s: 2}}\nsensors: {lidar: {rate_hz: 5}}\n",
    "robot.yaml": "robot: {urdf_file: r.urdf}\n",
    "r.urdf": "<robot name='r'><link name='base_link'><visual><geometry>"
    "<mesh filename='parts/box.stl'/></geometry></visual></link></robot>\n",
    "hostile.urdf": "<robot name='h'><link name='base_link'><visual><geometry>"
    "<mesh filename='../../notes.txt'/></geometry></visual></link></robot>\n",
}
_RECIPE = """\
    name: mine
    title: Short drives through tiny labyrinths
    licence: CC0-1.0
    seed: 1
    duration_s: 3
    sequences_per_world: 1
    splits: {train: 1.0, val: 0.0, test: 0.0}
    formats: [mcap, parquet]
    worlds: [{world: tiny}]
    drives: [{drive: random_goals}]
    vary: {sensors.lidar: {choice: [lds_01]}}
    """
SHORT = (
    *("--set", "drive.route.max_duration_s=2", "--set", "sensors.lidar.rate_hz=5"),
    *("--set", "sensors.lidar.beam_count=90", "--set", "sensors.lidar.angle_step_deg=3"),
)

KINDS: Mapping[str, tuple[str, ...]] = {
    "recording": ("foreign.mcap", "bag2", "ros1.bag", "log.clf", "cut.mcap", "copy", "drive"),
    "run": ("run", "copy", "world", "drive"),
    "set": ("set", "stub_set"),
    "world": ("tiny.yaml", "map.yaml", "room.stl"),
    "config": ("config.yaml", "robot.yaml"),
    "recipe": ("recipe.yaml",),
    "relations": ("pairs.relations",),
    "path": ("path.tum",),
    "measurements": ("measured.yaml",),
    "fault": ("fault.yaml",),
    "map": ("map.yaml", "run"),
    "named": ("map.pgm", "r.urdf", "hostile.urdf", "parts"),
}
"""For what a command may want each; ``named``: what others name by a path relative to them."""

Command = Callable[[Sequence[str], Path], int]


def make_inputs(folder: Path, command: Command, *, whole: bool) -> None:
    """All of them, in a folder that is not there; whole: with drive, map and data set.

    command: runs slamsim with these arguments in this folder, and gives its exit code.
    """
    import fault_stages
    import trimesh
    from test_world_import import ROOM, write_map

    from slamsim.config.bundled import find_input

    unfinished = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    _foreign(unfinished)
    for name, text in _TEXTS.items():
        (unfinished / name).write_text(text)
    (unfinished / "recipe.yaml").write_text(textwrap.dedent(_RECIPE))
    write_map(unfinished, ROOM)
    trimesh.creation.box((4.0, 4.0, 1.0)).export(unfinished / "room.stl")
    (unfinished / "parts").mkdir()
    shutil.copy(unfinished / "room.stl", unfinished / "parts" / "box.stl")
    shutil.copy(find_input("configs/faults", "laser_yaw"), unfinished / "fault.yaml")
    shutil.copy(
        find_input("configs/measurements", "turtlebot2_study"), unfinished / "measured.yaml"
    )
    fault_stages.dataset_of(2, unfinished / "stub_set")
    made: list[tuple[str, ...]] = [
        ("recover", "foreign.mcap", "--out", "copy"),
        ("world", "tiny", "--out", "world"),
    ]
    if whole:
        made.append(("simulate", "tiny", *SHORT, "--out", "drive"))
        made.append(("map", "drive", "--out", "run"))
        made.append(("dataset", "make", "recipe.yaml", "-n", "1", "--out", "set"))
    for arguments in made:
        code = command((*arguments, "-q"), unfinished)
        assert code == 0, f"{' '.join(arguments)} ended with {code}"
    unfinished.rename(folder)


def _foreign(folder: Path) -> None:
    """Recordings of other writers, each with topics that slamsim does not model."""
    import foreign_bags

    for kind, name in (("mcap", "foreign"), ("rosbag2_sqlite", "bag2"), ("rosbag1", "ros1")):
        store = foreign_bags.store_of(kind)
        messages = list(foreign_bags.sent(kind, store, foreign_bags.drive(store, 1)))
        foreign_bags.write(kind, folder / name, messages, store)
    whole = (folder / "foreign.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    ranges = " ".join(f"{1.0 + 0.05 * beam:.2f}" for beam in range(60))
    lines = (
        f"FLASER 60 {ranges} {0.05 * i} 0 0 {0.05 * i} 0 0 {0.2 * i:.3f} host 0.5\n"
        for i in range(15)
    )
    (folder / "log.clf").write_text("".join(lines))
