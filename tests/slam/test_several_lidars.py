"""Several planar lidars on one robot: which are used, paired in time, seen from one base."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scan_recording import truth
from simulated import ScanList
from two_lidars import FRONT, HALF_VIEW, REAR, front_and_rear, mounted

from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.core.geometry import between, wrap_angle
from slamsim.core.types import FloatArray, Log, Scan
from slamsim.evaluate.trajectory import compare
from slamsim.recording import RawScans, Recording
from slamsim.recording.choice import choices
from slamsim.recording.cleaning.log import clean
from slamsim.recording.cleaning.scans import paired
from slamsim.slam.failures import Failures
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.laser import estimate
from slamsim.slam.laser.calibration import NAMES, LaserCalibration
from slamsim.slam.laser.estimate import POSES_TOLERANCE_M, laser_of
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.session import odometry_of, run_slam

AHEAD = np.array([0.1, 0.0, 0.0])
"""(3,) of a point ahead of the axle, by more than any tolerance."""

INSTANTS = st.lists(st.integers(0, 3000), max_size=30, unique=True).map(sorted)


def cleaned(recording: Recording) -> Log:
    return clean(recording, Path("two_lidars.mcap"))


@given(own=INSTANTS.filter(bool), other=INSTANTS)
def test_pairs_are_those_of_a_search_through_all(own: list[int], other: list[int]) -> None:
    usual = float(np.median(np.diff(own))) if len(own) > 1 else 0.0
    owner = [min(range(len(own)), key=lambda i: (abs(o - own[i]), i)) for o in other]
    wanted = []
    for number, instant in enumerate(own):
        mine = [k for k, o in enumerate(other) if owner[k] == number and abs(o - instant) <= usual]
        wanted.append(min(mine, key=lambda k: (abs(other[k] - instant), -k), default=-1))
    found = paired(np.array(own, dtype=np.int64), np.array(other, dtype=np.int64))
    assert found.tolist() == wanted


def test_each_scan_comes_with_the_other_lidars_nearest_one() -> None:
    log = cleaned(front_and_rear())
    np.testing.assert_allclose(log.T_base_laser[:2, 3], FRONT[:2])
    for scan in log.scans:
        (other,) = scan.beside
        assert abs(other.scan.stamp_ns - scan.stamp_ns) <= 50_000_000
        np.testing.assert_allclose(other.T_base_laser[:2, 3], REAR[:2])
    assert log.warnings == ()


def test_a_cloud_of_two_is_the_clouds_of_each() -> None:
    log, motion = cleaned(front_and_rear()), truth()
    scan = list(log.scans)[40]
    (other,) = scan.beside
    both = deskew(scan, motion, scan.stamp_ns, log.T_base_laser)
    alone = deskew(replace(scan, beside=()), motion, scan.stamp_ns, log.T_base_laser)
    rear = deskew(other.scan, motion, scan.stamp_ns, other.T_base_laser)
    assert both.own_beams == len(alone.points_m)
    np.testing.assert_array_equal(both.points_m, [*alone.points_m, *rear.points_m])
    np.testing.assert_array_equal(both.origins_m, [*alone.origins_m, *rear.origins_m])


def test_scans_beside_one_are_left_out_where_the_motion_does_not_reach() -> None:
    scan = next(iter(cleaned(front_and_rear()).scans))
    (other,) = scan.beside
    late = replace(scan, beside=(replace(other, scan=replace(other.scan, stamp_ns=scan.end_ns)),))
    assert late.span_ns == (scan.stamp_ns, scan.end_ns + other.scan.geometry.duration_ns)
    known = late.within(scan.stamp_ns, scan.end_ns)
    assert known is not None
    assert known.beside == ()
    assert late.within(*late.span_ns) is not None
    assert late.within(scan.stamp_ns + 1, late.span_ns[1]) is None


@pytest.mark.long
def test_two_lidars_see_behind_the_robot_what_one_does_not() -> None:
    """Half a view in front ends at the robot; with the other half the walls behind it are seen."""
    both = cleaned(front_and_rear(HALF_VIEW))
    front = replace(both, scans=ScanList([replace(scan, beside=()) for scan in both.scans]))
    errors_m, walls = [], []
    for log in (front, both):
        way = run_slam(log, SlamConfig(calibrate_laser=False)).trajectory
        errors_m.append(float(np.hypot.reduce(compare(way, truth()).translation_m)))
        first = ScanList([next(iter(log.scans))])
        seen = build_grid(first, way, log.T_base_laser, MappingConfig())
        walls.append(np.count_nonzero(seen.occupancy > 0.5))
    assert errors_m[1] < errors_m[0]
    assert walls[1] > 1.5 * walls[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("one frame", "their lidar sits where that of /front/scan does, or is the same one"),
        ("one place", "their lidar sits where that of /front/scan does, or is the same one"),
        ("no transform", "no fixed transform from 'base_footprint' to 'rear_laser'"),
        ("on its side", "the frame 'rear_laser' is not level"),
        ("another day", "no time in common with /front/scan"),
        ("no lidar", "none of 200 scans describes a lidar"),
    ],
)
def test_a_lidar_that_cannot_be_used_is_named_with_the_reason(change: str, words: str) -> None:
    recording = front_and_rear()
    front, rear = recording.scans
    edges = {edge.child: edge for edge in recording.transforms}
    if change == "one frame":
        rear = replace(rear, frame_ids=front.frame_ids)
    elif change == "one place":
        edges["rear_laser"] = replace(edges["front_laser"], child="rear_laser")
    elif change == "no transform":
        del edges["rear_laser"]
    elif change == "on its side":
        turned = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
        edges["rear_laser"] = replace(edges["rear_laser"], quats_xyzw=turned)
    elif change == "another day":
        rear = replace(rear, stamps_ns=rear.stamps_ns + 86_400 * 10**9)
    else:
        rear = replace(rear, layouts=(replace(rear.layouts[0], angle_step_rad=0.0),))
    changed = recording.with_streams(RawScans, (front, rear))
    changed = replace(changed, transforms=tuple(edges.values()))
    log = cleaned(changed)
    assert all(scan.beside == () for scan in log.scans)
    if change not in ("another day", "no lidar"):  # which only the scans themselves tell
        (scans,) = (choice for choice in choices(changed) if choice.what == "scans")
        assert scans.topics == ("/front/scan",)
    (told,) = log.warnings
    assert told.startswith("the scans of /rear/scan are not used: ")
    assert words in told


def declared(front: FloatArray, rear: FloatArray) -> Log:
    """Lidars that sit at FRONT and REAR, declared there."""
    recording = front_and_rear(rear=rear)
    moved = {"front_laser": mounted(front, "front_laser")}
    edges = tuple(moved.get(edge.child, edge) for edge in recording.transforms)
    return cleaned(replace(recording, transforms=edges))


def mounts_corrected(log: Log, failures: Failures) -> list[list[bool]]:
    """Which of x, y and yaw, of the front lidar and then of the rear one."""
    found = laser_of(log, odometry_of(log), SlamConfig(), failures)
    return [one.corrected[3:6].tolist() for one in (found, *found.beside.values())]


def test_where_one_lidar_is_at_the_origin_none_is_moved() -> None:
    """The poses are of the axle all the same: the mount of the other is plainly contradicted."""
    failures, origin = Failures(), np.zeros(3)
    turned = np.array([0.0, 0.0, FRONT[2]])
    for front, rear in (
        (origin, between(FRONT, REAR)),
        (turned, REAR - FRONT + turned),
        (between(REAR, FRONT), origin),
    ):
        assert not np.any(mounts_corrected(declared(front, rear), failures))
    assert not list(failures)


@pytest.mark.parametrize("seen", [40, 140, 200])
def test_where_one_lidar_is_hardly_seen_none_is_moved(seen: int) -> None:
    """40 scans of the rear tell nothing of its mount, 140 to 5 cm, 200 to 3 mm."""
    log = declared(FRONT - AHEAD, REAR - AHEAD)
    scans = [
        scan if number < seen else replace(scan, beside=()) for number, scan in enumerate(log.scans)
    ]
    wrong = [seen == 200, False, False]
    assert mounts_corrected(replace(log, scans=ScanList(scans)), Failures()) == [wrong, wrong]


def test_where_one_lidar_is_moved_the_other_follows_within_the_tolerance() -> None:
    """In the same direction alone: 3 cm to the side, which is found to 3 mm, is left."""
    one, other = POSES_TOLERANCE_M + 0.01, POSES_TOLERANCE_M - 0.01
    for front_m, rear_m in ((one, other), (other, one)):
        log = declared(FRONT - [front_m, 0.03, 0.0], REAR - [rear_m, 0.03, 0.0])
        assert mounts_corrected(log, Failures()) == 2 * [[True, False, False]]


class ReadingsCounted(ScanList):
    times = 0

    def __iter__(self) -> Iterator[Scan]:
        self.times += 1
        return super().__iter__()


def test_however_many_lidars_are_calibrated_a_log_is_read_twice() -> None:
    log = cleaned(front_and_rear())
    scans = ReadingsCounted(list(log.scans))
    found = laser_of(replace(log, scans=scans), odometry_of(log), SlamConfig(), Failures())
    assert np.isfinite([found.sigmas, found.beside["/rear/scan"].sigmas]).all()
    assert scans.times == 2


def test_what_is_found_of_a_further_lidar_is_told_under_its_topic() -> None:
    result = run_slam(cleaned(front_and_rear()), SlamConfig())
    (topic,) = result.calibration_beside
    found = result.calibration_beside[topic]
    assert topic == "/rear/scan"
    assert list(found) == list(NAMES)
    for name, true in zip(NAMES[3:6], REAR, strict=True):
        assert abs(wrap_angle(found[name].value - true)) < 4.0 * found[name].sigma
        assert result.calibration[name].value != found[name].value


def test_where_one_lidar_fails_the_other_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    real = estimate._with_mount

    def fails_of_the_rear(found: LaserCalibration, *args: Any, **named: Any) -> LaserCalibration:
        if found.declared[3] < 0.0:
            raise ValueError("no such lidar")
        return real(found, *args, **named)

    monkeypatch.setattr(estimate, "_with_mount", fails_of_the_rear)
    failures = Failures()
    assert mounts_corrected(declared(FRONT - AHEAD, REAR - AHEAD), failures) == [3 * [False]]
    assert [failed.stage for failed in failures] == ["laser calibration"]
