"""Scans, maps and paths as a page is sent them, against slow oracles."""

from __future__ import annotations

import cmath
import json
import struct
import zlib
from typing import Any

import numpy as np
from fake_robot import (
    CELL_M,
    TOPICS,
    cdr,
    grid_message,
    header,
    made,
    pose,
    scan_message,
    transform,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.live.hub import Hub
from slamsim.live.servers.web.view import MOST_CELLS, MOST_POINTS, LiveTransforms, View

METRES = st.floats(-20.0, 20.0)
ANGLES = st.floats(-3.0, 3.0)
POSES = st.tuples(METRES, METRES, ANGLES)


def message(*transforms: Any) -> Any:
    return made("tf2_msgs/msg/TFMessage", transforms=list(transforms))


def moved(pose: tuple[float, float, float], point: complex) -> complex:
    return complex(pose[0], pose[1]) + cmath.rect(1.0, pose[2]) * point


def between(a: Any, b: Any, share: float) -> tuple[float, float, float]:
    turn = cmath.phase(cmath.rect(1.0, b[2]) / cmath.rect(1.0, a[2]))
    x, y = (a[i] + share * (b[i] - a[i]) for i in (0, 1))
    return x, y, a[2] + share * turn


@settings(max_examples=60, deadline=None)
@given(POSES, POSES, POSES, POSES, st.lists(st.tuples(METRES, METRES), min_size=1, max_size=9))
def test_each_beam_is_placed_by_the_pose_at_its_own_time(
    laser: Any, start: Any, end: Any, correction: Any, points: Any
) -> None:
    transforms, stamp_ns = LiveTransforms(), 1_700_000_000 * 10**9
    static = transform(0, "base", "laser", *laser)
    transforms.add(message(static), moving=False)
    for stamp, edge in ((stamp_ns, start), (stamp_ns + 50_000_000, end)):
        transforms.add(message(transform(stamp, "odom", "base", *edge)), moving=True)
    transforms.add(message(transform(stamp_ns, "map", "odom", *correction)), moving=True)
    shares = np.linspace(-0.2, 1.2, len(points))
    stamps_ns = stamp_ns + (shares * 50_000_000).astype(np.int64)
    found = transforms.to_root("laser", np.array([(x, y, 0.0) for x, y in points]), stamps_ns)
    for (x, y), share, placed in zip(points, shares.clip(0.0, 1.0), found, strict=True):
        wanted = moved(laser, complex(x, y))
        wanted = moved(correction, moved(between(start, end, share), wanted))
        np.testing.assert_allclose(placed, [wanted.real, wanted.imag], atol=1e-5)
    assert transforms.base_above("laser") == "base"
    root, newest = transforms.newest_pose("base")
    wanted = moved(correction, complex(*end[:2]))
    assert root == "map"
    np.testing.assert_allclose(newest[:2], [wanted.real, wanted.imag], atol=1e-9)


def test_frames_in_a_circle_end() -> None:
    transforms = LiveTransforms()
    for parent, child in (("a", "b"), ("b", "a")):
        transforms.add(message(transform(0, parent, child, 1.0, 0.0, 0.0)), moving=False)
    assert transforms.to_root("a", np.zeros((1, 3)), np.zeros(1, np.int64)).shape == (1, 2)


def test_a_drive_that_begins_anew_is_not_mixed_with_the_one_before() -> None:
    transforms = LiveTransforms()
    for stamp_ns, x_m in ((10**12, 9.0), (2 * 10**12, 9.0), (10**12 + 1, 1.0)):
        edge = transform(stamp_ns, "odom", "base", x_m, 0.0, 0.0)
        transforms.add(message(edge), moving=True)
    placed = transforms.to_root("base", np.zeros((1, 3)), np.array([2 * 10**12]))
    assert placed.tolist() == [[1.0, 0.0]]


def test_a_lidar_that_hangs_upside_down_is_mirrored() -> None:
    hanging = transform(0, "base", "laser", 0.5, 0.0, 0.0)
    hanging.transform.rotation = made("geometry_msgs/msg/Quaternion", x=1.0, y=0.0, z=0.0, w=0.0)
    transforms = LiveTransforms()
    transforms.add(message(hanging), moving=False)
    placed = transforms.to_root("laser", np.array([[1.0, 2.0, 0.0]]), np.zeros(1, np.int64))
    np.testing.assert_allclose(placed, [[1.5, -2.0]], atol=1e-12)


def frames_of(topic: str, ros_message: Any) -> list[tuple[dict[str, Any], bytes]]:
    hub = Hub(TOPICS)
    view = View(hub, lambda: None)
    hub.publish(topic, 0, cdr(ros_message))
    found = []
    for _, frame in (*view.scans(), *view.maps()):
        (size,) = struct.unpack_from("<I", frame)
        assert size % 4 == 0
        found.append((json.loads(frame[4 : 4 + size]), frame[4 + size :]))
    assert not [*view.scans(), *view.maps()], "what was shown is not new"
    return found


def test_readings_that_are_no_returns_are_left_out() -> None:
    ranges = np.array([1.0, np.nan, np.inf, -1.0, 0.01, 9.0, 2.0, 0.0])
    ((head, body),) = frames_of("/scan", scan_message(0, ranges))
    points = np.frombuffer(body, "<i2").reshape(-1, 2) * head["step_m"]
    points += np.array([head["x_m"], head["y_m"]])
    wanted = [cmath.rect(ranges[i], -np.pi + 2.0 * np.pi / len(ranges) * i) for i in (0, 6)]
    np.testing.assert_allclose(points, [(p.real, p.imag) for p in wanted], atol=0.003)
    ((_, nothing),) = frames_of("/scan", scan_message(0, np.full(4, np.inf)))
    assert nothing == b""


def test_a_map_that_is_too_large_is_sent_coarser_with_its_walls() -> None:
    cells = np.full((2 * MOST_CELLS - 1, 10), -1, np.int8)
    cells[100:200] = 0
    cells[150, 3] = 100
    ((head, body),) = frames_of("/map", grid_message(0, cells, -1.0, 2.0))
    sent = np.frombuffer(zlib.decompress(body), np.uint8).reshape(head["height"], head["width"])
    assert sent.shape == (MOST_CELLS, 5) and head["resolution_m"] == 2.0 * np.float32(CELL_M)
    assert np.argwhere(sent == 100).tolist() == [[75, 1]]
    assert (sent == 0).sum() == 50 * 5 - 1 and (head["x_m"], head["y_m"]) == (-1.0, 2.0)


def test_a_long_path_is_thinned_and_keeps_its_ends() -> None:
    stamped = made("geometry_msgs/msg/PoseStamped", header=header(0, "map"), pose=None)
    poses = [
        type(stamped)(header=stamped.header, pose=pose(float(i), 0.0, 0.0))
        for i in range(MOST_POINTS + 500)
    ]
    path = made("nav_msgs/msg/Path", header=header(0, "map"), poses=poses)
    ((head, body),) = frames_of("/path", path)
    points = np.frombuffer(body, "<f4").reshape(-1, 2)
    assert head["type"] == "path" and len(points) == MOST_POINTS
    assert points[0, 0] == 0.0 and points[-1, 0] == MOST_POINTS + 499


ANY = st.floats() | st.sampled_from([0.0, 1e-300, 1e300, -1.0])


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_numbers_that_make_no_sense_are_shown_or_left_out(data: st.DataObject) -> None:
    hub = Hub(TOPICS)
    view = View(hub, lambda: None)
    edge = transform(0, "map", "base_footprint", 0.0, 0.0, 0.0)
    edge.transform.translation.x, edge.transform.rotation.z = data.draw(ANY), data.draw(ANY)
    scan = scan_message(
        0, np.array(data.draw(st.lists(st.floats(width=32), min_size=1, max_size=5)))
    )
    for name in ("angle_min", "angle_increment", "time_increment", "range_max"):
        setattr(scan, name, data.draw(st.floats(width=32)))
    grid = grid_message(0, np.zeros((2, 3)), data.draw(ANY), 0.0)
    grid.info.width, grid.info.height = (data.draw(st.integers(0, 2**32 - 1)) for _ in range(2))
    grid.info.resolution = data.draw(st.floats(width=32))
    hub.publish("/tf", 0, cdr(message(edge)))
    hub.publish("/scan", 0, cdr(scan))
    hub.publish("/map", 0, cdr(grid))
    view.follow()
    for _, frame in (*view.scans(), *view.maps()):
        (size,) = struct.unpack_from("<I", frame)
        assert all(
            isinstance(v, str) or np.isfinite(v) for v in json.loads(frame[4 : 4 + size]).values()
        )
    json.dumps(view.pose(), allow_nan=False)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([topic.name for topic in TOPICS]), st.binary(max_size=200))
def test_bytes_that_are_no_message_are_left_out(topic: str, data: bytes) -> None:
    hub = Hub(TOPICS)
    view = View(hub, lambda: None)
    hub.publish(topic, 0, data)
    view.follow()
    list(view.scans())
    list(view.maps())
