"""Maps that a later run takes up: saved and read, gone on with, localised in."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from simulated import ScanList, Simulated, labyrinth, simulate

from slamsim.config.mapping import MappingConfig
from slamsim.config.slam import SlamConfig
from slamsim.geometry import between, compose
from slamsim.result import SlamResult
from slamsim.run.continuing import chosen_earlier, clouds_before
from slamsim.run.localising import read_known_map
from slamsim.run.start import start_pose
from slamsim.safe.errors import InputRefused, NotFound, OverrideRefused
from slamsim.slam.known_map import KnownMap, map_of_grid, map_of_keyframes
from slamsim.slam.localise import Localiser
from slamsim.slam.mapping import build_grid
from slamsim.slam.odometry import FrontEnd
from slamsim.slam.online.samples import WholeMotion
from slamsim.slam.saved_map import SavedMap, read_saved_map, write_saved_map
from slamsim.slam.session import map_log, odometry_of
from slamsim.slam.tracking import Step
from slamsim.types import FloatArray, Log


@cache
def example(seed: int = 2, world: int = 2, max_s: float = 40.0) -> Simulated:
    walls, tour = labyrinth(seed=world, cells=3)
    return simulate(walls, tour, seed=seed, max_s=max_s)


@cache
def mapped() -> tuple[SlamResult, SavedMap]:
    return map_log(example().log, SlamConfig())


def known() -> KnownMap:
    return map_of_keyframes(mapped()[1].keyframes, mapped()[1].poses)


def world_from_map() -> FloatArray:
    """Where the map began, as the truth has it."""
    first = mapped()[0].trajectory
    true = example().truth.at(first.stamps_ns[:1])[0]
    return compose(true, between(first.poses[0], np.zeros(3)))


def localised(
    log: Log, surfaces: KnownMap, start: FloatArray | None = None
) -> tuple[Localiser, list[Step]]:
    odometry = odometry_of(log)
    front_end = FrontEnd(SlamConfig().front_end, odometry, log.T_base_laser)
    localiser = Localiser(SlamConfig(), surfaces, front_end, WholeMotion(odometry), start)
    steps = [localiser.step(scan) for scan in log.scans]
    return localiser, [step for step in steps if step is not None]


def later_drive(first: int, count: int) -> Simulated:
    """The same world with other noise, from the middle of the tour on."""
    again = example(seed=5, max_s=60.0)
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


def test_a_robot_finds_itself_in_the_middle_of_the_map_and_stays_found() -> None:
    drive = later_drive(120, 200)
    localiser, steps = localised(drive.log, known())
    assert steps[0].status == "lost" and np.isnan(steps[0].T_map_base).all()
    assert steps[-1].status == "tracking"
    result = localiser.result()
    assert len(result.trajectory) == len(steps)
    here = compose(world_from_map(), result.trajectory.poses)
    off = between(drive.truth.at(result.trajectory.stamps_ns), here)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.05 and np.abs(off[:, 2]).max() < 0.02


def test_a_robot_that_knows_where_it_is_need_not_look() -> None:
    drive = later_drive(120, 60)
    true = drive.truth.at(np.array([step.stamp_ns for step in drive.log.scans]))[0]
    start = between(world_from_map(), true) + np.array([0.1, -0.1, 0.03])
    _, steps = localised(drive.log, known(), start)
    assert all(step.status == "tracking" for step in steps)
    off = between(true, compose(world_from_map(), steps[0].T_map_base))
    assert np.hypot(off[0], off[1]) < 0.03


def test_a_kidnapped_robot_is_found_again() -> None:
    log = later_drive(60, 500).log
    scans = list(log.scans)
    there = [
        replace(scan, stamp_ns=scan.stamp_ns - scans[220].stamp_ns + scans[80].stamp_ns)
        for scan in scans[220:]
    ]
    kidnapped = replace(log, scans=ScanList([*scans[:80], *there]), odometry=None, imu=None)
    _, steps = localised(kidnapped, known())
    status = [step.status for step in steps]
    assert status[79] == "tracking" and "lost" in status[80:] and status[-1] == "tracking"
    true = example(seed=5, max_s=60.0).truth.at(np.array([scans[-1].stamp_ns]))[0]
    off = between(true, compose(world_from_map(), steps[-1].T_map_base))
    assert np.hypot(off[0], off[1]) < 0.05


def test_an_occupancy_grid_is_a_map_as_well() -> None:
    slam, log = mapped()[0], example().log
    grid = build_grid(log.scans, slam.trajectory, log.T_base_laser, MappingConfig())
    drive = later_drive(120, 150)
    localiser, steps = localised(drive.log, map_of_grid(grid))
    assert steps[-1].status == "tracking"
    track = localiser.result().trajectory
    off = between(drive.truth.at(track.stamps_ns), compose(world_from_map(), track.poses))
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.1


def test_a_second_drive_becomes_one_map_with_the_first() -> None:
    drive = later_drive(60, 400)
    slam, saved = map_log(drive.log, SlamConfig(), earlier=mapped()[1])
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
    slam, saved = map_log(elsewhere.log, SlamConfig(), earlier=mapped()[1])
    assert len(saved) == len(slam.graph.keyframes)
    assert any("without being joined" in event.words for event in slam.events)


@pytest.mark.parametrize("typed", ["1,2", "a,b,c", "1,2,nan", "", "1,2,3,4"])
def test_a_start_that_is_no_pose_is_refused(typed: str) -> None:
    with pytest.raises(OverrideRefused, match="x,y,yaw_deg"):
        start_pose(typed)


def test_a_start_is_in_degrees() -> None:
    assert np.allclose(start_pose("1.5,-2,90"), [1.5, -2.0, np.pi / 2.0])  # type: ignore[arg-type]
