"""Maps that a later run takes up: saved and read, and gone on with."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from simulated import ScanList, Simulated, labyrinth, simulate

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused
from slamsim.run.continuing import chosen_earlier, clouds_before, start_pose
from slamsim.run.localising import read_known_map
from slamsim.slam.mapping.saved_map import SavedMap, read_saved_map, write_saved_map
from slamsim.slam.session import map_log

CONFIG = SlamConfig(calibrate_laser=False)
"""Half of what a short log costs is the calibration of its laser, which has tests of its own."""


@cache
def example(seed: int = 2, world: int = 2, max_s: float = 30.0) -> Simulated:
    walls, tour = labyrinth(seed=world, cells=3)
    return simulate(walls, tour, seed=seed, max_s=max_s)


@cache
def mapped() -> tuple[SlamResult, SavedMap]:
    return map_log(example().log, CONFIG)


def world_from_map() -> FloatArray:
    """Where the map began, as the truth has it."""
    first = mapped()[0].trajectory
    true = example().truth.at(first.stamps_ns[:1])[0]
    return compose(true, between(first.poses[0], np.zeros(3)))


def later_drive(first: int, count: int) -> Simulated:
    """The same world with other noise, from the middle of the tour on."""
    again = example(seed=5, max_s=34.0)
    scans = list(again.log.scans)[first : first + count]
    return replace(again, log=replace(again.log, scans=ScanList(scans)))


def test_a_saved_map_is_read_as_it_was(tmp_path: Path) -> None:
    saved = mapped()[1]
    write_saved_map(tmp_path / "session.npz", saved)
    read = read_saved_map(tmp_path / "session.npz")
    assert len(read) == len(saved) and np.array_equal(read.poses, saved.poses)
    for a, b in zip(saved.keyframes, read.keyframes, strict=True):
        assert np.array_equal(a.pieces, b.pieces) and a.pieces.dtype == b.pieces.dtype
        assert (a.index, a.stamp_ns, a.path_m) == (b.index, b.stamp_ns, b.path_m)
        assert (a.restart is None) == (b.restart is None)
        assert (a.odometry is None) == (b.odometry is None)
    for one, same in zip(saved.closures, read.closures, strict=True):
        assert (one.source, one.target, one.kind) == (same.source, same.target, same.kind)
        assert np.array_equal(one.covariance, same.covariance)


def test_a_damaged_map_is_refused_in_one_sentence_or_reads_as_it_was(tmp_path: Path) -> None:
    write_saved_map(tmp_path / "whole.npz", mapped()[1])
    whole = (tmp_path / "whole.npz").read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        data = bytearray(whole)
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        (tmp_path / "bad.npz").write_bytes(data)
        try:
            read = read_saved_map(tmp_path / "bad.npz")
        except InputRefused as error:
            refused += 1
            assert "\n" not in str(error)
        else:
            assert np.array_equal(read.poses, mapped()[1].poses)
    assert refused > 30
    for size in (0, 10, len(whole) // 2, len(whole) - 5):
        (tmp_path / "cut.npz").write_bytes(whole[:size])
        with pytest.raises(InputRefused, match="damaged"):
            read_saved_map(tmp_path / "cut.npz")


def test_what_is_no_map_is_said_to_be_none(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"session\.npz"):
        read_known_map(tmp_path)
    with pytest.raises(NotFound, match=r"session\.npz"):
        chosen_earlier(tmp_path, None)
    np.savez(tmp_path / "session.npz", a=np.zeros(3))
    with pytest.raises(InputRefused):
        chosen_earlier(tmp_path, None)
    with zipfile.ZipFile(tmp_path / "session.npz", "w") as archive:
        archive.writestr("format", b"no array")
    with pytest.raises(InputRefused, match="no array"):
        chosen_earlier(tmp_path, None)


@pytest.mark.long
def test_a_second_drive_becomes_one_map_with_the_first() -> None:
    drive = later_drive(60, 250)
    slam, saved = map_log(drive.log, CONFIG, earlier=mapped()[1])
    old = len(mapped()[1])
    assert len(saved) == old + len(slam.graph.keyframes)
    assert any(e.source < old <= e.target for e in saved.closures)
    off = between(
        drive.truth.at(slam.trajectory.stamps_ns), compose(world_from_map(), slam.trajectory.poses)
    )
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.05
    assert len(list(clouds_before(saved, slam))) == old


def test_a_drive_elsewhere_is_mapped_alone_and_said_to_be_loose() -> None:
    elsewhere = example(seed=9, world=11, max_s=25.0)
    slam, saved = map_log(elsewhere.log, CONFIG, earlier=mapped()[1])
    assert len(saved) == len(slam.graph.keyframes)
    assert any("without being joined" in event.words for event in slam.events)


@pytest.mark.parametrize("typed", ["1,2", "a,b,c", "1,2,nan", "", "1,2,3,4"])
def test_a_start_that_is_no_pose_is_refused(typed: str) -> None:
    with pytest.raises(OverrideRefused, match="x,y,yaw_deg"):
        start_pose(typed)


def test_a_start_is_in_degrees() -> None:
    assert np.allclose(start_pose("1.5,-2,90"), [1.5, -2.0, np.pi / 2.0])  # type: ignore[arg-type]
