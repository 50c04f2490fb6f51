"""A produced sequence: the same bytes every time, complete, and as ``simulate`` would have it."""

from __future__ import annotations

import gc
import hashlib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from dataset_example import produced, small_spec

from slamsim.config.loading import load_run_config
from slamsim.core.types import FloatArray
from slamsim.dataset.make.produce import produce
from slamsim.dataset.recipe.sequence import SequenceFacts
from slamsim.guard.pictures import GrayImage, read_gray_image
from slamsim.io.open import read_log, read_recording, read_truth
from slamsim.io.parquet.file import joined_axes, read_table
from slamsim.io.text.tum import read_tum
from slamsim.sensors.faults.registry import load_fault
from slamsim.simulation.driven import simulate_with_faults
from slamsim.simulation.simulate import simulate

pytestmark = pytest.mark.usefixtures("drives_here")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SequenceFacts]:
    folder = tmp_path_factory.mktemp("sequence")
    return folder, produced(folder)


Made = tuple[Path, SequenceFacts]


def test_every_file_is_listed_with_its_size_and_hash(made: Made) -> None:
    folder, facts = made
    there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert {file.path for file in facts.files} == there
    for file in facts.files:
        data = (folder / file.path).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (file.size_bytes, file.sha256)
    for name in ("config.yaml", "world.yaml", "log/metadata.yaml", "truth/pairs.parquet"):
        assert name in there


def test_a_second_time_makes_the_same_bytes(made: Made, tmp_path: Path) -> None:
    assert produced(tmp_path / "again") == made[1]


def test_windows_do_not_show(made: Made, tmp_path: Path) -> None:
    """Only config.yaml says how the drive was cut, and the last bit of the wheels' odometry."""
    again = produced(tmp_path / "again", "drive.physics.window_s=1.7")
    one, other = ({f.path: f.sha256 for f in facts.files} for facts in (made[1], again))
    assert set(one) == set(other)
    assert {path for path in one if one[path] != other[path]} <= {
        "config.yaml",
        "log/log_0.mcap",
        "parquet/odometry.parquet",
        "parquet/transforms.parquet",
    }
    assert again.quality == made[1].quality


def test_the_log_is_the_one_that_simulate_writes(made: Made, tmp_path: Path) -> None:
    simulate(small_spec().config, tmp_path / "log")
    name = "log_0.mcap"
    assert (made[0] / "log" / name).read_bytes() == (tmp_path / "log" / name).read_bytes()


def test_the_configuration_makes_the_same_world_again(made: Made) -> None:
    config = load_run_config(str(made[0] / "world.yaml"), str(made[0] / "config.yaml"))
    assert config.world == small_spec().config.world.model_copy(update={"seed": config.world.seed})


def test_tables_hold_what_the_log_holds(made: Made) -> None:
    recording, folder = read_recording(made[0] / "log"), made[0] / "parquet"
    scans, imu = recording.scans[0], recording.imus[0]
    table = read_table(folder / "scans.parquet")
    assert np.array_equal(table["stamp_ns"], scans.stamps_ns)
    assert scans.received_ns is not None
    assert np.array_equal(table["received_ns"], scans.received_ns)
    assert np.array_equal(table["ranges_m"], np.asarray(scans.ranges_m), equal_nan=True)
    table = read_table(folder / "imu.parquet")
    read = joined_axes(table, "angular_velocity_{}_rad_s")
    assert np.array_equal(read, imu.angular_velocity_rad_s)
    table = read_table(folder / "encoders.parquet")
    assert np.array_equal(table["ticks_right"], recording.ticks[0].ticks[:, 1])
    table = read_table(folder / "odometry.parquet")
    assert np.array_equal(joined_axes(table, "position_{}_m"), recording.odometries[0].positions_m)
    table = read_table(folder / "joints.parquet")
    name = recording.joints[0].names[1]
    assert np.array_equal(table[f"{name}_position_rad"], recording.joints[0].positions_rad[:, 1])
    table = read_table(folder / "transforms.parquet")
    assert len(table["stamp_ns"]) == sum(len(edge.stamps_ns) for edge in recording.transforms)


