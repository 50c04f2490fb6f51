"""Repairs that make a recording better stay, others are taken back."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from independent.cases import Case, cases, make
from typer.testing import CliRunner

from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.map_quality.beam_ends import _apart, beam_ends, change
from slamsim.check.repairing import Check, restored
from slamsim.cli.main import app
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_recording
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.base import SCANS
from slamsim.recording.edits.beams import ScaleAngles
from slamsim.recording.edits.ranges import map_ranges
from slamsim.recording.repairs.apply import apply_repairs, repeats
from slamsim.recording.repairs.base import Repair

DRIVE, SECONDS = 0, 30.0
"""A lidar that turns five times a second, its first beam ahead."""

LATE = Repair("shift_stamps", "/scan", {"offset_s": 0.1})
SPOILING = (
    LATE,
    Repair("scale_angles", "/scan", {"factor": 1.01}),
    Repair("add_to_ranges", "/scan", {"offset_m": 0.1}),
    Repair("scale_odometry", "/odom", {"path_factor": 1.0, "turn_factor": 1.05}),
    Repair("scale_odometry", "/odom", {"path_factor": 1.05, "turn_factor": 1.0}),
    Repair("scale_gyro", "/imu", {"factor": 1.05}),
    Repair("subtract_gyro_bias", "/imu", {"bias_rad_s": 0.05}),
    Repair("negate_angles", "/scan"),
    Repair("turn_with_robot", "/scan", {"heading_from": "/odom"}),
)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _made(Case("clean", DRIVE), tmp_path_factory.mktemp("clean"))


def _made(case: Case, folder: Path, seconds: float = SECONDS) -> Recording:
    make(case, folder / "recording", seconds)
    return read_recording(folder / "recording")


@pytest.mark.parametrize("repair", SPOILING, ids=lambda one: str(one.operation))
def test_what_damages_a_recording_puts_its_scans_apart(clean: Recording, repair: Repair) -> None:
    right, damaged = beam_ends(clean), beam_ends(apply_repairs(clean, [repair]))
    assert right.mean_m is not None and damaged.mean_m is not None
    assert 0.003 < right.mean_m < 0.02 and right.mean_m < damaged.mean_m
    assert change(right, damaged).worse and change(damaged, right).mean_m < 0.0
    assert not change(right, right).worse and not change(right, right).better


def test_nothing_places_scans_without_a_mount_or_a_path(clean: Recording) -> None:
    alone = replace(clean, streams=tuple(clean.scans), transforms=())
    millimetres = apply_repairs(clean, [Repair("scale_ranges", "/scan", {"factor": 1e3})])
    for made in (alone, millimetres, replace(clean, streams=())):
        ends = beam_ends(made)
        assert ends.mean_m is None
        assert not change(beam_ends(clean), ends).worse and not change(ends, ends).better


def test_distances_are_those_of_segments() -> None:
    """Against the nearest point of each segment that faces the same way."""
    rng = np.random.default_rng(4)
    pieces, surfaces = (_random_pieces(rng, count) for count in (40, 30))
    wanted = [
        min((_to_segment(one, other) for other in surfaces if _alike(one, other)), default=0.5)
        for one in pieces
    ]
    np.testing.assert_allclose(_apart(pieces, surfaces), np.minimum(wanted, 0.5), atol=1e-12)


def _random_pieces(rng: np.random.Generator, count: int) -> FloatArray:
    yaw = rng.uniform(-np.pi, np.pi, count)
    at, half_m = rng.uniform(0.0, 2.0, (count, 2)), rng.uniform(0.0, 0.3, count)
    return np.column_stack([at, np.cos(yaw), np.sin(yaw), half_m])


def _alike(one: FloatArray, other: FloatArray) -> bool:
    return bool(one[2:4] @ other[2:4] >= 0.7)


def _to_segment(one: FloatArray, other: FloatArray) -> float:
    along = np.array([-other[3], other[2]])
    ends = other[:2] + np.outer([-other[4], other[4]], along)
    points = ends[0] + np.linspace(0.0, 1.0, 2)[:, None] * (ends[1] - ends[0])
    share = np.clip((one[:2] - points[0]) @ along / max(2.0 * other[4], 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(one[:2] - (points[0] + share * (points[1] - points[0]))))


def _reversed(recording: Recording) -> Recording:
    """As a driver writes it that turns the list of readings round, but not its angles."""
    return recording.changed(
        RawScans, lambda scans: map_ranges(scans, lambda ranges_m: ranges_m[:, ::-1].copy())
    )


WRECKS: dict[str, tuple[Callable[[Recording], Recording], tuple[str, str, float | str]]] = {
    "179 beams for 180, first": (
        ScaleAngles(SCANS, 180.0 / 179.0, True, "first").apply,
        ("scale_angles", "pivot", "first"),
    ),
    "179 beams for 180, last": (
        ScaleAngles(SCANS, 180.0 / 179.0, True, "last").apply,
        ("scale_angles", "pivot", "last"),
    ),
    "readings reversed": (_reversed, ("negate_angles", "about", "middle")),
}


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        name if name.endswith("first") else pytest.param(name, marks=pytest.mark.slow)
        for name in WRECKS
    ],
)
def test_rays_are_turned_back_as_a_whole_too(clean: Recording, name: str) -> None:
    """No yaw is left that a wrong mount would have to make up for."""
    damage, (operation, parameter, value) = WRECKS[name]
    found = restored(damage(clean), "all", check_recording)
    (made,) = (one for one in found.applied if one.operation == operation)
    assert made.parameters[parameter] == value
    assert not found.report.faults and not found.taken_back
    assert "set_mounting" not in {one.operation for one in found.applied}
    right_m = beam_ends(clean).mean_m
    assert right_m is not None and found.after.mean_m is not None
    assert found.after.mean_m < 1.05 * right_m


@pytest.mark.long
def test_rays_that_turn_twice_are_named_and_turned_back(clean: Recording) -> None:
    twice = [Repair("turn_with_robot", "/scan", {"heading_from": "/odom"})]
    damaged = apply_repairs(clean, twice)
    faults = {finding.fault for finding in check_recording(damaged).faults}
    assert "laser_turned_twice" in faults and "laser_angle_step" not in faults
    found = restored(damaged, "turn_with_robot", check_recording)
    assert [one.parameters["turns"] for one in found.applied] == [-1.0]
    assert found.before.mean_m is not None and found.after.mean_m is not None
    assert found.after.mean_m < 0.1 * found.before.mean_m


ASKED = {
    "shift_stamps": ("time.offset.lidar", "time_offset_lidar"),
    "scale_angles": ("laser.angle_step", "laser_angle_step"),
    "drop_stray_beams": ("ranges.stray", "scan_interference"),
}


def _fault(repair: Repair) -> Finding:
    check, fault = ASKED[repair.operation]
    return Finding(check, repair.subject, "fault", "it is so", fault, repairs=(repair,))


def _steady(repairs: Callable[[Recording], Sequence[Repair]]) -> Check:
    def check(recording: Recording) -> CheckReport:
        return CheckReport(recording.name, tuple(map(_fault, repairs(recording))))

    return check


def test_a_repair_that_puts_scans_apart_is_taken_back_whatever_the_check_says(
    clean: Recording,
) -> None:
    found = restored(clean, "all", _steady(lambda one: [LATE] if one is clean else []))
    assert found.recording is clean and not found.applied
    (back,) = found.taken_back
    assert back.repair == LATE and "fit worse" in back.reason


def test_of_two_repairs_the_one_that_makes_it_worse_is_left_out(clean: Recording) -> None:
    wide = ScaleAngles(SCANS, 1.01, True).apply(clean)
    narrower = Repair("scale_angles", "/scan", {"factor": 1.0 / 1.01})

    def proposed(recording: Recording) -> Sequence[Repair]:
        return [narrower, LATE] if recording is wide else [LATE]

    found = restored(wide, "all", _steady(proposed))
    assert [one.operation for one in found.applied] == ["scale_angles"]
    assert [one.repair for one in found.taken_back] == [LATE]
    assert change(found.before, found.after).better


def test_what_is_not_gone_and_does_nothing_is_taken_back(clean: Recording) -> None:
    still = _steady(lambda _: [Repair("drop_stray_beams", "/scan")])
    found = restored(clean, "all", still)
    assert not found.applied and "scan_interference is still there" in found.taken_back[0].reason


def test_what_is_dropped_may_be_missing_from_then_on(clean: Recording) -> None:
    """Scans that stood still for a while are worse than none."""
    drop = Repair("drop_repeated_scans", "/scan")

    def held(scans: RawScans) -> RawScans:
        rows = np.arange(len(scans))
        held = np.where((rows > 100) & (rows < 120), 100, rows)
        return map_ranges(scans, lambda ranges_m: np.asarray(ranges_m)[held])

    stuck = clean.changed(RawScans, held)

    def check(recording: Recording) -> CheckReport:
        if recording is not stuck:
            missing = Finding("time.gaps", "/scan", "fault", "it is so", "stream_gaps")
            return CheckReport(recording.name, (missing,))
        one = Finding("ranges.stuck", "/scan", "fault", "it is so", "scan_stuck", repairs=(drop,))
        return CheckReport(recording.name, (one, Finding("time.gaps", "/scan", "ok", "none")))

    found = restored(stuck, "all", check)
    assert found.applied == (drop,) and len(found.recording.scans[0]) == len(clean.scans[0]) - 19


def test_what_leaves_out_no_message_may_not_make_messages_missing(clean: Recording) -> None:
    (topic,) = (imu.topic for imu in clean.imus)
    drop = Repair("drop_orientation", topic)

    def check(recording: Recording) -> CheckReport:
        if recording is not clean:
            missing = Finding("time.gaps", topic, "fault", "it is so", "stream_gaps")
            return CheckReport(recording.name, (missing,))
        one = Finding(
            "imu.orientation", topic, "fault", "it is so", "imu_orientation", repairs=(drop,)
        )
        return CheckReport(recording.name, (one, Finding("time.gaps", topic, "ok", "none")))

    found = restored(clean, "all", check)
    assert not found.applied and f"time.gaps of {topic}" in found.taken_back[0].reason


def test_back_and_forth_comes_to_an_end(clean: Recording) -> None:
    """A check that never has enough: its faults go, and come again elsewhere."""
    scaled = iter([2.0, 0.5, 2.0, 0.5, 2.0, 0.5, 2.0])

    def check(recording: Recording) -> CheckReport:
        factor = next(scaled)
        repair = Repair("scale_acceleration", "/imu", {"factor": factor})
        one = Finding(f"a.{factor}", "/imu", "fault", "it is so", f"by_{factor}", repairs=(repair,))
        return CheckReport(recording.name, (one,))

    found = restored(clean, "all", check)
    assert [one.parameters["factor"] for one in found.applied] == [2.0]
    assert "applied before" in found.taken_back[0].reason


@pytest.mark.parametrize(
    ("operation", "earlier", "later", "again"),
    [
        ("scale_angles", {"factor": 0.5}, {"factor": 0.5}, True),
        ("scale_angles", {"factor": 0.5}, {"factor": 2.0}, True),
        ("scale_angles", {"factor": 0.5}, {"factor": 1.01}, False),
        ("scale_beam_times", {"factor": -1.0}, {"factor": -1.0}, True),
        ("shift_stamps", {"offset_s": -1.7e9}, {"offset_s": 0.02}, False),
        ("negate_angles", {}, {}, True),
        ("rename_frame", {"frame": "a"}, {"frame": "b"}, False),
        ("rename_frame", {"frame": "a"}, {"frame": "a"}, True),
        ("drop_beams", {"first": 1.0, "last": 2.0}, {"first": 7.0, "last": 9.0}, False),
    ],
)
def test_a_repair_is_made_again_only_if_it_is_smaller(
    operation: str, earlier: dict[str, Any], later: dict[str, Any], again: bool
) -> None:
    one, other = (Repair(operation, "/scan", each) for each in (earlier, later))
    assert repeats(other, one, 0.5) is again
    assert not repeats(replace(other, subject="/other"), one, 0.5)


def test_fix_that_makes_nothing_better_writes_nothing(
    clean: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(clean, tmp_path / "log")
    monkeypatch.setattr(
        "slamsim.run.fixing.check_stage", lambda one, stages: _steady(lambda _: [LATE])(one)
    )
    result = CliRunner().invoke(app, ["fix", str(tmp_path / "log"), str(tmp_path / "out")])
    assert isinstance(result.exception, SlamsimError) and result.exception.exit_code == 1
    assert "shift_stamps of /scan taken back: it makes the scans fit worse" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_fix_tells_what_it_took_back_and_how_well_scans_fit(
    clean: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(ScaleAngles(SCANS, 1.01, True).apply(clean), tmp_path / "log")
    narrower = Repair("scale_angles", "/scan", {"factor": 1.0 / 1.01})
    monkeypatch.setattr(
        "slamsim.run.fixing.check_stage",
        lambda one, stages: _steady(partial(_until_narrow, [narrower, LATE]))(one),
    )
    words = ["fix", str(tmp_path / "log"), str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, words)
    found = json.loads(result.stdout)
    assert result.exit_code == 1  # what is proposed again has not been repaired
    assert [one["operation"] for one in found["applied"]] == ["scale_angles"]
    assert [one["repair"]["operation"] for one in found["taken_back"]] == ["shift_stamps"]
    assert found["beam_end_error_m"]["after"] < found["beam_end_error_m"]["before"]


def _until_narrow(repairs: Sequence[Repair], recording: Recording) -> Sequence[Repair]:
    step_rad = recording.scans[0].layouts[0].angle_step_rad
    return repairs if abs(np.rad2deg(step_rad)) > 1.005 else repairs[1:]


def _not_worse(case: Case, folder: Path, seconds: float = SECONDS) -> None:
    found = restored(_made(case, folder, seconds), "all", check_recording)
    assert not change(found.before, found.after).worse, (case.name, found.applied)


@pytest.mark.long
def test_a_recording_with_two_faults_is_not_worse_than_before(tmp_path: Path) -> None:
    _not_worse(cases([0], 0, 0, ["laser_yaw_-2deg+track_2%@0"])[0], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(60))
def test_no_recording_with_random_faults_is_worse_than_before(number: int, tmp_path: Path) -> None:
    *_, case = [one for one in cases([number], 0, 1) if one.sort == "pair"]
    _not_worse(case, tmp_path, 40.0)
