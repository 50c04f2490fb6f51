"""What no change of the structure may change: ``python tests/support/frozen.py write MANIFEST``.

A manifest holds one SHA-256 hash for each file that is written and each array that is read:
simulations, a data set in all formats, recordings of other writers read, checked, corrupted and
fixed, and a map. Two checkouts on one machine must agree: ``frozen.py compare ONE OTHER`` lists
what differs, with exit code 1. Hashes of two machines differ where their processors
round differently, so none is part of the repository. A few minutes on one core.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import foreign_bags
import numpy as np

from slamsim.io.open import read_log, read_recording, read_truth
from slamsim.recording import Recording

Entries = Iterator[tuple[str, str]]
"""(name, hash) of each thing that must not change."""

_COMMAND = "import sys; from slamsim.entry import main; sys.exit(main())"
_SHORT = ("--set", "drive.route.max_duration_s=6")
_WORLDS: Mapping[str, tuple[str, ...]] = {
    "labyrinth": (),
    "tiny": ("--set", "sensors.lidar=lds_01", "--set", "sensors.lidar.intensities=true"),
    "rooms": ("--set", "sensors.lidar=sick_lms200", "--set", "sensors.imu.enabled=false"),
    "corridor": ("--set", "sensors.lidar=urg_04lx", "--set", "robot=sturdy"),
    "loop": ("--set", "sensors.encoders.enabled=false", "--set", "drive=fast_turns"),
    "symmetric": ("--set", "sensors.lidar.enabled=false", "--set", "robot=compact"),
    "labyrinth_large": (
        *("--set", "sensors.lidar=rplidar_a2", "--set", "drive=random_goals"),
        *(
            "--set",
            "sensors.lidar.clock.jitter_s=0.002",
            "--set",
            "sensors.imu.clock.latency_s=0.2",
        ),
    ),
}
"""Each with sensors, a robot or a drive of its own."""
_FAULTY = {
    "sensed": ("--fault", "laser_world_fixed", "--fault", "lidar_late:0.02"),
    "declared": ("--fault", "lidar_gaps", "--fault", "imu_late", "--fault", "wheel_slip"),
}
_MEASURED = ("seconds", "slam_seconds", "realtime_factor", "peak_memory_mb")
"""Of ``report.json``: what differs from run to run."""
_RECIPE = (
    ("formats: [mcap, parquet]", "formats: [mcap, parquet, tum, kitti, carmen]"),
    ("duration_s: 12", "duration_s: 6"),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    modes = parser.add_subparsers(dest="mode", required=True)
    write = modes.add_parser("write", help="hash everything with the package that is imported")
    write.add_argument("manifest", type=Path)
    write.add_argument("--only", choices=sorted(_PARTS), action="append", help="a part of it")
    compare = modes.add_parser("compare", help="list what differs between two manifests")
    compare.add_argument("manifests", type=Path, nargs=2)
    chosen = parser.parse_args()
    if chosen.mode == "compare":
        lines = list(differences(*(json.loads(path.read_text()) for path in chosen.manifests)))
        sys.stdout.write("".join(f"{line}\n" for line in lines) or "nothing differs\n")
        return int(bool(lines))
    manifest = chosen.manifest.resolve()
    with tempfile.TemporaryDirectory(prefix="frozen.") as folder:
        os.chdir(folder)
        entries = {
            f"{part}/{name}": value
            for part in chosen.only or _PARTS
            for name, value in _PARTS[part]()
        }
    manifest.write_text(json.dumps(entries, indent=0, sort_keys=True) + "\n")
    sys.stdout.write(f"{len(entries)} hashes in {manifest}\n")
    return 0


def differences(one: Mapping[str, str], other: Mapping[str, str]) -> Iterator[str]:
    """One line for each name that only one has, or whose hashes differ."""
    for name in sorted(one.keys() | other.keys()):
        if name not in other:
            yield f"only in the first: {name}"
        elif name not in one:
            yield f"only in the second: {name}"
        elif one[name] != other[name]:
            yield f"differs: {name}"


def simulations() -> Entries:
    """Seven worlds, two seeds each, and two with faults."""
    for world, settings in _WORLDS.items():
        for seed in ("0", "1"):
            out = f"{world}_{seed}"
            _run("simulate", world, "--seed", seed, "--out", out, *settings, *_SHORT)
            yield from _files(Path(out))
            yield from _read(out, Path(out))
    for name, faults in _FAULTY.items():
        _run("simulate", "tiny", "--out", name, *_SHORT, *faults)
        yield from _files(Path(name))
        yield from _read(name, Path(name))


def data_set() -> Entries:
    """Sequences in all formats, clean ones and ones with faults, and what is read of them."""
    recipe = (Path(__file__).parents[2] / "configs/datasets/tiny.yaml").read_text()
    for before, after in _RECIPE:
        assert before in recipe
        recipe = recipe.replace(before, after)
    Path("recipe.yaml").write_text(recipe)
    _run("dataset", "make", "recipe.yaml", "-n", "4", "--workers", "1", "--out", "set")
    shutil.rmtree("set/logs")  # what workers told, with times
    yield from _files(Path("set"))
    for tables in sorted(Path("set").rglob("parquet/scans.parquet")):
        sequence = tables.parents[1]
        for path in (tables.parent, sequence / "log", sequence / "carmen" / "log.clf"):
            yield from _read(path.as_posix(), path)
        yield from _edited(tables.parent, "--lossy")


def recordings() -> Entries:
    """Recordings with topics and fields that are not modelled, in every format of others."""
    for kind in foreign_bags.KINDS:
        store = foreign_bags.store_of(kind)
        messages = list(foreign_bags.sent(kind, store, foreign_bags.drive(store, 1, seconds=8.0)))
        path = foreign_bags.write(kind, Path(kind), messages, store)
        yield from _read(kind, path)
        yield from _edited(path)
    ranges = " ".join(f"{1.0 + 0.05 * beam:.2f}" for beam in range(60))
    lines = (
        f"FLASER 60 {ranges} {0.05 * i} 0 {0.01 * i} {0.05 * i} 0 {0.01 * i} {0.2 * i:.3f} h 0.5\n"
        for i in range(40)
    )
    Path("log.clf").write_text("".join(lines))
    yield from _read("log.clf", Path("log.clf"))
    yield from _edited(Path("log.clf"))


def mapping() -> Entries:
    """A map of a short drive: files, ``report.json`` without times, columns of the saved map."""
    _run("map", "tiny", "--out", "mapped", *_SHORT)
    left_out = {"SHA256SUMS", ".slamsim", "report.html", "report.json", "run.rrd", "session.npz"}
    for name, value in _files(Path("mapped")):
        if Path(name).name not in left_out:
            yield name, value
    report = json.loads(Path("mapped/report.json").read_text())
    for key, value in report.items():
        if key not in _MEASURED:
            yield f"report.json {key}", _hash(json.dumps(value, sort_keys=True).encode())
    with np.load("mapped/session.npz") as columns:
        for key in columns.files:
            yield f"session.npz {key}", _hash_of(columns[key])


_PARTS: Mapping[str, Callable[[], Entries]] = {
    "simulate": simulations,
    "dataset": data_set,
    "recordings": recordings,
    "map": mapping,
}


def _run(*arguments: str, codes: Sequence[int] = (0,)) -> bytes:
    """What a command prints; codes: with which it may end."""
    command = [sys.executable, "-c", _COMMAND, *arguments, "-q"]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode not in codes:
        raise SystemExit(f"{' '.join(arguments)} ended with {done.returncode}: {done.stderr!r}")
    return done.stdout


def _edited(path: Path, *options: str) -> Entries:
    """The recording with a fault, the same fixed, and what the checker says of it."""
    corrupted, fixed = f"{path}.corrupted", f"{path}.fixed"
    faults = ("--fault", "lidar_late:0.02", "--fault", "laser_yaw:2")
    _run("fault", str(path), corrupted, *faults, *options)
    _run("fix", corrupted, fixed, codes=(0, 1))
    checked = json.loads(_run("check", str(path), "--json", codes=(0, 1)))
    del checked["seconds"]
    yield f"{path} check", _hash(json.dumps(checked, sort_keys=True).encode())
    for folder in (corrupted, fixed):
        yield from _files(Path(folder))
        yield from _read(folder, Path(folder))


def _files(folder: Path) -> Entries:
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        yield path.as_posix(), _hash(path.read_bytes())


def _read(name: str, path: Path) -> Entries:
    """Every array of the recording, of the log and of the truth that a path holds."""
    for at, value in _recorded(read_recording(path)):
        yield f"{name} recording {at}", value
    try:
        log = read_log(path)
    except Exception as refusal:  # such as a recording without scans: with the same words
        yield f"{name} log", _hash(f"{type(refusal).__name__}: {refusal}".encode())
    else:
        for at, value in _leaves(log):
            yield f"{name} log{at}", value
        for number, scan in enumerate(log.scans):
            yield f"{name} log.scans {number}", _hash_of(list(_leaves(scan)))
    yield from ((f"{name} truth{at}", value) for at, value in _leaves(read_truth(path)))


def _recorded(recording: Recording) -> Entries:
    """By topic, so that the names do not depend on how a ``Recording`` is built."""
    kinds = ("scans", "imus", "odometries", "ticks", "joints")
    for kind in kinds:
        for stream in getattr(recording, kind):
            for at, value in _leaves(stream):
                yield f"{kind} {stream.topic}{at}", value
    for edge in recording.transforms:
        for at, value in _leaves(edge):
            yield f"{edge.topic} {edge.name}{at}", value
    for field in fields(recording):
        if field.name not in (*kinds, "streams", "transforms"):
            yield field.name, _hash_of(getattr(recording, field.name))


def _leaves(value: Any, at: str = "") -> Entries:
    """The fields of a data class, and of those inside of it; scans of a log are read one by one."""
    if is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if at + field.name != "scans":
                yield from _leaves(getattr(value, field.name), f"{at}.{field.name}")
    else:
        yield at, _hash_of(value)


def _hash_of(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.dtype != object:
        return _hash(f"{value.dtype} {value.shape} ".encode() + value.tobytes())
    if isinstance(value, str | int | float | bool | None):
        return _hash(repr(value).encode())
    if is_dataclass(value):
        return _hash_of([(at, leaf) for at, leaf in _leaves(value)])
    return _hash(" ".join(_hash_of(each) for each in value).encode())


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