def test_carmen_is_read_back_as_the_log_says(made: Made) -> None:
    ours, log = read_log(made[0] / "carmen" / "log.clf"), read_log(made[0] / "log")
    assert len(ours.scans) == len(log.scans)
    for one, other in zip(ours.scans, log.scans, strict=True):
        assert one.stamp_ns == other.stamp_ns
        assert np.allclose(one.ranges_m, other.ranges_m, atol=1e-6, equal_nan=True)
    assert np.abs(ours.T_base_laser[:2, 3] - log.T_base_laser[:2, 3]).max() < 1e-6
    assert ours.odometry is not None
    assert log.odometry is not None
    within = ours.odometry.stamps_ns[ours.odometry.stamps_ns <= log.odometry.stamps_ns[-1]]
    assert np.abs(ours.odometry.at(within) - log.odometry.at(within)).max() < 2e-6


def test_kitti_clouds_lie_on_the_walls(made: Made) -> None:
    """Points carried by the poses of the file meet the true occupancy, however the robot moved."""
    folder = made[0] / "kitti"
    clouds = sorted((folder / "sequences/00/velodyne").iterdir())
    times_s = np.loadtxt(folder / "sequences/00/times.txt")
    poses = np.loadtxt(folder / "poses/00.txt").reshape(-1, 3, 4)
    rows = [line.split() for line in (folder / "sequences/00/calib.txt").read_text().splitlines()]
    calibration = {name: np.array(values, dtype=float) for name, *values in rows}
    assert len(clouds) == len(times_s) == len(poses)
    T_camera_laser = np.vstack([calibration["Tr:"].reshape(3, 4), [0, 0, 0, 1]])
    truth = read_truth(made[0] / "log")
    assert truth is not None
    T_first = np.linalg.inv(T_camera_laser)
    start = truth.planar().poses[0]
    yaw = start[2]
    scale, image, origin = _occupancy(made[0] / "truth")
    laser = read_log(made[0] / "log").T_base_laser
    on_walls = []
    for number in range(0, len(clouds), 7):
        points = np.fromfile(clouds[number], dtype="<f4").reshape(-1, 4)[:, :3]
        homogeneous = np.column_stack([points, np.ones(len(points))])
        pose = np.vstack([poses[number], [0, 0, 0, 1]])
        inside = (T_first @ pose @ T_camera_laser @ homogeneous.T).T[:, :2] + laser[:2, 3]
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        cells = np.floor((inside @ turn.T + start[:2] - origin) / scale).astype(int)
        solid = np.zeros(len(cells), dtype=bool)
        for x in (-1, 0, 1):
            for y in (-1, 0, 1):
                solid |= image[::-1][cells[:, 1] + y, cells[:, 0] + x] == 0
        on_walls.append(solid.mean())
    assert min(on_walls) > 0.98


def _occupancy(folder: Path) -> tuple[float, GrayImage, FloatArray]:
    facts = yaml.safe_load((folder / "occupancy.yaml").read_text())
    image = read_gray_image(folder / facts["image"])
    return facts["resolution"], image, np.array(facts["origin"][:2])


def test_tum_paths_are_the_truth_and_the_odometry(made: Made) -> None:
    truth, ours = read_truth(made[0] / "log"), read_tum(made[0] / "tum" / "ground_truth.tum")
    assert truth is not None
    assert np.abs(ours.positions_m - truth.at(ours.stamps_ns).positions_m).max() < 1e-3
    published = read_tum(made[0] / "tum" / "odometry.tum")
    odometry = read_recording(made[0] / "log").odometries[0]
    assert np.array_equal(published.stamps_ns, odometry.stamps_ns)


