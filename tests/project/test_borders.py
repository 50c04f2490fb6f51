"""Who may import what: the borders between stages, and a light ``import slamsim``."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

from sources import imports_of, tree_of

PACKAGE = Path(__file__).parents[2] / "slamsim"
ALLOWED = {
    "gtsam": ("slam/backend/graph.py", "slam/visual/graph.py"),
    "pybullet": ("sim/",),
    "rerun": ("report/",),
    "foxglove": (
        "simulation/sinks/",
        "simulation/foxglove_channels.py",
        "live/servers/foxglove.py",
        "live/servers/foxglove_requests.py",
    ),
    "matplotlib": ("report/", "dataset/catalogue/figures.py"),
    "rosbags": ("io/",),
    "google": ("io/ros/foxglove_schemas.py",),
    "mcap": ("io/",),
    "open3d": ("sensors/",),
    "kiss_icp": ("slam/matching/", "bench/peers/"),
    "small_gicp": ("bench/peers/",),
    "karto_scanmatcher": ("bench/peers/",),
    "genz_icp": ("bench/peers/",),
    "trimesh": ("world/",),
    "pebble": ("process/worker.py",),
    "distributed": ("dataset/make/engines/",),
    "gymnasium": ("gym/",),
    "rclpy": ("ros/",),
    "rcl_interfaces": ("ros/",),
    "launch": ("ros/slamsim.launch.py",),
    "launch_ros": ("ros/slamsim.launch.py",),
    "fsspec": ("dataset/",),
    "evo": (),
}
HEAVY = [*ALLOWED, "numba", "scipy", "cv2", "shapely"]


def test_libraries_are_imported_only_within_their_borders() -> None:
    strangers = [
        (library, name)
        for path in sorted(PACKAGE.rglob("*.py"))
        for library in ALLOWED.keys() & imports_of(path)
        if not (name := path.relative_to(PACKAGE).as_posix()).startswith(ALLOWED[library])
    ]
    assert strangers == []


def test_a_light_import_pulls_in_nothing_heavy() -> None:
    """One after the other in one process: what the first loads is there for the others."""
    lines = ["import importlib, sys"]
    for module in ("slamsim", "slamsim.core.types", "slamsim.config.run", "slamsim.cli.main"):
        heavy = f"[h for h in {HEAVY!r} if h in sys.modules]"
        lines += [f"importlib.import_module({module!r})", f"print({module!r}, *{heavy})"]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert [line for line in done.stdout.splitlines() if " " in line] == []
    assert len(done.stdout.splitlines()) == 4


def test_the_process_that_drives_loads_no_library_of_planning() -> None:
    """It begins with each simulated drive: scipy alone doubled the processor time of its start."""
    code = (
        "import sys, slamsim.sim.drive.process, slamsim.world.model; print('scipy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


SLOW_PARTS = ("scipy.stats", "scipy.signal")


def test_what_takes_long_to_import_waits_until_it_is_used() -> None:
    """scipy.stats and scipy.signal take 0.8 s of processor time, for a few lines of theirs."""
    found = [
        (path.relative_to(PACKAGE).as_posix(), node.module)
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in tree_of(path).body
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(SLOW_PARTS)
    ]
    assert found == []


READING = {
    *("read_bytes", "read_text", "open", "copyfile", "copytree", "copy2", "fromfile", "memmap"),
    *("loadtxt", "genfromtxt", "load_scene", "loadURDF", "imread", "read_triangle_mesh"),
}
OWN_DOORS = {
    # what this process, or one that it started, has written itself
    "process/worker.py": "what a worker printed; the memory limit that the system tells",
    "core/jit.py": "our own source, and the cache of its kernels with their checksums",
    "recording/row_store.py": "a temporary file without a name",
    "sim/robot/chassis.py": "the robot's description as we write it for the engine",
    "dataset/make/produce.py": "a sequence that was made just now, hashed",
    "process/children.py": "what the system tells of a process",
    "bench/online.py": "what the system tells of this process",
    "live/servers/access.py": "what the system tells of sockets and the processes that hold them",
    "io/copy/writers.py": "a bag that was written just now, whose header becomes longer",
    "live/servers/web/answers.py": "the parts of our own page",
    # no file of anybody's
    "sim/bullet.py": "the null device",
    "entry.py": "the null device, in the place of a stream that is closed",
    "bench/logs.py": "the null device",
    # doors of their own, which refuse what ``open_as_found`` refuses
    "dataset/store/place.py": "a data set, in a folder through open_as_found, or behind a URL",
    "dataset/store/lazy_table.py": "through Place.open",
    "dataset/make/sequence_check.py": "through Place.open",
    "dataset/store/store.py": "its locks; a sequence that a worker made just now",
    # what has passed a door and is read by a library, which takes a name only
    "world/mesh_solids.py": "a mesh that check_mesh_file has passed",
    "io/salvage/sqlite_salvage.py": "a copy of a database that open_as_found has passed",
}
"""Modules outside of ``guard/`` that open files for reading, and what these are."""


def opened_for_reading(path: Path) -> bool:
    """Whether a module calls what reads a file by its name."""
    return any(
        isinstance(node, ast.Call) and _name(node.func) in READING and not _writes(node)
        for node in ast.walk(tree_of(path))
    )


def _name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _writes(call: ast.Call) -> bool:
    modes = [argument.value for argument in call.args if isinstance(argument, ast.Constant)]
    return any(isinstance(mode, str) and mode[:1] in ("x", "w", "a") for mode in modes)


def test_files_are_read_through_one_door() -> None:
    """What a user or a file names is opened in ``guard/`` alone, where pipes, devices, sizes and
    links out of a folder are looked at."""
    found = {
        name
        for path in sorted(PACKAGE.rglob("*.py"))
        if not (name := path.relative_to(PACKAGE).as_posix()).startswith("guard/")
        and opened_for_reading(path)
    }
    assert found == OWN_DOORS.keys()
