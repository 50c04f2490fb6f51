"""The checker's look at the transform tree."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.frames.transforms import check_transforms
from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry, RawScans, Recording, ScanLayout, TransformEdge
from slamsim.recording.frame_graph import FrameGraph


def frame_findings(recording: Recording) -> list[Finding]:
    return check_transforms(RecordingEvidence(recording))


SECOND = 1_000_000_000
LAYOUT = ScanLayout(-1.0, 1.0, 0.5, 0.0, 0.1, 0.1, 30.0)


def edge(
    parent: str,
    child: str,
    stamps_ns: IntArray | None = None,
    poses: FloatArray | None = None,
    is_static: bool = True,
) -> TransformEdge:
    stamps_ns = np.zeros(1, dtype=np.int64) if stamps_ns is None else stamps_ns
    poses = np.zeros((stamps_ns.size, 3)) if poses is None else poses
    positions_m = np.column_stack([poses[:, :2], np.zeros(stamps_ns.size)])
    quats_xyzw = xyzw_from_yaw(poses[:, 2])
    topic = "/tf_static" if is_static else "/tf"
    return TransformEdge(topic, parent, child, is_static, stamps_ns, None, positions_m, quats_xyzw)


def driven(seconds: float = 20.0, rate_hz: float = 20.0) -> tuple[IntArray, FloatArray]:
    at_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    stamps_ns = np.rint(at_s * 1e9).astype(np.int64)
    return stamps_ns, np.column_stack([0.3 * at_s, np.sin(at_s), 0.5 * at_s])


def odometry_of(stamps_ns: IntArray, poses: FloatArray) -> RawOdometry:
    like = edge("odom", "base_footprint", stamps_ns, poses, is_static=False)
    still = np.zeros((stamps_ns.size, 3))
    return RawOdometry(
        "/odom", ("odom",), stamps_ns, None, ("base_footprint",), like.positions_m,
        like.quats_xyzw, still, still,
    )  # fmt: skip


def sound() -> Recording:
    stamps_ns, poses = driven()
    scans_ns = np.arange(1 * SECOND, 19 * SECOND, SECOND // 10)
    rows = np.ones((scans_ns.size, 5), dtype=np.float32)
    layout_of = np.zeros(scans_ns.size, dtype=np.int32)
    scans = RawScans("/scan", ("laser_link",), scans_ns, None, (LAYOUT,), layout_of, rows)
    return Recording(
        "sound",
        "mcap",
        streams=(
            scans,
            odometry_of(stamps_ns, poses),
        ),
        transforms=(
            edge("odom", "base_footprint", stamps_ns, poses, is_static=False),
            edge("base_footprint", "base_link"),
            edge("base_link", "laser_link"),
        ),
    )


def bad(recording: Recording) -> list[Finding]:
    return [finding for finding in frame_findings(recording) if finding.verdict == "fault"]


def faults(recording: Recording) -> Counter[str | None]:
    return Counter(finding.fault for finding in bad(recording))


def with_edges(*edges: TransformEdge) -> Recording:
    return replace(sound(), transforms=edges)


def test_an_unknown_child_of_odometry_is_the_frame_that_moves_below_it() -> None:
    """Not the one with the nearest name: "base" is more like "laser" than like "base_link"."""
    made = sound().changed(RawOdometry, lambda one: replace(one, child_frame_ids=("laser",)))
    (told,) = [one for one in frame_findings(made) if one.fault == "tf_unknown_frame"]
    assert [one.parameters["frame"] for one in told.repairs] == ["base_footprint"]


def test_an_unknown_child_is_not_the_frame_that_another_odometry_gives() -> None:
    """A tracking camera has a frame of its own."""
    made = sound()
    tracked = replace(made.odometries[0], topic="/track", child_frame_ids=("t265_pose_frame",))
    made = made.with_streams(RawOdometry, (*made.odometries, tracked))
    (told,) = [one for one in frame_findings(made) if one.fault == "tf_unknown_frame"]
    assert told.subject == "/track" and not told.repairs


def test_a_whole_tree_is_sound() -> None:
    assert not bad(sound())
    assert {finding.check for finding in frame_findings(sound())} == {
        "tf.links", "tf.coverage", "tf.odometry", "tf.upright",
    }  # fmt: skip


def test_without_any_transform_nothing_can_be_told() -> None:
    assert [finding.verdict for finding in frame_findings(with_edges())] == ["inconclusive"]


def test_a_missing_odometry_link_is_what_slam_waits_for() -> None:
    found = bad(with_edges(*sound().transforms[1:]))
    assert [finding.fault for finding in found] == ["tf_missing_link"]
    assert found[0].subject == "odom -> base_footprint"
    assert found[0].repairs[0].operation == "add_odometry_transform"


def test_a_missing_link_inside_the_robot() -> None:
    whole = sound().transforms
    found = bad(with_edges(whole[0], edge("base_plate", "laser_link"), whole[1]))
    assert [(finding.fault, finding.subject) for finding in found] == [
        ("tf_missing_link", "base_footprint -> laser_link")
    ]


def test_an_unknown_frame_is_told_with_its_nearest_name() -> None:
    scans = replace(sound().scans[0], frame_ids=("laser_lnik",))
    found = bad(sound().with_streams(RawScans, (scans,)))
    assert [finding.fault for finding in found] == ["tf_unknown_frame"]
    assert "'laser_link'" in found[0].words


def test_two_parents() -> None:
    found = bad(with_edges(*sound().transforms, edge("camera_link", "laser_link")))
    assert [(finding.fault, finding.subject) for finding in found] == [
        ("tf_two_parents", "laser_link")
    ]


def test_a_circle_is_told_once() -> None:
    whole = sound().transforms
    assert faults(with_edges(*whole, edge("laser_link", "odom")))["tf_loop"] == 1


def test_a_fixed_transform_that_changes() -> None:
    stamps_ns = np.array([0, SECOND])
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0]])
    whole = sound().transforms
    changed = edge("base_link", "laser_link", stamps_ns, poses)
    assert faults(with_edges(*whole[:2], changed)) == {"tf_static_changes": 1}


def test_a_rotation_and_its_negative_are_the_same() -> None:
    fixed = edge("base_link", "laser_link", np.array([0, SECOND]))
    flipped = replace(fixed, quats_xyzw=fixed.quats_xyzw * np.array([[1.0], [-1.0]]))
    assert not faults(with_edges(*sound().transforms[:2], flipped))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e200])
def test_a_transform_that_is_none(value: float) -> None:
    whole = sound().transforms
    broken = replace(whole[2], quats_xyzw=np.full((1, 4), value))
    assert faults(with_edges(*whole[:2], broken)) == {"tf_not_rigid": 1}


def test_transforms_that_begin_late_do_not_cover_the_scans() -> None:
    stamps_ns, poses = driven()
    late = edge("odom", "base_footprint", stamps_ns[100:], poses[100:], is_static=False)
    assert faults(with_edges(late, *sound().transforms[1:])) == {"tf_coverage": 1}


def test_a_gap_is_not_covered_by_its_ends() -> None:
    stamps_ns, poses = driven()
    keep = (stamps_ns < 5 * SECOND) | (stamps_ns > 8 * SECOND)
    gap = edge("odom", "base_footprint", stamps_ns[keep], poses[keep], is_static=False)
    assert faults(with_edges(gap, *sound().transforms[1:]))["tf_coverage"] == 1


def test_a_transform_that_contradicts_the_odometry() -> None:
    stamps_ns, poses = driven()
    other = edge("odom", "base_footprint", stamps_ns, poses * [1.0, 1.0, 1.2], is_static=False)
    found = bad(with_edges(other, *sound().transforms[1:]))
    assert [finding.fault for finding in found] == ["tf_contradicts_odometry"]
    assert found[0].plots


@given(st.lists(st.integers(0, 1_000_000), min_size=1, max_size=12))
def test_any_tree_is_a_tree_and_one_more_parent_is_found(choices: list[int]) -> None:
    edges = [edge(f"f{choice % (i + 1)}", f"f{i + 1}") for i, choice in enumerate(choices)]
    graph = FrameGraph(edges)
    assert not graph.loops()
    assert not graph.with_two_parents()
    assert graph.reached("f0") == {f"f{i}" for i in range(len(choices) + 1)}
    assert set(FrameGraph([*edges, edge("new", "f1")]).with_two_parents()) == {"f1"}


@given(st.permutations(range(6)))
def test_a_circle_is_found_whatever_frame_the_search_begins_with(order: list[int]) -> None:
    edges = [edge(f"f{i}", f"f{(i + 1) % 4}") for i in range(4)]
    edges += [edge("f0", "leaf"), edge("leaf", "twig")]
    graph = FrameGraph([edges[i] for i in order])
    assert graph.loops() == [("f0", "f1", "f2", "f3")]


@pytest.mark.parametrize(
    ("lean_deg", "share", "is_fault"), [(2, 1, 0), (11, 0.2, 1), (11, 0.005, 0)]
)
def test_a_transform_leans_as_the_odometry_does(
    lean_deg: float, share: float, is_fault: bool
) -> None:
    whole = sound()
    moving = next(one for one in whole.transforms if not one.is_static)
    half = np.radians(lean_deg) / 2.0
    quats = moving.quats_xyzw.copy()
    quats[: int(share * len(quats))] = [0.0, np.sin(half), 0.0, np.cos(half)]
    leaning = [replace(one, quats_xyzw=quats) if one is moving else one for one in whole.transforms]
    found = {one.check: one for one in frame_findings(with_edges(*leaning))}
    assert (found["tf.upright"].fault == "tf_contradicts_odometry") == is_fault
