"""The true occupancy grid of a world as ROS map_server reads it."""

from __future__ import annotations

from pathlib import Path

from slamsim.core.types import Grid
from slamsim.slam.mapping.map_files import map_files

OCCUPANCY = "occupancy"


def write_occupancy(folder: Path, grid: Grid) -> None:
    """``occupancy.png`` and ``occupancy.yaml``: 0 solid, 254 free, 205 out of reach."""
    files = map_files(grid)
    text = files["map.yaml"].decode().replace("map.pgm", f"{OCCUPANCY}.png")
    (folder / f"{OCCUPANCY}.png").write_bytes(files["map.png"])
    (folder / f"{OCCUPANCY}.yaml").write_text(text, encoding="utf-8")
