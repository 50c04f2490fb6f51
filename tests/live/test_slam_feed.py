"""Streams that arrive in pieces of any length, as what a SLAM session takes."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scan_recording import DRIVE_S, healthy

from slamsim.core.types import IntArray
from slamsim.live.slam_feed import SlamFeed
from slamsim.recording import RawScans, RawStream, Recording
from slamsim.recording.cleaning.streams import odometry_of
from slamsim.slam.online.motion_filter import MotionFilter


def rows(stream: RawStream, kept: Any) -> RawStream:
    columns = {field.name: getattr(stream, field.name) for field in fields(stream)}
    length = len(stream)
    cut: dict[str, Any] = {
        name: column[kept]
        for name, column in columns.items()
        if isinstance(column, np.ndarray) and len(column) == length
    }
    return replace(stream, **cut)


def pieces(ends_s: list[float]) -> list[list[RawStream]]:
    """The drive as it arrives, each stream by its stamps."""
    ends_ns = [round(end_s * 1e9) for end_s in sorted(ends_s)]
    made = []
    for begin_ns, end_ns in zip([-1, *ends_ns], [*ends_ns, round(DRIVE_S * 1e9)], strict=True):
        made.append(
            [
                rows(one, (one.stamps_ns > begin_ns) & (one.stamps_ns <= end_ns))
                for one in healthy().streams
            ]
        )
    return made


@pytest.mark.long
@given(st.lists(st.floats(0.0, DRIVE_S), max_size=12))
@example([])
@settings(max_examples=8)
def test_no_pause_loses_a_scan(ends_s: list[float]) -> None:
    """All motion is given once, and what the session keeps of it reaches from scan to scan."""
    feed, session, given_ns = SlamFeed(), MotionFilter(np.eye(3)), list[IntArray]()
    begun_ns = int(healthy().odometries[0].stamps_ns[0])
    scans = 0
    for piece in pieces(ends_s):
        for scan, motion in feed.take(piece):
            if motion.odometry is not None:
                given_ns.append(motion.odometry.stamps_ns)
            session.add(motion)
            odometry = session.until(scan.span_ns[1])
            assert odometry is not None
            assert odometry.stamps_ns[0] <= max(begun_ns, scan.stamp_ns - 1_000_000_000)
            assert odometry.stamps_ns[-1] >= scan.span_ns[1]
            scans += 1
    assert scans > len(healthy().scans[0]) - 5
    stamps_ns = np.concatenate(given_ns)
    assert np.array_equal(stamps_ns, healthy().odometries[0].stamps_ns[: len(stamps_ns)])


def test_what_a_stuck_driver_publishes_again_is_left_out_and_no_motion_with_it() -> None:
    lidar, odometry = healthy().scans[0], healthy().odometries[0]
    speeds_m_s = np.hypot(*np.diff(odometry.positions_m[:, :2], axis=0).T)
    begin_ns = int(odometry.stamps_ns[np.argmax(speeds_m_s)])
    first = int(np.searchsorted(lidar.stamps_ns, begin_ns))
    ranges_m = np.array(lidar.ranges_m)
    ranges_m[first : first + 5] = ranges_m[first]
    stuck = healthy().with_streams(RawScans, [replace(lidar, ranges_m=ranges_m)])

    def taken(recording: Recording) -> tuple[list[int], IntArray]:
        given = list(SlamFeed().take(recording.streams))
        motions = [motion.odometry.stamps_ns for _, motion in given if motion.odometry is not None]
        return [scan.stamp_ns for scan, _ in given], np.concatenate(motions)

    whole_ns, motion_ns = taken(healthy())
    kept_ns, same_motion_ns = taken(stuck)
    assert sorted(set(whole_ns) - set(kept_ns)) == lidar.stamps_ns[first + 1 : first + 5].tolist()
    assert np.array_equal(motion_ns, same_motion_ns)


def test_a_pose_whose_transform_came_late_is_left_out_and_ends_no_map() -> None:
    lidar, path = healthy().scans[0], odometry_of(healthy().odometries[0])[0]
    assert path is not None
    late = int(np.searchsorted(path.stamps_ns, lidar.stamps_ns[5]))
    rest = np.arange(len(path)) != late
    feed = SlamFeed()
    parts = [path.select(rest), path.select(~rest)]
    motions = [motion for _, motion in feed.take([*parts, lidar])]
    given_ns = np.concatenate([one.odometry.stamps_ns for one in motions if one.odometry])
    assert np.array_equal(given_ns, path.stamps_ns[rest][: len(given_ns)])
    assert given_ns[-1] > path.stamps_ns[late]
