"""``clean``: what a Log says of a Recording, beside slow or exact answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_data import edge, odometry_at, recording, scans_at, stamps

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts, xyzw_from_yaw
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused
from slamsim.recording import (
    RawOdometry,
    RawScans,
    RecordedTopic,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.cleaning.log import clean
from slamsim.recording.frames import FrameTree

SOURCE = Path("a.mcap")
NAMES = ("odom", "base", "laser", "imu")


def _message_by_message(edges: list[TransformEdge]) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """(T_parent_child of frames that never moved, parents of those that did), the slow way."""
    rows = [
        (stamp_ns, number, row)  # received when stamped
        for number, each in enumerate(edges)
        for row, stamp_ns in enumerate(each.stamps_ns.tolist())
    ]
    fixed: dict[str, tuple[str, FloatArray]] = {}
    moving: dict[str, str] = {}
    for _, number, row in sorted(rows):
        one = edges[number]
        if one.child in moving or one.parent == one.child:
            continue
        T = se3_from_parts(matrix_from_xyzw(one.quats_xyzw[row]), one.positions_m[row])
        known = fixed.setdefault(one.child, (one.parent, T))
        if known[0] != one.parent or np.abs(known[1] - T).max() > 1e-4:
            moving[one.child] = one.parent
            del fixed[one.child]
    return {child: T for child, (_, T) in fixed.items()}, moving


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_the_tree_of_whole_edges_is_that_of_single_messages(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = []
    for _ in range(int(rng.integers(1, 6))):
        parent, child = (NAMES[i] for i in sorted(rng.integers(0, len(NAMES), 2)))  # no loop
        count = int(rng.integers(1, 5))
        positions_m = rng.choice([0.0, 1.0], (count, 3), p=[0.95, 0.05])
        quats_xyzw = xyzw_from_yaw(rng.choice([0.0, 0.5], count, p=[0.9, 0.1]))
        received_ns = np.sort(rng.integers(0, 1000, count))
        edges.append(
            TransformEdge(
                *("/tf", parent, child, False, received_ns, received_ns),
                *(positions_m, quats_xyzw),
            )
        )
    if len({int(t) for e in edges for t in e.stamps_ns}) < sum(e.stamps_ns.size for e in edges):
        return  # of messages received at once the order is not known
    fixed, moving = _message_by_message(edges)

    tree = FrameTree()
    tree.add(edges)

    for name in NAMES:
        path = tree.path_up(name)
        assert bool(path) == (name in fixed or name in moving)
        if path:
            assert path[0][2] == (name in moving)
        if name in moving:
            assert path[0][0] == moving[name]
        if name in fixed:
            found = tree.between(path[0][0], name)
            assert found is not None
            np.testing.assert_allclose(found, fixed[name], atol=1e-12)


def test_headings_of_a_format_hold_as_long_as_its_quaternions_do() -> None:
    raw = recording(5.0)
    (moved,) = raw.odometries
    yaws_rad = np.linspace(-3.0, 3.0, len(moved))
    exact = replace(moved, yaws_rad=yaws_rad, quats_xyzw=xyzw_from_yaw(yaws_rad))
    turned = replace(exact, quats_xyzw=xyzw_from_yaw(yaws_rad / 2))

    paths = [
        clean(raw.with_streams(RawOdometry, [each]), SOURCE).odometry for each in (exact, turned)
    ]

    assert paths[0] is not None and paths[1] is not None
    np.testing.assert_allclose(paths[0].poses[:, 2], yaws_rad, atol=1e-15)
    np.testing.assert_allclose(paths[1].poses[:, 2], yaws_rad / 2, atol=1e-12)


def _with_topics(raw: Recording, damaged: str) -> Recording:
    topics = (RecordedTopic(s.topic, s.schema.type_name, len(s)) for s in raw.streams)
    return replace(
        raw,
        topics=tuple(replace(t, damage="cut" if t.topic == damaged else "") for t in topics),
        anomalies=(f"{damaged}: 1 message cannot be decoded",),
    )


def test_damage_counts_where_the_topic_is_used_and_is_told_elsewhere() -> None:
    raw = recording(5.0)
    second = odometry_at(stamps(10.0, 2.0), "/other")
    raw = raw.with_streams(RawOdometry, [*raw.odometries, second])

    for topic in ("/scan", raw.odometries[0].topic):
        with pytest.raises(InputRefused, match=f"topic {topic}: cut"):
            clean(_with_topics(raw, topic), SOURCE)
    told = clean(_with_topics(raw, "/other"), SOURCE).warnings
    assert any("/other: 1 message" in words for words in told)


def test_scans_out_of_order_are_given_in_the_order_of_time_as_often_as_asked() -> None:
    raw = recording(5.0)
    stamps_ns = raw.scans[0].stamps_ns.copy()
    stamps_ns[[10, 11]] = stamps_ns[[11, 10]]
    swapped = scans_at(stamps_ns)
    farther_m = np.float32(0.01) * np.arange(len(swapped), dtype=np.float32)[:, None]
    swapped = replace(swapped, ranges_m=swapped.ranges_m + farther_m)

    log = clean(raw.with_streams(type(swapped), [swapped]), SOURCE)

    first, again = (list(log.scans) for _ in range(2))
    assert [scan.stamp_ns for scan in first] == sorted(stamps_ns.tolist())
    order = np.argsort(stamps_ns)
    for scan, other, row in zip(first, again, order, strict=True):
        np.testing.assert_array_equal(scan.ranges_m, other.ranges_m)
        np.testing.assert_array_equal(scan.ranges_m, swapped.ranges_m[row])
    assert any("sorted" in words for words in log.warnings)


def test_a_frame_that_no_transform_knows_leaves_the_laser_at_the_base() -> None:
    raw = replace(recording(5.0), transforms=(edge("odom", "base_link", stamps(10.0, 5.0)),))
    log = clean(raw, SOURCE)
    np.testing.assert_array_equal(log.T_base_laser, np.eye(4))
    assert any("the laser is taken to sit at the base" in words for words in log.warnings)


def _drive(is_moving: bool, is_noisy: bool, has_returns: bool = True) -> Recording:
    """Ten seconds at 10 Hz, in which the driver is stuck from the 40th scan to the 60th; without
    noise all scans of a robot that stands are the same."""
    read = recording(10.0)
    scans, odometry = read.scans[0], read.odometries[0]
    ranges_m = np.array(scans.ranges_m)
    ranges_m[40:60] = ranges_m[40]
    if not has_returns:
        ranges_m[:] = np.inf
    if not is_noisy:
        ranges_m[:30] = ranges_m[0]
    stands_s = 3.0 if is_moving and not is_noisy else 0.0 if is_moving else np.inf
    still = odometry.stamps_ns < odometry.stamps_ns[0] + stands_s * 1e9
    positions_m, quats_xyzw = odometry.positions_m.copy(), odometry.quats_xyzw.copy()
    if still.any():
        positions_m[still], quats_xyzw[still] = positions_m[still][-1], quats_xyzw[still][-1]
    odometry = replace(odometry, positions_m=positions_m, quats_xyzw=quats_xyzw)
    changed = replace(scans, ranges_m=ranges_m.astype(np.float32))
    return read.with_streams(RawScans, [changed]).with_streams(RawOdometry, [odometry])


def _made_up() -> Recording:
    """All scans are the same, as those of other people's tests."""
    read = recording(10.0)
    ranges_m = np.full_like(read.scans[0].ranges_m, 2.0)
    return read.with_streams(RawScans, [replace(read.scans[0], ranges_m=ranges_m)])


