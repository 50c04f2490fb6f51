"""Scans cut out of point clouds: those of the planar lidar that the clouds were made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import START_NS
from cloud_bags import (
    LEVEL_RING,
    ROBOT,
    SENSOR_HEIGHT_M,
    TURNING,
    as_messages,
    bag_of,
    cloud,
    rings_of,
    sensed,
    slab_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_recording import truth, world
from simulated import ate_rmse_m, true_ranges

from slamsim.config.loading import load_run_config
from slamsim.core.geometry import matrix_from_rpy, transform_points, xyzw_from_matrix
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry, Trajectory
from slamsim.guard.errors import InputRefused, OverrideRefused, SlamsimError
from slamsim.io.open import open_recording, read_log, read_recording, survey_recording
from slamsim.io.ros.clouds import UnusableClouds, points_of
from slamsim.io.selection import Selection
from slamsim.recording import RawScans
from slamsim.recording.clouds import CloudSlicer, Place
from slamsim.recording.sweeps import Points
from slamsim.run.info import missing
from slamsim.slam.session import run_slam

FEW = 12
LATE_START = replace(TURNING, angle_min_rad=0.5 * np.pi)


def ends_of(scan: Scan) -> FloatArray:
    angles, ranges_m = scan.geometry.angles_rad(), scan.ranges_m.astype(np.float64)
    ends = np.column_stack([ranges_m * np.cos(angles), ranges_m * np.sin(angles)])
    return np.asarray(ends[np.isfinite(ends).all(axis=1)])


def off_m(found: Scan, true: Scan) -> FloatArray:
    """From each end of a beam to the nearest one of the true scan."""
    ends, theirs = ends_of(found), ends_of(true)
    return np.asarray(np.linalg.norm(ends[:, None] - theirs[None], axis=2).min(axis=1))


@pytest.mark.parametrize(("times", "unit"), [("s", "in s"), ("ns", "in ns"), ("absolute", "in s")])
def test_a_level_ring_is_the_planar_lidar_that_it_was_made_of(
    tmp_path: Path, times: Any, unit: str
) -> None:
    scans = sensed()[:FEW]
    clouds = as_messages([rings_of(scan, times) for scan in scans])
    opened = open_recording(bag_of(tmp_path / "a.mcap", clouds))
    log = opened.log()
    assert len(log.scans) == FEW
    for found, true in zip(log.scans, scans, strict=True):
        assert abs(found.stamp_ns - START_NS - true.stamp_ns) < 1_000_000
        assert found.geometry.beam_count == TURNING.beam_count
        assert found.geometry.beam_dt_ns == pytest.approx(TURNING.beam_dt_ns, rel=2e-3)
        np.testing.assert_allclose(found.ranges_m, true.ranges_m, rtol=1e-4)
        turned = found.geometry.angles_rad() - true.geometry.angles_rad()
        np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-9)
    assert f"ring {LEVEL_RING} of 6, +0.2 deg, 0.5 deg a beam" in log.sources
    assert unit in log.sources and "\n" not in log.sources


def test_a_lidar_that_turns_clockwise_keeps_the_time_of_each_beam(tmp_path: Path) -> None:
    backward = TURNING.__class__(np.pi, -np.deg2rad(0.5), 720, TURNING.beam_dt_ns, 0.1, 30.0)
    scans = sensed(backward)[:FEW]
    clouds = as_messages([rings_of(scan) for scan in scans])
    for found, true in zip(read_log(bag_of(tmp_path / "a.mcap", clouds)).scans, scans, strict=True):
        assert found.geometry.angle_step_rad == pytest.approx(-np.deg2rad(0.5))
        np.testing.assert_allclose(found.ranges_m, true.ranges_m, rtol=1e-4)


def test_a_slab_keeps_off_the_floor_and_takes_the_nearest(tmp_path: Path) -> None:
    scans = sensed()[:FEW]
    clouds = as_messages([slab_of(scan, i) for i, scan in enumerate(scans)])
    log = read_log(bag_of(tmp_path / "a.mcap", clouds))
    for found, true in zip(log.scans, scans, strict=True):
        seen = np.isfinite(found.ranges_m)
        assert seen.sum() > 0.5 * TURNING.beam_count
        assert np.quantile(off_m(found, true), 0.99) < 0.05
    assert "heights 0.20 to 0.80 m above base_footprint" in log.sources
    assert "no time of the points: each cloud counts as one instant" in log.sources


def test_columns_that_lie_wider_apart_are_beams_of_their_width(tmp_path: Path) -> None:
    """No beam in between, which would never return anything; columns closer than half a degree
    stay in steps of half a degree, and without order nine steps of ten are no wider than a beam."""
    for count, random, beams in (
        (360, 0.0, 360),
        (1440, 0.0, 720),
        (1440, 1.0, 720),
        (360, 1.0, 226),
    ):
        geometry = ScanGeometry(-np.pi, 2.0 * np.pi / count, count, 0, 0.1, 30.0)
        jitter = np.random.default_rng(1).uniform(-0.5, 0.5, (FEW, count)) * random
        clouds = []
        for scan, off in zip(sensed(geometry)[:FEW], jitter, strict=True):
            angles = geometry.angles_rad() + off * geometry.angle_step_rad
            xy = scan.ranges_m.astype(np.float64) * np.array([np.cos(angles), np.sin(angles)])
            columns = np.tile(np.vstack([xy, np.zeros(count)]), 3)
            columns[2] += np.repeat([-0.1, 0.0, 0.1], count)
            clouds.append(cloud(START_NS + scan.stamp_ns, dict(zip("xyz", columns, strict=True))))
        log = read_log(bag_of(tmp_path / f"{count}{random}.mcap", as_messages(clouds)))
        (found,) = {scan.geometry.beam_count for scan in log.scans}
        assert abs(found - beams) <= 15 * (random > 0.0 and beams < 720)


CAMERA = Place("camera", "base_link", np.eye(4))
COLUMNS = np.arctan((np.arange(106) - 52.5) / 56.0)
"""Of a depth camera that sees 87 degrees, thinned to 106 columns: 1.0 degree apart in the middle,
0.5 at the edges."""


def cut(clouds: list[FloatArray], place: Place = CAMERA) -> RawScans:
    """The scans of clouds (n, 3)."""
    slicer = CloudSlicer("/points", place, None)
    slicer.add([Points(number, number, xyz_m) for number, xyz_m in enumerate(clouds)])
    return slicer.stream()


def wall_m(angles_rad: FloatArray, lean: float, away_m: float = 3.0) -> FloatArray:
    """(n,) range of the wall x + lean * y = away_m."""
    return np.asarray(away_m / (np.cos(angles_rad) + lean * np.sin(angles_rad)))


def columns_of(ranges_m: FloatArray, angles_rad: FloatArray, rows: int = 3) -> FloatArray:
    """(n, 3) points in these directions, in rows at other heights."""
    xy_m = ranges_m[:, None] * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    heights_m = np.repeat(np.linspace(-0.1, 0.1, rows), len(angles_rad))
    return np.column_stack([np.tile(xy_m, (rows, 1)), heights_m])


def angles_of(scans: RawScans) -> FloatArray:
    (layout,) = scans.layouts
    return np.asarray(
        layout.angle_min_rad + np.arange(len(scans.ranges_m[0])) * layout.angle_step_rad
    )


@given(lean=st.floats(-0.5, 0.5), turn_rad=st.floats(-3.0, 3.0))
@settings(max_examples=30)
def test_ranges_are_those_of_the_beams_and_not_of_what_lies_beside_them(
    lean: float, turn_rad: float
) -> None:
    """Of a wall that no beam meets at less than 20 degrees."""
    cloud_m = columns_of(wall_m(COLUMNS, lean), COLUMNS)
    cloud_m[:, :2] = transform_points(np.array([0.0, 0.0, turn_rad]), cloud_m[:, :2])

    scans = cut([cloud_m])

    inner = slice(1, -1)  # before the first column and after the last there is nothing to go by
    truth_m = wall_m(angles_of(scans) - turn_rad, lean)
    assert np.isfinite(scans.ranges_m[0]).mean() > 0.97
    assert np.nanmax(np.abs(scans.ranges_m[0] - truth_m)[inner]) < 3e-3


def test_no_range_lies_between_a_thing_and_the_wall_behind_it() -> None:
    ranges_m = np.where(np.abs(COLUMNS) < 0.2, 1.0, 3.0)

    (row,) = cut([columns_of(ranges_m, COLUMNS)]).ranges_m

    assert np.all((np.abs(row - 1.0) < 0.01) | (np.abs(row - 3.0) < 0.05) | np.isnan(row))


def test_noise_makes_no_wall_nearer() -> None:
    """The nearest of five returns with 20 mm of noise is 23 mm too near."""
    rng, angles = np.random.default_rng(2), np.deg2rad(np.arange(-180.0, 180.0, 0.5))
    true_m, rows = np.full(len(angles), 4.0), 5
    clouds = []
    for _ in range(FEW):
        cloud_m = columns_of(true_m, angles, rows)
        cloud_m[:, :2] *= 1.0 + rng.normal(0.0, 0.02, (len(cloud_m), 1)) / 4.0
        clouds.append(cloud_m)

    scans = cut(clouds)

    assert abs(np.nanmean(scans.ranges_m) - 4.0) < 0.002


def test_heights_that_are_asked_for_count_even_with_rings(tmp_path: Path) -> None:
    clouds = as_messages([rings_of(scan) for scan in sensed()[:FEW]])
    path = bag_of(tmp_path / "a.mcap", clouds)
    low = read_log(path, Selection(cloud_height_m=(-0.05, 0.05)))
    assert "heights -0.05 to 0.05 m above base_footprint" in low.sources
    floor_m = [SENSOR_HEIGHT_M / np.tan(np.deg2rad(angle)) for angle in (4.0, 8.0, 12.0)]
    for scan in low.scans:
        ranges_m = scan.ranges_m[np.isfinite(scan.ranges_m)]
        assert np.abs(ranges_m[:, None] - floor_m).min(axis=1).max() < 0.5


@pytest.mark.long
@pytest.mark.parametrize("rpy_deg", [(0.0, 12.0, 0.0), (180.0, 0.0, 30.0), (5.0, -8.0, 90.0)])
def test_a_sensor_that_leans_is_levelled(tmp_path: Path, rpy_deg: tuple[float, ...]) -> None:
    R_base_sensor = matrix_from_rpy(*np.deg2rad(rpy_deg).tolist())
    scans = sensed()[:FEW]
    clouds = as_messages([rings_of(scan, "s", R_base_sensor.T) for scan in scans])
    quat = tuple(xyzw_from_matrix(R_base_sensor).tolist())
    recording = read_recording(bag_of(tmp_path / "a.mcap", clouds, quat))
    assert recording.scans[0].frame_ids == ("velodyne_level",)
    log = read_log(tmp_path / "a.mcap")
    np.testing.assert_allclose(log.T_base_laser[2, :3], [0.0, 0.0, 1.0], atol=1e-9)
    yaw = np.arctan2(log.T_base_laser[1, 0], log.T_base_laser[0, 0])
    for found, true in zip(log.scans, scans, strict=True):
        angles = found.geometry.angles_rad() + yaw
        at = np.rint((angles - true.geometry.angle_min_rad) / np.deg2rad(0.5)).astype(int) % 720
        there = np.isfinite(found.ranges_m)
        np.testing.assert_allclose(found.ranges_m[there], true.ranges_m[at][there], rtol=0.02)
        assert there.sum() > 600


@pytest.mark.parametrize("kind", ["rings", "slab"])
def test_a_robot_with_clouds_alone_is_mapped(tmp_path: Path, kind: str) -> None:
    scans = sensed()
    clouds = [rings_of(s) if kind == "rings" else slab_of(s, i) for i, s in enumerate(scans)]
    log = read_log(bag_of(tmp_path / "a.mcap", as_messages(clouds)))
    config = load_run_config("tiny", None, ("slam.calibrate_laser=false",), None)
    result = run_slam(log, config.slam)
    path = truth()
    true = PlanarTrajectory(path.stamps_ns + START_NS, path.poses)
    found = result.trajectory
    assert ate_rmse_m(found, true) < (0.005 if kind == "rings" else 0.03)


def test_points_in_order_show_where_a_turn_begins(tmp_path: Path) -> None:
    """Without times of the points: SLAM can estimate how long a turn lasts only so."""
    scans = sensed()[:FEW]
    clouds = [rings_of(replace(scan, geometry=LATE_START), "") for scan in scans]
    log = read_log(bag_of(tmp_path / "a.mcap", as_messages(clouds)))
    for found in log.scans:
        assert found.geometry.angle_min_rad == pytest.approx(LATE_START.angle_min_rad, abs=1e-3)
        assert found.geometry.beam_dt_ns == 0


@pytest.mark.parametrize("count", [360, 180])
def test_points_in_no_order_are_told_where_they_hide_how_long_a_turn_lasts(count: int) -> None:
    """A camera that sees half a turn measures all at once."""
    angles_rad = np.deg2rad(np.arange(count) - 90.0)
    ordered = [columns_of(np.full(count, 3.0), angles_rad) for _ in range(FEW)]
    shuffled = [np.random.default_rng(1).permutation(each) for each in ordered]
    by_place = [each[np.lexsort(np.round(each[:, ::-1].T / 0.1))] for each in ordered]
    hides = count == 360
    for clouds, hidden in ((ordered, False), (shuffled, hides), (by_place, hides)):
        found = cut(clouds)
        assert ("no order" in found.note) is hidden
        assert found.in_order is not hidden


@pytest.mark.parametrize("turns", [True, False])
def test_times_of_a_rosette_put_its_points_in_no_order(turns: bool) -> None:
    angles_rad = np.deg2rad(np.arange(360) - 90.0)
    times_s = np.linspace(0.0, 0.1, 360)
    times_s = times_s if turns else np.random.default_rng(1).permutation(times_s)
    slicer = CloudSlicer("/points", CAMERA, None)
    xyz_m = columns_of(np.full(360, 3.0), angles_rad)
    times_s = np.repeat(times_s, len(xyz_m) // 360)
    slicer.add([Points(n * 10**8, n * 10**8, xyz_m, time=times_s) for n in range(3)])
    assert slicer.stream().in_order is turns


ROSETTE = tuple(
    replace(
        TURNING,
        angle_min_rad=np.deg2rad(-180.0 + 0.5 * turn),
        angle_step_rad=np.deg2rad(5.0 * (-1) ** turn),
        beam_count=72,
    )
    for turn in range(10)
)
"""Ten turns in a tenth of a second, to and fro, each of them half a degree beside the last."""
HEIGHTS_M = np.arange(-2.0, 2.01, 0.1)


def walls_seen(
    path: PlanarTrajectory, stamp_ns: int, turns: Sequence[ScanGeometry]
) -> tuple[FloatArray, FloatArray]:
    """((n, 3) places up and down on the walls that are seen, (n,) seconds after the stamp)."""
    ends_m, after_s, begin_ns = [], [], 0
    for turn in turns:
        ranges_m = true_ranges(world()[0], path, stamp_ns + begin_ns, turn)
        ends_m.append(ends_of(Scan(0, ranges_m.astype(np.float32), turn)))
        after_s.append(1e-9 * (begin_ns + turn.offsets_ns()[np.isfinite(ranges_m)]))
        begin_ns += turn.beam_count * turn.beam_dt_ns
    xy_m = np.repeat(np.concatenate(ends_m), len(HEIGHTS_M), axis=0)
    xyz_m = np.column_stack([xy_m, np.tile(HEIGHTS_M, len(xy_m) // len(HEIGHTS_M))])
    return xyz_m, np.repeat(np.concatenate(after_s), len(HEIGHTS_M))


def off_walls_m(found: Scan, path: PlanarTrajectory, stamp_ns: int) -> FloatArray:
    """(k,) by how much its ranges are off those seen from where the path is at a stamp."""
    at_once = replace(found.geometry, beam_dt_ns=0)
    off_m = found.ranges_m - true_ranges(world()[0], path, stamp_ns, at_once)
    return np.abs(off_m[np.isfinite(off_m)])


@pytest.mark.parametrize("by_transforms", [False, True])
def test_a_rosette_is_seen_from_the_middle_of_its_cloud(
    tmp_path: Path, by_transforms: bool
) -> None:
    """The robot turns by up to 9 degrees meanwhile."""
    clouds, stamps_ns = [], [172 * 10**8 + number * 10**8 for number in range(FEW)]
    for stamp_ns in stamps_ns:
        xyz_m, after_s = walls_seen(truth(), stamp_ns, ROSETTE)
        columns = dict(zip("xyz", xyz_m.T, strict=True)) | {"offset_time": np.rint(1e9 * after_s)}
        clouds.append(cloud(START_NS + stamp_ns, columns, {"offset_time": "u4"}))
    log = read_log(bag_of(tmp_path / "a.mcap", as_messages(clouds), by_transforms=by_transforms))
    assert "as one instant, the middle one; moved there by odometry" in log.sources
    for found, stamp_ns in zip(log.scans, stamps_ns, strict=True):
        middle_ns = stamp_ns + 50_000_000
        assert abs(found.stamp_ns - START_NS - middle_ns) < 500_000
        assert np.quantile(off_walls_m(found, truth(), middle_ns), 0.9) < 0.02


@pytest.mark.parametrize("turns", [(TURNING,), ROSETTE, (replace(TURNING, beam_dt_ns=0),)])
def test_a_robot_that_leans_has_level_scans(turns: Sequence[ScanGeometry]) -> None:
    """It stands and rocks by 5 degrees twice a second; the sensor sits ahead and above."""
    standing = PlanarTrajectory(np.array([0, 10**10]), np.tile(truth().poses[100], (2, 1)))
    place = Place("lidar", "base_link", np.eye(4))
    place.T_base_sensor[:3, 3] = arm_m = np.array([0.3, 0.0, 0.2])

    def leaning(at_s: FloatArray) -> FloatArray:
        lean_rad = np.deg2rad(5.0) * np.sin(4.0 * np.pi * at_s)
        return np.array([matrix_from_rpy(0.5 * one, one, 0.7) for one in lean_rad.tolist()])

    asked_s = np.arange(0.0, 2.0, 0.005)
    quats_xyzw = np.array([xyzw_from_matrix(one) for one in leaning(asked_s)])
    positions_m = np.tile([3.0, -2.0, 0.4], (len(asked_s), 1))
    path = Trajectory(np.rint(1e9 * asked_s).astype(np.int64), positions_m, quats_xyzw)
    clouds = []
    for stamp_ns in range(0, FEW * 10**8, 10**8):
        xyz_m, after_s = walls_seen(standing, stamp_ns, turns)
        R_base_upright = np.swapaxes(leaning(1e-9 * stamp_ns + after_s), 1, 2)
        R_base_upright = R_base_upright @ matrix_from_rpy(0.0, 0.0, 0.7)
        leant_m = np.einsum("nij,nj->ni", R_base_upright, xyz_m + arm_m) - arm_m
        clouds.append(Points(stamp_ns, stamp_ns, leant_m, time=after_s))
    slicer = CloudSlicer("/points", place, (0.1, 0.3), path)
    slicer.add(clouds)
    assert slicer.note.endswith("levelled by odometry")
    scans = slicer.stream()
    for number, ranges_m in enumerate(scans.ranges_m):
        layout, beams = scans.layout(number), len(ranges_m)
        found = replace(
            turns[0],
            angle_min_rad=layout.angle_min_rad,
            angle_step_rad=layout.angle_step_rad,
            beam_count=beams,
        )
        off_m = off_walls_m(Scan(0, ranges_m, found), standing, 0)
        assert off_m.size > 0.9 * beams
        assert np.quantile(off_m, 0.9) < 0.01


def test_channels_that_fire_together_at_other_azimuths_are_in_order() -> None:
    angles_rad = np.deg2rad(np.arange(360) - 90.0)
    near, far = (columns_of(np.full(360, 3.0), angles_rad + off) for off in (0.0, np.deg2rad(3.0)))
    together = np.stack([near, far], axis=1).reshape(-1, 3)
    assert "no order" not in cut([together] * FEW).note


def test_survey_tells_what_is_cut_and_lacks_nothing(tmp_path: Path) -> None:
    clouds = as_messages([rings_of(scan) for scan in sensed()[:FEW]])
    survey = survey_recording(bag_of(tmp_path / "a.mcap", clouds))
    assert [scans.topic for scans in survey.sample.scans] == ["/points"]
    assert {topic.topic: topic.frames for topic in survey.topics}["/points"] == ("velodyne",)
    assert not [each for each in missing(survey) if each.what == "no scans"]


def test_clouds_beside_scans_are_read_only_if_asked_for(tmp_path: Path) -> None:
    clouds = as_messages([rings_of(scan) for scan in sensed()[:FEW]])
    path = bag_of(tmp_path / "a.mcap", [*clouds, *ROBOT.scans()])
    assert "scans from /front/scan" in read_log(path).sources
    assert "scans from /points (cut out" in read_log(path, Selection(("points",))).sources
    with pytest.raises(OverrideRefused, match=r"--cloud-height: no scans of .* are cut"):
        read_log(path, Selection(cloud_height_m=(0.0, 1.0)))


@pytest.mark.parametrize(
    ("fields", "kinds", "told"),
    [
        ({"x": [1.0], "y": [2.0]}, {}, "/points: a point cloud without x, y and z: .* are x, y"),
        ({"x": [1.0], "y": [2.0], "z": [0.0]}, {"x": "i2"}, "field x of its points is of datatype"),
        (
            {"x": [1.0], "y": [2.0], "z": [9.0]},
            {},
            r"none of its first 1 clouds .* heights 0.20 to 0.80 m",
        ),
    ],
)
def test_clouds_of_which_no_scans_can_be_made_are_refused_in_one_sentence(
    tmp_path: Path, fields: dict[str, list[float]], kinds: dict[str, str], told: str
) -> None:
    columns = {name: np.array(values) for name, values in fields.items()}
    message = cloud(START_NS, columns, kinds)
    path = bag_of(tmp_path / "a.mcap", [("/points", START_NS, message)])
    with pytest.raises(InputRefused, match=told) as refusal:
        read_log(path)
    assert refusal.value.exit_code == 3 and "\n" not in str(refusal.value)


def test_a_cloud_with_too_few_bytes_is_counted_and_the_others_are_read(tmp_path: Path) -> None:
    clouds = [rings_of(scan) for scan in sensed()[:FEW]]
    clouds[3].data = clouds[3].data[:-7]
    log = read_log(bag_of(tmp_path / "a.mcap", as_messages(clouds)))
    assert len(log.scans) == FEW - 1
    assert any("1 of 12 clouds cannot be used (a cloud of 1 x" in words for words in log.warnings)


def test_what_is_cut_out_of_clouds_cannot_be_written_back(tmp_path: Path) -> None:
    from slamsim.io.copy.recording import copy_recording
    from slamsim.recording import RawOdometry, RawScans

    clouds = as_messages([rings_of(scan) for scan in sensed()[:FEW]])
    path = bag_of(tmp_path / "a.mcap", clouds)
    read = read_recording(path)
    scans = read.scans[0]
    moved = read.with_streams(RawScans, [_later(scans)])
    with pytest.raises(SlamsimError, match="scans of /points are cut out of point clouds"):
        copy_recording(path, read, moved, tmp_path / "scans")
    odometry = read.with_streams(RawOdometry, [_later(read.odometries[0])])
    copied = copy_recording(path, read, odometry, tmp_path / "odometry")
    assert copied is not None
    again = read_recording(tmp_path / "odometry")
    np.testing.assert_array_equal(again.scans[0].stamps_ns, scans.stamps_ns)
    assert again.odometries[0].stamps_ns[0] == read.odometries[0].stamps_ns[0] + 1000


def _later(stream: Any) -> Any:
    from dataclasses import replace

    return replace(stream, stamps_ns=stream.stamps_ns + 1000)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_points_are_those_of_a_plain_loop(data: st.DataObject) -> None:
    """Any order of fields, either order of bytes, rows with padding, points that are none."""
    height, width = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 5))
    values = st.sampled_from([np.nan, np.inf, 0.0, 1.5, -2.25, 1e-3])
    names = data.draw(st.permutations(["x", "y", "z", "ring", "t", "other"]))
    columns = {name: np.array([data.draw(values) for _ in range(height * width)]) for name in names}
    columns["ring"] = np.arange(float(height * width))
    columns["t"] = 7.0 * np.arange(height * width)
    kinds = {"x": data.draw(st.sampled_from(["f4", "f8"])), "ring": "u2", "t": "u4"}
    big, padding = data.draw(st.booleans()), data.draw(st.integers(0, 9))
    found = points_of(
        cloud(START_NS, columns, kinds, height=height, padding=padding, big=big), received_ns=5
    )
    wanted = [
        (columns["x"][i], columns["y"][i], columns["z"][i], i, 7 * i)
        for i in range(height * width)
        if all(np.isfinite(columns[axis][i]) for axis in "xyz")
        and any(columns[axis][i] for axis in "xyz")
    ]
    assert found.ring is not None and found.time is not None
    mine = [*zip(*found.xyz_m.T.tolist(), found.ring.tolist(), found.time.tolist(), strict=True)]
    np.testing.assert_allclose(mine, wanted, rtol=1e-6) if wanted else None
    assert len(mine) == len(wanted)


def test_a_field_beyond_its_point_is_refused() -> None:
    message = cloud(START_NS, {axis: np.zeros(3) for axis in "xyz"})
    message.fields[2].offset = 9
    with pytest.raises(UnusableClouds, match="field z ends at byte 13 of points of 12"):
        points_of(message, 0)