def test_a_damaged_sequence_is_the_log_that_simulate_damages(tmp_path: Path) -> None:
    spec = small_spec("faults=['lidar_gaps','laser_yaw']", formats=("mcap", "parquet"))
    produce(spec, tmp_path / "made")
    names = ("lidar_gaps", "laser_yaw")
    simulate_with_faults(spec.config, [load_fault(name) for name in names], tmp_path / "log")
    one, other = (f / "log_0.mcap" for f in (tmp_path / "made" / "log", tmp_path / "log"))
    assert one.read_bytes() == other.read_bytes()
    log = read_table(tmp_path / "made" / "parquet" / "scans.parquet")
    truth = read_table(tmp_path / "made" / "truth" / "scans.parquet")
    assert 0 < len(log["sample"]) < len(truth["stamp_ns"])
    errors = np.abs(log["ranges_m"] - truth["true_ranges_m"][log["sample"]])
    assert np.median(errors[np.isfinite(errors)]) < 0.01


def test_slam_and_checker_read_the_tables_as_they_read_the_log(made: Made) -> None:
    ours, log = read_log(made[0] / "parquet"), read_log(made[0] / "log")
    assert [s.stamp_ns for s in ours.scans] == [s.stamp_ns for s in log.scans]
    for one, other in zip(ours.scans, log.scans, strict=True):
        assert one.geometry == other.geometry
        assert np.array_equal(one.ranges_m, other.ranges_m, equal_nan=True)
    assert ours.odometry is not None
    assert log.odometry is not None
    assert np.array_equal(ours.odometry.poses, log.odometry.poses)
    assert ours.imu is not None
    assert log.imu is not None
    assert np.array_equal(ours.imu.angular_velocity_rad_s, log.imu.angular_velocity_rad_s)
    assert ours.encoders is not None
    assert log.encoders is not None
    assert np.array_equal(ours.encoders.ticks, log.encoders.ticks)
    assert np.array_equal(ours.T_base_laser, log.T_base_laser)
    assert ours.T_base_imu is not None
    assert log.T_base_imu is not None
    assert np.array_equal(ours.T_base_imu, log.T_base_imu)
    assert (ours.epoch, ours.warnings) == (log.epoch, log.warnings)


def test_a_recording_in_tables_holds_all_that_the_bag_holds(made: Made) -> None:
    ours, bag = (read_recording(made[0] / name) for name in ("parquet", "log"))
    for kind in ("scans", "imus", "odometries", "ticks", "joints", "transforms"):
        for one, other in zip(getattr(ours, kind), getattr(bag, kind), strict=True):
            for name in type(one).__dataclass_fields__:
                if name not in ("samples", "frame_ids", "layouts", "origin"):
                    value, expected = getattr(one, name), getattr(other, name)
                    same = isinstance(expected, str | int | float | tuple | None)
                    assert value == expected if same else np.array_equal(value, expected), name
    assert ours.scans[0].layouts == bag.scans[0].layouts
    assert ours.robot_description == bag.robot_description


def test_tables_that_do_not_name_their_sequence_are_read_alike(made: Made, tmp_path: Path) -> None:
    for path in (made[0] / "parquet").iterdir():
        pq.write_table(pq.read_table(path).drop_columns("sequence"), tmp_path / path.name)
    ours, theirs = read_log(made[0] / "parquet"), read_log(tmp_path)
    for one, other in zip(ours.scans, theirs.scans, strict=True):
        assert (one.stamp_ns, one.geometry) == (other.stamp_ns, other.geometry)
        assert np.array_equal(one.ranges_m, other.ranges_m, equal_nan=True)
    for mine, foreign in ((ours.imu, theirs.imu), (ours.encoders, theirs.encoders)):
        assert mine is not None and foreign is not None
        assert np.array_equal(mine.stamps_ns, foreign.stamps_ns)
    assert np.array_equal(ours.T_base_laser, theirs.T_base_laser)


@pytest.mark.long
def test_a_process_does_not_grow_with_the_sequences_it_makes(tmp_path: Path) -> None:
    def objects_after(number: int) -> int:
        produced(tmp_path / str(number), seconds=3.0)
        gc.collect()
        gc.freeze()  # counts them; a list of them breaks tuples that other threads are building
        try:
            return gc.get_freeze_count()
        finally:
            gc.unfreeze()

    objects_after(0)
    before = objects_after(1)
    more = objects_after(2) - before
    gc.freeze()  # as it was before, see ``conftest.py``
    assert more < 100
