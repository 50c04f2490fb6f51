"""write_recording: what was read is what is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_data import edge, recording, scans_at, stamps
from test_recording_read import assert_same

from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2 import writer
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_log, read_recording
from slamsim.recording import RawJoints, Recording, TransformEdge


def _back(made: Recording, folder: Path) -> Recording:
    write_recording(made, folder)
    return read_recording(folder)


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    made = replace(recording(), robot_description="<robot/>", epoch="simulation")
    back = _back(made, tmp_path / "bag")
    assert_same(made, replace(back, transforms=_sorted(back)), but=("layouts", "transforms"))
    for found, wanted in zip(back.scans[0].layouts, made.scans[0].layouts, strict=True):
        assert found.angle_step_rad == pytest.approx(wanted.angle_step_rad, rel=1e-6)
    log = read_log(tmp_path / "bag")
    assert len(log.scans) == 300 and log.odometry is not None and log.imu is not None
    np.testing.assert_allclose(log.T_base_laser[:3, 3], [0.1, 0.0, 0.0])


def _sorted(back: Recording) -> tuple[TransformEdge, ...]:
    names = [edge.name for edge in recording().transforms]
    return tuple(sorted(back.transforms, key=lambda edge: names.index(edge.name)))


def test_small_windows_write_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = recording()
    write_recording(made, tmp_path / "whole")
    monkeypatch.setattr(writer, "_WINDOW_BYTES", 5000)
    write_recording(made, tmp_path / "parts")
    name = "log_0.mcap"
    assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes()


@given(
    sizes=st.lists(st.integers(0, 4), min_size=1, max_size=12),
    shuffle=st.booleans(),
    receipt=st.sampled_from(["none", "even", "backward"]),
    seed=st.integers(0, 1000),
)
def test_any_scans_keep_their_order(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    shuffle: bool,
    receipt: str,
    seed: int,
) -> None:
    """Scans of changing length, stamps in any order, received whenever."""
    rng = np.random.default_rng(seed)
    count = len(sizes)
    stamps_ns = stamps(10.0, 2.0)[:count]
    if shuffle:
        stamps_ns = rng.permutation(stamps_ns)
    received = {"none": None, "even": stamps(10.0, 2.0)[:count]}.get(receipt)
    if receipt == "backward":
        received = stamps(10.0, 2.0)[:count][::-1].copy()
    rows = [rng.normal(size=size).astype(np.float32) for size in sizes]
    scans = replace(scans_at(stamps_ns), ranges_m=rows, received_ns=received)
    back = _back(Recording("r", "memory", streams=(scans,)), tmp_path_factory.mktemp("w") / "bag")
    (found,) = back.scans
    if receipt == "even" or sizes == [sizes[0]] * count:
        np.testing.assert_array_equal(found.stamps_ns, stamps_ns)
        for a, b in zip(found.ranges_m, rows, strict=True):
            np.testing.assert_array_equal(a, b)
    assert sorted(found.stamps_ns.tolist()) == sorted(stamps_ns.tolist())


def test_a_static_transform_that_changes_goes_on_changing(tmp_path: Path) -> None:
    restless = edge("base_link", "laser", stamps(1.0, 3.0))
    restless.positions_m[:, 0] = [0.1, 0.2, 0.3]
    back = _back(replace(recording(), transforms=(restless,)), tmp_path / "bag")
    (found,) = back.transforms
    assert found.is_static and found.positions_m[:, 0].tolist() == [0.1, 0.2, 0.3]


def test_joints_are_written_too(tmp_path: Path) -> None:
    when = stamps(20.0, 2.0)
    numbers = np.arange(when.size * 2, dtype=np.float64).reshape(-1, 2)
    joints = RawJoints("/joint_states", ("",), when, when, ("a", "b"), numbers, np.nan * numbers)
    write_recording(recording().with_streams(RawJoints, (joints,)), tmp_path / "bag")
    np.testing.assert_array_equal(read_recording(tmp_path / "bag").joints[0].positions_rad, numbers)


def test_a_carmen_line_becomes_two_topics(tmp_path: Path) -> None:
    path = tmp_path / "made.log"
    line = "FLASER 3 1.0 2.0 3.0 0.2 0 0 0.0 0 0 {} host {}"
    path.write_text("\n".join(line.format(10 + i / 5, i / 5) for i in range(9)) + "\n")
    back = _back(read_recording(path), tmp_path / "bag")
    assert [scans.topic for scans in back.scans] == ["/FLASER"]
    assert [odometry.topic for odometry in back.odometries] == ["/FLASER/odometry"]
    assert read_log(tmp_path / "bag").T_base_laser[0, 3] == pytest.approx(0.2)


def test_stamps_beyond_what_ros_can_write_are_refused(tmp_path: Path) -> None:
    far = scans_at(stamps(10.0, 1.0) + 2**62)
    with pytest.raises(SlamsimError, match="cannot be written"):
        write_recording(Recording("far", "memory", streams=(far,)), tmp_path / "bag")


def test_a_carmen_log_is_written_in_the_words_of_ros(tmp_path: Path) -> None:
    lines = [
        f"FLASER 4 1.0 2.0 81.83 90.0 {0.1 * k} 0 0 {0.1 * k} 0 0 {100.0 + 0.2 * k:.6f} host "
        f"{100.0 + 0.2 * k:.6f}"
        for k in range(30)
    ]
    path = tmp_path / "drive.clf"
    path.write_text("PARAM robot_front_laser_max 81.83\n" + "\n".join(lines) + "\n")
    made = read_recording(path)
    back = _back(made, tmp_path / "bag")
    ranges_m = np.asarray(back.scans[0].ranges_m)
    np.testing.assert_array_equal(ranges_m[:, :2], np.asarray(made.scans[0].ranges_m)[:, :2])
    assert np.isinf(ranges_m[:, 2:]).all(), "a wall would grow where nothing came back"
    (odometry,) = back.odometries
    (moving,) = (one for one in back.transforms if not one.is_static)
    assert moving.name == f"{odometry.frame_ids[0]} -> {odometry.child_frame_ids[0]}"
    np.testing.assert_array_equal(moving.stamps_ns, odometry.stamps_ns)
    np.testing.assert_allclose(moving.positions_m, odometry.positions_m)
