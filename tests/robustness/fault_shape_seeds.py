"""Worlds, robots, meshes, pictures and YAML of every kind, to be damaged."""

from __future__ import annotations

from pathlib import Path

import cv2
import fault_doors as doors
import numpy as np
from fault_corpus_base import Data, Fill, one, several
from fault_corpus_images import DESCRIBED, SMALL
from fault_corpus_meshes import GLB, OBJ, PLY, STL, TEXT_PLY, TEXT_STL
from fault_corpus_robots import SOUND
from fault_seeds import Change, Read, Seed
from fault_shape_changes import (
    NUMBERS,
    change_elements,
    change_glb,
    change_picture,
    change_ply,
    change_triangles,
)
from fault_text_changes import TEXT

_WORLD = """name: small
seed: 3
maze: {rows: 2, columns: 2, cell_m: 2.0, algorithm: wilson, dead_ends_opened: 1.0}
walls: {thickness_m: 0.15, height_m: 1.0, height_jitter_m: 0.2}
doors: {share: 0.3, width_m: 0.9}
pillars: {share: 0.5, size_m: [0.2, 0.3]}
clutter: {per_cell: 0.5, shapes: [box, table], size_m: [0.15, 0.4]}
floor: {friction: 0.7, patches: [{x_m: [0.5, 1.5], y_m: [0.0, 2.0], friction: 0.2}]}
start: {x_m: 1.0, y_m: 1.0, yaw_deg: 45.0}
"""
_PLAN = """clearance_m: 0.6
plan:
  cell_m: 1.5
  drawing: |
    +--+--+--+
    |S    D  |
    +  +--+  +
    |     |##|
    +--+--+--+
"""
_CONFIG = """seed: 5
world: {maze: {rows: 2, columns: 2}}
robot: {preset: compact, motor: {max_torque_n_m: 0.5}}
drive: {route: {kind: tour, clearance_m: 0.05}, physics: {rate_hz: 240}}
sensors: {lidar: {preset: lds_01, rate_hz: 5.0}, imu: {enabled: false}}
faults: [lidar_late]
"""
_RECIPE = """name: small
title: a small one
licence: CC0-1.0
seed: 1
duration_s: {uniform: [10, 12]}
sequences_per_world: 2
splits: {train: 0.5, val: 0.25, test: 0.25}
formats: [mcap]
worlds: [{world: tiny, vary: {maze.rows: {integers: [2, 3]}, clutter.per_cell: {uniform: [0, 1]}}}]
drives: [{drive: tour}]
vary: {sensors.encoders.wheel_radius_error: {normal: [0.0, 0.001]}}
faults: {none: 0.5, one: 0.5, several: 0.0, choice: [{fault: lidar_late}]}
"""
_MEASURED = """name: small
robot: turtlebot2
basic_drive: {speeds_m_s: [0.2, 0.3], drive_s: 20.0, rest_s: 5.0, runs: 6}
figures:
  - {quantity: basic_drive.stop_x_m, stop: 2, value: 5.5, sigma: 0.1, source: "a", others: {b: 5.0}}
  - {quantity: umbmark.corner_deg, value: 70.0, sigma: 5.0, source: "c"}
"""
_ROUTE = "x_m,y_m,yaw_deg\n" + "".join(f"{i},{i % 3}.5,{10 * i}\n" for i in range(9))


def _gray(suffix: str) -> bytes:
    walls = np.full((40, 40), 255, np.uint8)
    walls[[0, -1]] = walls[:, [0, -1]] = walls[20, 10:30] = 0
    return cv2.imencode(suffix, walls)[1].tobytes()


def _seed(
    name: str,
    file: str,
    fill: Fill,
    read: Read,
    changes: tuple[Change, ...],
    deep: Read | None = None,
) -> Seed:
    def make(folder: Path) -> Path:
        fill(folder)
        return folder / file

    return Seed(name, make, read, changes=changes, rarely=((12, deep),) if deep else ())


def _mesh(name: str, file: str, data: Data, changes: tuple[Change, ...]) -> Seed:
    fill = several(a__yaml=f"mesh: {{file: {file}}}\n", **{file.replace(".", "__"): data})
    return _seed(name, "a.yaml", fill, doors.world, changes, doors.driven_world)


def _map(name: str, file: str, data: Data) -> Seed:
    fill = several(a__yaml=DESCRIBED.replace("map.png", file), **{file.replace(".", "__"): data})
    return _seed(name, "a.yaml", fill, doors.world, (*NUMBERS, change_picture))


_WORDS = (*NUMBERS, *TEXT)
SHAPE_SEEDS: tuple[Seed, ...] = (
    _seed("world", "a.yaml", one("a.yaml", _WORLD), doors.world, _WORDS, doors.driven_world),
    _seed("plan", "a.yaml", one("a.yaml", _PLAN), doors.world, _WORDS),
    _seed("config", "a.yaml", one("a.yaml", _CONFIG), doors.config, _WORDS),
    _seed("recipe", "a.yaml", one("a.yaml", _RECIPE), doors.recipe, _WORDS),
    _seed("measurements", "a.yaml", one("a.yaml", _MEASURED), doors.measurements, _WORDS),
    _seed("route", "r.csv", one("r.csv", _ROUTE), doors.route, _WORDS),
    _seed("URDF", "r.urdf", one("r.urdf", SOUND), doors.robot, (*_WORDS, change_elements)),
    _mesh("STL", "m.stl", STL, (change_triangles,)),
    _mesh("STL in words", "m.stl", TEXT_STL, _WORDS),
    _mesh("OBJ", "m.obj", OBJ, _WORDS),
    _mesh("PLY", "m.ply", PLY, (change_ply,)),
    _mesh("PLY in words", "m.ply", TEXT_PLY, _WORDS),
    _mesh("GLB", "m.glb", GLB, (change_glb,)),
    _map("map of a PNG", "map.png", SMALL),
    _map("map of a PGM", "map.pgm", _gray(".pgm")),
)
"""The description of a map or of a mesh's world is damaged as often as what it names."""
