"""Who may import what: the borders between stages, and a light ``import slamsim``."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "slamsim"
ALLOWED = {
    "gtsam": ("slam/graph.py",),
    "pybullet": ("sim/",),
    "rerun": ("view/",),
    "matplotlib": ("view/",),
    "rosbags": ("logs/", "io/"),
    "mcap": ("logs/", "io/"),
    "open3d": ("sensors/",),
    "kiss_icp": ("slam/matching/", "bench/peers/"),
    "small_gicp": ("bench/peers/",),
    "karto_scanmatcher": ("bench/peers/",),
    "genz_icp": ("bench/peers/",),
    "trimesh": ("world/",),
    "pebble": ("worker.py",),
    "distributed": ("dataset/engines/",),
    "fsspec": ("dataset/",),
    "evo": (),
}
HEAVY = [*ALLOWED, "numba", "scipy", "cv2", "shapely"]


def imports_of(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("library", sorted(ALLOWED))
def test_a_library_is_imported_only_within_its_border(library: str) -> None:
    strangers = [
        name
        for path in sorted(PACKAGE.rglob("*.py"))
        if library in imports_of(path)
        and not (name := path.relative_to(PACKAGE).as_posix()).startswith(ALLOWED[library])
    ]
    assert strangers == []


@pytest.mark.parametrize(
    "module", ["slamsim", "slamsim.types", "slamsim.cli", "slamsim.config.run"]
)
def test_a_light_import_pulls_in_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*[h for h in {HEAVY!r} if h in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split() == []
