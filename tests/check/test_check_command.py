"""slamsim check and fix as they are typed, on good recordings and on bad ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import ROS2, START_NS, Message, Robot, as_mcap
from recording_data import recording, scans_at, stamps
from typer.testing import CliRunner

from slamsim.check.check import check_recording
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.registry import registry
from slamsim.cli.main import app
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_log, read_recording
from slamsim.recording import Messages, RawImu, RawOdometry, RawScans, RawTicks, Recording

ROBOT = Robot(ROS2)


def _written(made: Recording, folder: Path) -> Path:
    write_recording(made, folder)
    return folder


def _run(*words: str | Path) -> tuple[int, dict[str, Any], BaseException | None]:
    """(exit code, JSON, what a person would be told)."""
    result = CliRunner().invoke(app, [*map(str, words), "--json"])
    found = json.loads(result.stdout) if result.stdout.strip() else {}
    code = result.exit_code
    if isinstance(result.exception, SlamsimError):
        code = result.exception.exit_code
    return code, found, result.exception


def test_nothing_bad_ends_with_0_and_something_bad_with_1(tmp_path: Path) -> None:
    made = recording()
    code, found, _ = _run("check", _written(made, tmp_path / "good"), "--quick")
    assert (code, found["bad"], found["faults"]) == (0, 0, [])
    assert found["ok"] > 20 and {"seconds", "unread", "odd"} <= found.keys()
    late = replace(made.scans[0], stamps_ns=made.scans[0].stamps_ns + 10**18)
    bad = _written(made.with_streams(RawScans, (late,)), tmp_path / "bad")
    code, found, _ = _run("check", bad, "--quick", "--html", tmp_path / "page.html")
    assert code == 1 and "epoch_mismatch" in found["faults"]
    first = next(f for f in found["findings"] if f["fault"] == "epoch_mismatch")
    assert first["subject"] == "/scan" and first["advice"]
    assert first["repairs"][0]["operation"] == "shift_stamps"
    assert "epoch_mismatch" in (tmp_path / "page.html").read_text()


def test_what_cannot_be_read_is_no_verdict_but_one_sentence(tmp_path: Path) -> None:
    text = tmp_path / "notes.mcap"
    text.write_text("this is a shopping list\n" * 100)
    whole = as_mcap(tmp_path / "whole.mcap", ROBOT.drive())
    half = tmp_path / "half.mcap"
    half.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    empty = tmp_path / "empty.log"
    empty.write_text("")
    for path in (text, half, empty, tmp_path / "nowhere.mcap", tmp_path):
        code, found, error = _run("check", path)
        assert code == (3 if path.exists() else 10) and not found
        assert isinstance(error, InputRefused | NotFound)
        assert "\n" not in str(error).strip()


def _constant(value: float) -> Recording:
    made = recording()
    imu, odometry = made.imus[0], made.odometries[0]
    return (
        made.with_streams(
            RawScans,
            (replace(made.scans[0], ranges_m=np.full((300, 60), value, dtype=np.float32)),),
        )
        .with_streams(
            RawImu,
            (
                replace(
                    imu,
                    angular_velocity_rad_s=np.full_like(imu.angular_velocity_rad_s, value),
                    linear_acceleration_m_s2=np.full_like(imu.linear_acceleration_m_s2, value),
                ),
            ),
        )
        .with_streams(
            RawOdometry,
            (
                replace(
                    odometry,
                    positions_m=np.full_like(odometry.positions_m, value),
                    quats_xyzw=np.full_like(odometry.quats_xyzw, value),
                ),
            ),
        )
    )


def _one_of_each() -> Recording:
    made = recording(1.0)
    one = stamps(10.0, 0.1)
    return replace(
        made.with_streams(RawScans, (scans_at(one),))
        .with_streams(RawImu, ())
        .with_streams(RawTicks, ())
        .with_streams(RawOdometry, ()),
        transforms=(),
    )


def _unset(stream: Messages) -> Messages:
    """UNIX time, and now and then 0, as of a driver that does not always stamp."""
    stamps_ns = stream.stamps_ns + 1_700_000_000_000_000_000
    stamps_ns[::50] = 0
    return replace(stream, stamps_ns=stamps_ns)


ODD: dict[str, Recording] = {
    "one scan": _one_of_each(),
    "one stream": replace(
        recording(8.0)
        .with_streams(RawScans, ())
        .with_streams(RawTicks, ())
        .with_streams(RawOdometry, ()),
        transforms=(),
    ),
    "wheels alone": replace(
        recording(8.0).with_streams(RawScans, ()).with_streams(RawImu, ()), transforms=()
    ),
    "nan everywhere": _constant(np.nan),
    "infinity everywhere": _constant(np.inf),
    "zero everywhere": _constant(0.0),
    "huge everywhere": _constant(1e30),
    "two lidars": recording(8.0).with_streams(
        RawScans, (recording(8.0).scans[0], replace(scans_at(stamps(7.0, 8.0)), topic="/rear"))
    ),
    "one stamp": recording(8.0).with_streams(
        RawScans, (replace(scans_at(stamps(10.0, 8.0)), stamps_ns=np.full(80, 7)),)
    ),
    "no beams": recording(8.0).with_streams(
        RawScans,
        (replace(scans_at(stamps(10.0, 8.0)), ranges_m=np.zeros((80, 0), dtype=np.float32)),),
    ),
    "one beam": recording(8.0).with_streams(
        RawScans,
        (replace(scans_at(stamps(10.0, 8.0)), ranges_m=np.ones((80, 1), dtype=np.float32)),),
    ),
    "declared nonsense": recording(8.0).with_streams(
        RawScans,
        (
            replace(
                recording(8.0).scans[0],
                layouts=(
                    replace(
                        recording(8.0).scans[0].layouts[0], angle_step_rad=np.nan, beam_dt_s=-1.0
                    ),
                ),
            ),
        ),
    ),
    "wild stamps": recording(8.0).with_streams(
        RawScans,
        (scans_at(np.random.default_rng(1).integers(-(2**60), 2**60, 80, dtype=np.int64)),),
    ),
    "stamps never set": recording(8.0)
    .with_streams(RawScans, (_unset(recording(8.0).scans[0]),))
    .with_streams(RawImu, (_unset(recording(8.0).imus[0]),))
    .with_streams(RawTicks, (_unset(recording(8.0).ticks[0]),))
    .with_streams(RawOdometry, (_unset(recording(8.0).odometries[0]),)),
    "nothing": Recording("nothing", "memory"),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_recordings_get_verdicts(name: str) -> None:
    """No part of the check may fail on them, and none may take long."""
    report = check_recording(ODD[name])
    failed = [f.words for f in report.findings if f.check.startswith("check.")]
    assert failed == []
    assert report.findings
    json.dumps([repr(finding.estimate) for finding in report.findings])


def test_many_messages_are_checked_in_arrays() -> None:
    """A hundred thousand samples."""
    long = recording(1.0)
    when = stamps(1000.0, 100.0)
    readings = np.random.default_rng(0).normal([0.0, 0.0, 9.81], 0.01, (when.size, 3))
    imu = replace(
        long.imus[0],
        stamps_ns=when,
        received_ns=when + 2_000_000,
        angular_velocity_rad_s=readings,
        linear_acceleration_m_s2=readings,
    )
    report = check_recording(long.with_streams(RawImu, (imu,)), quick=True)
    gaps = next(f for f in report.findings if f.check == "time.gaps" and f.subject == "/imu")
    assert gaps.verdict == "ok"


def test_a_question_that_raises_is_our_fault_and_does_not_cost_the_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(_: RecordingEvidence) -> list[Finding]:
        raise ZeroDivisionError("by nothing")

    asked = registry()
    groups = tuple(
        replace(group, ask=fails) if group.part == "ranges" else group for group in asked.groups
    )
    monkeypatch.setattr("slamsim.check.check.registry", lambda: replace(asked, groups=groups))
    code, found, _ = _run("check", _written(recording(), tmp_path / "good"), "--quick")

    assert (code, found["bad"], found["faults"]) == (1, 1, ["checker_error"])
    (broken,) = (f for f in found["findings"] if f["check"] == "check.ranges")
    assert broken["verdict"] == "bad" and broken["words"].startswith("internal error in the quest")
    assert "ranges.limits" in broken["words"] and "by nothing" in broken["words"]
    assert any(f["check"] == "time.order" for f in found["findings"])


def test_what_several_questions_fail_on_is_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("slamsim.check.evidence.calibrate_inputs", fails)
    report = check_recording(recording(8.0))
    broken = [f for f in report.findings if f.fault == "checker_error"]
    assert [f.check for f in broken] == ["check.motion"] and "by nothing" in broken[0].words
    assert any(f.check == "laser.rotation" for f in report.findings)


def test_the_truth_makes_no_difference(tmp_path: Path) -> None:
    messages: list[Message] = ROBOT.drive()
    for i in range(60):
        stamp_ns = START_NS + 20_000_000 * i
        messages.append(("/ground_truth/odom", stamp_ns, ROBOT.odometry(stamp_ns, 9.0 * i)))
    with_truth = as_mcap(tmp_path / "log.mcap", messages)
    without = tmp_path / "without"
    without.mkdir()
    stripped = as_mcap(without / "log.mcap", ROBOT.drive())
    reports = [check_recording(read_recording(path)) for path in (with_truth, stripped)]
    said = [
        [(f.check, f.subject, f.verdict, f.words) for f in report.findings] for report in reports
    ]
    assert said[0] == said[1]


def test_fix_writes_a_copy_that_checks_clean_and_can_be_read(tmp_path: Path) -> None:
    made = recording()
    scans = made.scans[0]
    zero = np.where(np.random.default_rng(2).random((300, 60)) < 0.3, 0.0, scans.ranges_m)
    damaged = made.with_streams(
        RawScans,
        (
            replace(
                scans,
                ranges_m=zero.astype(np.float32),
                stamps_ns=scans.stamps_ns + 1_700_000_000_000_000_000,
            ),
        ),
    )
    source = _written(damaged, tmp_path / "damaged")
    names = "shift_stamps,zero_to_inf"
    code, found, _ = _run("fix", source, tmp_path / "repaired", "--apply", names)
    applied = [repair["operation"] for repair in found["applied"]]
    assert set(applied) == {"shift_stamps", "zero_to_inf"}
    assert not {"epoch_mismatch", "range_zero_no_return"} & set(found["faults"])
    assert code == (1 if found["bad"] else 0)
    log = read_log(tmp_path / "repaired")
    assert len(log.scans) == 300
    assert not list(tmp_path.glob(".*"))
    again = read_recording(tmp_path / "repaired").scans[0]
    assert np.abs(again.stamps_ns - scans.stamps_ns).max() < 200_000_000


def test_fix_refuses_in_one_sentence(tmp_path: Path) -> None:
    source = _written(recording(8.0), tmp_path / "good")
    code, _, error = _run("fix", source, tmp_path / "out", "--apply", "shift_stampz")
    assert code == 1 and "did you mean 'shift_stamps'" in str(error)
    code, _, error = _run("fix", source, tmp_path / "out", "--apply", "reorder")
    assert (code == 1 and "nothing to repair" in str(error)) or "does not propose" in str(error)
    assert not (tmp_path / "out").exists()
