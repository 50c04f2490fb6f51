"""Faults through a whole sequence, two at a time: all formats tell the same. Every third pair is in
the default suite, as each costs a sequence in all formats."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from dataset_example import small_spec

from slamsim.core.geometry import between, matrix_from_xyzw, se2_from_se3, se3_from_parts
from slamsim.core.types import Drive
from slamsim.dataset.make import produce as production
from slamsim.dataset.recipe.sequence import SequenceSpec
from slamsim.guard.errors import InputRefused
from slamsim.io.open import read_log, read_recording, read_truth
from slamsim.io.parquet.file import read_table
from slamsim.io.text.kitti import CAMERA_FROM_LASER
from slamsim.recording.frames import declared_laser_mounting
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveOutcome, DriveRun
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M

NO_FAN = {"laser_degrees", "laser_step_degrees"}
"""Beams that go round several times: no CARMEN log has that, and its reader says so."""


def spec_of(*faults: str) -> SequenceSpec:
    return small_spec(
        f"faults={list(faults)}",
        "sensors.lidar.rate_hz=5",
        "sensors.lidar.beam_count=91",
        "sensors.lidar.angle_step_deg=3.0",
        "sensors.imu.rate_hz=60",
        "sensors.encoders.rate_hz=20",
        seconds=6.0,
    )


@dataclass
class Driven:
    """A drive that was driven before."""

    windows: list[Drive]
    outcome: DriveOutcome

    def __iter__(self) -> Iterator[Drive]:
        return iter(self.windows)


@contextmanager
def one_drive_for_all() -> Iterator[None]:
    """No fault of a recording changes how the robot drives."""
    config = spec_of().config
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    route = plan_route(world, robot, config.drive)
    run = DriveRun(world, robot, route, config.drive)
    driven = Driven(list(run), run.outcome)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(production, "plan_route", lambda *_: route)
        patch.setattr(production, "DriveRun", lambda *_: driven)
        yield


@pytest.fixture(scope="module", autouse=True)
def driven() -> Iterator[None]:
    with one_drive_for_all():
        yield


def poses_of(kitti: Path) -> np.ndarray[Any, Any]:
    return np.loadtxt(kitti / "poses" / "00.txt").reshape(-1, 3, 4)


def pairs() -> list[Any]:
    """Each fault once: those without a CARMEN log alone, the others with one from far off in the
    list, whose names begin otherwise."""
    names = [fault.name for fault in bundled_faults() if not isinstance(fault, CameraFault)]
    paired = [name for name in names if name not in NO_FAN]
    half = (len(paired) + 1) // 2
    halves = zip_longest(paired[:half], paired[half:])
    found = [*((name,) for name in sorted(NO_FAN)), *(tuple(filter(None, two)) for two in halves)]
    return [
        pytest.param(names, marks=[pytest.mark.slow] if place % 3 else [], id="+".join(names))
        for place, names in enumerate(found)
    ]


@pytest.mark.parametrize("names", pairs())
def test_all_formats_tell_what_the_recording_tells(names: tuple[str, ...], tmp_path: Path) -> None:
    production.produce(spec_of(*names), tmp_path)
    bag, tables = read_recording(tmp_path / "log"), read_recording(tmp_path / "parquet")
    for kind in ("scans", "imus", "odometries", "ticks", "joints"):
        for one, other in zip(getattr(tables, kind), getattr(bag, kind), strict=True):
            assert np.array_equal(one.stamps_ns, other.stamps_ns), kind
    truth = read_table(tmp_path / "truth" / "scans.parquet")
    samples = tables.scans[0].samples
    assert samples is not None
    assert (np.diff(samples) >= 0).all()
    assert samples.max() < len(truth["true_stamp_ns"])
    assert len(poses_of(tmp_path / "kitti")) == len(samples)
    with pytest.raises(InputRefused) if NO_FAN & {*names} else nullcontext():
        carmen = read_log(tmp_path / "carmen" / "log.clf")
        declared = se2_from_se3(declared_laser_mounting(bag))
        off = between(declared, se2_from_se3(carmen.T_base_laser))
        assert np.abs(off).max() < 1e-5
    shutil.rmtree(tmp_path)


def off_walls_m(folder: Path) -> float:
    """How far a KITTI sequence's points lie from the walls, where the recording has the laser."""
    config, log = spec_of().config, read_log(folder / "log")
    truth = read_truth(folder / "log")
    assert truth is not None
    world = build_world(config.world, config.seed)
    walls = shapely.union_all(shapely.linestrings(world.solids.shadow(BODY_LOW_M, BODY_HIGH_M)))
    poses = np.tile(np.eye(4), (len(poses_of(folder / "kitti")), 1, 1))
    poses[:, :3] = poses_of(folder / "kitti")
    first = read_table(folder / "truth" / "scans.parquet")["true_stamp_ns"][:1]
    half_ns = next(iter(log.scans)).geometry.duration_ns // 2
    start = truth.at(first + half_ns)
    T_map_base = se3_from_parts(matrix_from_xyzw(start.quats_xyzw)[0], start.positions_m[0])
    T_map_camera = T_map_base @ log.T_base_laser @ np.linalg.inv(CAMERA_FROM_LASER)
    clouds = sorted((folder / "kitti" / "sequences" / "00" / "velodyne").iterdir())
    points = []
    for T, path in zip(poses, clouds, strict=True):
        cloud = np.fromfile(path, dtype="<f4").reshape(-1, 4)
        cloud[:, 3] = 1.0
        points.append((T_map_camera @ T @ CAMERA_FROM_LASER @ cloud.T)[:2].T)
    return float(np.median(shapely.distance(walls, shapely.points(np.concatenate(points)))))


def test_a_kitti_sequence_shows_what_is_wrong_with_the_laser(tmp_path: Path) -> None:
    """By true poses and the recording's own words; the truth of a scan is true, however stamped."""
    off_m = {}
    for name in ("", "lidar_late", "laser_yaw", "laser_mirrored", "range_offset"):
        folder = tmp_path / (name or "healthy")
        production.produce(spec_of(*([name] if name else [])), folder)
        off_m[name] = off_walls_m(folder)
    assert off_m[""] == off_m["lidar_late"] < 0.01
    assert min(off_m[name] for name in ("laser_yaw", "laser_mirrored", "range_offset")) > 0.02