def test_scans_that_a_stuck_driver_publishes_again_are_left_out() -> None:
    read = _drive(is_moving=True, is_noisy=True)
    log = clean(read, SOURCE)
    assert len(log.scans) == 100 - 19 and log.recorded_scans == 100
    assert {scan.stamp_ns for scan in log.scans} == set(
        np.delete(read.scans[0].stamps_ns, np.arange(41, 60)).tolist()
    )
    assert any("19 scans repeat the one before while the robot moves" in w for w in log.warnings)


@pytest.mark.parametrize(
    "read",
    [
        _drive(is_moving=False, is_noisy=True),
        _drive(is_moving=True, is_noisy=False),
        _drive(is_moving=True, is_noisy=True, has_returns=False),
        _made_up(),
    ],
    ids=["stands", "without noise", "sees nothing", "made up"],
)
def test_scans_that_may_well_be_the_same_are_all_used(read: Recording) -> None:
    log = clean(read, SOURCE)
    assert len(log.scans) == 100
    assert not any("repeat the one before" in words for words in log.warnings)


@given(st.integers(300, 6000), st.integers(3, 6), st.booleans(), st.booleans(), st.booleans())
def test_a_turn_whose_angle_between_beams_is_rounded_is_a_turn(
    beams: int, decimals: int, is_closed: bool, by_rounded: bool, is_clockwise: bool
) -> None:
    """As drivers write it: with the last beam on the first one or before it, and ends exact or
    computed with what was rounded."""
    step_rad = (-1.0 if is_clockwise else 1.0) * 2.0 * np.pi / (beams - is_closed)
    rounded_rad = float(np.float32(round(step_rad, decimals)))
    if rounded_rad == 0.0:
        return
    last_rad = -np.pi + (beams - 1) * (rounded_rad if by_rounded else step_rad)
    layout = ScanLayout(-np.pi, last_rad, rounded_rad, 0.0, 0.0, 0.1, 10.0)
    if layout.folds(beams) and abs(rounded_rad) * (beams - 1) <= 1.01 * 2.0 * np.pi:
        assert layout.unfolded(beams).angle_step_rad == pytest.approx(step_rad, rel=1.01 / beams)
    else:
        assert layout.unfolded(beams) is layout


def test_scans_that_fold_otherwise_are_left_alone() -> None:
    """The last two are turns and a quarter, and 366 degrees, of exact angles."""
    for step_rad, beams in ((0.07, 720), (0.0123456, 720), (1e9, 720), (0.01, 800), (0.01, 640)):
        last_rad = np.pi if step_rad != 0.01 else -np.pi + (beams - 1) * step_rad
        layout = ScanLayout(-np.pi, last_rad, step_rad, 0.0, 0.0, 0.1, 10.0)
        assert layout.folds(beams) and layout.unfolded(beams) is layout


def test_scans_of_a_turn_with_a_rounded_angle_are_used_and_that_is_told() -> None:
    raw = _drive(is_moving=True, is_noisy=True)
    scans = replace(raw.scans[0], ranges_m=np.repeat(raw.scans[0].ranges_m, 30, axis=1))
    step_rad = 2.0 * np.pi / 1800
    rounded = replace(
        *scans.layouts,
        angle_min_rad=-np.pi,
        angle_max_rad=np.pi - step_rad,
        angle_step_rad=0.0035,
    )
    log = clean(raw.with_streams(RawScans, [replace(scans, layouts=(rounded,))]), SOURCE)
    (used_rad,) = {scan.geometry.angle_step_rad for scan in log.scans}
    assert used_rad == pytest.approx(step_rad)
    assert any("rounded to more than a turn" in words for words in log.warnings)
