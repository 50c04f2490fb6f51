"""Stamps of single streams: every fault by its name, and no false alarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recording_data import LAYOUT, edge, imu_at, odometry_at, recording, scans_at, stamps

from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.question import judge
from slamsim.check.questions.clocks.offsets import CULPRITS
from slamsim.check.questions.streams.rounding import rounding_step_s
from slamsim.check.questions.streams.series import held_up_s, series_of, usual_step_s
from slamsim.check.questions.streams.spacing import ROUNDING
from slamsim.check.questions.streams.stamps import check_stamps
from slamsim.core.types import IntArray
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    Recording,
)
from slamsim.recording.edits.messages import select
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import load_fault


def stamp_findings(recording: Recording) -> list[Finding]:
    return check_stamps(RecordingEvidence(recording))


RNG = np.random.default_rng(5)


def _bad(found: Recording) -> dict[str, set[str]]:
    """Names of faults by the stream they are about."""
    names: dict[str, set[str]] = {}
    for finding in stamp_findings(found):
        if finding.fault is not None:
            names.setdefault(finding.subject, set()).add(finding.fault)
    return names


def _with_scans(change: Callable[[RawScans], RawScans], seconds: float = 60.0) -> Recording:
    made = recording(seconds)
    return made.with_streams(RawScans, (change(made.scans[0]),))


def _restamped(change: Callable[[IntArray], IntArray], seconds: float = 60.0) -> Recording:
    return _with_scans(lambda s: replace(s, stamps_ns=change(s.stamps_ns)), seconds)


def test_a_healthy_recording_is_healthy() -> None:
    findings = stamp_findings(recording())
    assert not [finding for finding in findings if finding.verdict == "fault"]
    asked = {finding.check for finding in findings if finding.subject == "/scan"}
    assert asked == {
        *("time.order", "time.rounding", "time.scatter", "time.repeats", "time.gaps"),
        *("time.overlap", "time.step", "time.invented", "time.receipt", "time.receipt_drift"),
    }


@pytest.mark.long
@settings(max_examples=20)
@example(6.0, 0.0, 0.0, 0.0047, 0.0, 65)
@given(
    rate_hz=st.floats(4.0, 40.0),
    start_s=st.sampled_from([0.0, 17.3, 1_700_000_000.0]),
    jitter_ms=st.floats(0.0, 2.0),
    lost=st.floats(0.0, 0.005),
    latency_ms=st.floats(0.0, 60.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_drivers_usually_do_is_no_fault(
    rate_hz: float, start_s: float, jitter_ms: float, lost: float, latency_ms: float, seed: int
) -> None:
    """Jitter of a driver on a busy computer, a slow network, some lost messages."""
    rng = np.random.default_rng(seed)
    even = stamps(rate_hz, 60.0, start_s)
    even = even[rng.random(even.size) >= lost]
    lasts_ns = round(LAYOUT.beam_dt_s * 1e9 * 59)
    scattered = even + rng.normal(0.0, jitter_ms * 1e6, even.size).astype(np.int64)
    queue_ns = rng.exponential(latency_ms * 1e6, even.size).astype(np.int64)
    received = np.maximum.accumulate(even + 10_000_000 + lasts_ns + queue_ns)
    beam_dt_s = min(LAYOUT.beam_dt_s, 0.9 / rate_hz / 59)
    scans = replace(scans_at(scattered, received), layouts=(replace(LAYOUT, beam_dt_s=beam_dt_s),))
    found = stamp_findings(Recording("usual", "memory", streams=(scans,)))
    assert [finding.words for finding in found if finding.verdict == "fault"] == []


def test_stamps_that_step_back_are_counted_and_sized() -> None:
    def stepped(stamps_ns: IntArray) -> IntArray:
        found = stamps_ns.copy()
        found[[100, 200, 300]] -= 250_000_000
        return found

    finding = next(
        f for f in stamp_findings(_restamped(stepped)) if f.check == "time.order" and f.fault
    )
    assert finding.fault == "stamps_backward"
    assert finding.estimate is not None and finding.estimate.value == 3.0
    assert "0.15 s" in finding.words


def test_an_unordered_stream_without_a_beat_is_to_be_sorted() -> None:
    def shuffled(stamps_ns: IntArray) -> IntArray:
        wild = np.cumsum(np.random.default_rng(2).exponential(1e8, stamps_ns.size))
        return np.asarray(np.random.default_rng(3).permutation(wild), dtype=np.int64)

    repairs = [m for f in stamp_findings(_restamped(shuffled)) for m in f.repairs if f.fault]
    assert "reorder" in {repair.operation for repair in repairs}


@pytest.mark.parametrize("step_s", [1.0, 0.5, 0.1, 1.0 / 64.0, 0.05, 0.02])
@pytest.mark.parametrize("rate_hz", [9.7, 13.1, 38.3])
def test_coarse_stamps_are_named_with_their_step(step_s: float, rate_hz: float) -> None:
    even = stamps(rate_hz, 60.0, 3.21)
    step_ns = round(step_s * 1e9)
    scans = replace(scans_at(even // step_ns * step_ns), layouts=(replace(LAYOUT, beam_dt_s=0.0),))
    found = [f for f in stamp_findings(Recording("c", "memory", streams=(scans,))) if f.fault]
    assert "stamps_quantised" in {finding.fault for finding in found}
    named = next(f for f in found if f.fault == "stamps_quantised")
    assert named.estimate is not None
    assert named.estimate.value == pytest.approx(1e3 * step_s)


@pytest.mark.parametrize("begin_s", [0.0, 0.025, 0.05, 0.075])
def test_coarse_stamps_that_scattered_before_they_were_rounded(begin_s: float) -> None:
    """At 8 Hz every fourth stamp falls on a tenth of a second, before or behind which is chance."""
    rng = np.random.default_rng(3)
    even_s = 100.0 + begin_s + 0.125 * np.arange(480) + 3e-4 * rng.standard_normal(480)
    assert rounding_step_s(np.diff(np.floor(10.0 * even_s) / 10.0)) == 0.1


def test_stamps_as_even_as_the_step_they_are_rounded_to() -> None:
    """At 10 Hz rounded to tenths: all fall near an edge, before or behind which is chance. Messages
    that are repeated or held up do not."""
    rng = np.random.default_rng(3)
    even_s = 100.0 + 0.1 * np.arange(600)
    scattered_s = even_s + 3e-4 * rng.standard_normal(600) + 2e-4 * np.sin(even_s / 5.0)
    assert rounding_step_s(np.diff(np.floor(10.0 * scattered_s) / 10.0)) == 0.1
    for share, late_s in ((0.04, -0.1), (0.04, 0.1), (0.2, -0.1)):
        single = np.where(rng.random(600) < share, late_s, 0.0)
        assert rounding_step_s(np.diff(np.maximum.accumulate(even_s + single))) == 0.0


def test_single_precision_is_named_as_such() -> None:
    unix = stamps(10.0, 900.0, 1_700_000_000.0)
    single = np.asarray((unix * 1e-9).astype(np.float32).astype(np.float64) * 1e9, dtype=np.int64)
    found = stamp_findings(Recording("single", "memory", streams=(scans_at(single, None),)))
    words = [f.words for f in found if f.fault == "stamps_quantised"]
    assert words and "single precision" in words[0] and "128 s" in words[0]
    tenths = np.asarray(stamps(8.0, 60.0, 1_700_000_000.0) // 100_000_000 * 100_000_000)
    found = stamp_findings(Recording("tenths", "memory", streams=(scans_at(tenths, None),)))
    words = [f.words for f in found if f.fault == "stamps_quantised"]
    assert words and "single precision" not in words[0]


@given(rate_hz=st.floats(1.0, 200.0), start=st.floats(0.0, 1e4), lost=st.floats(0.0, 0.1))
def test_an_even_stream_is_never_called_rounded(rate_hz: float, start: float, lost: float) -> None:
    """However its rate fits the grid, and though messages are lost."""
    even = stamps(rate_hz, 4000.0 / rate_hz, start)
    even = even[np.random.default_rng(1).random(even.size) >= lost]
    assert rounding_step_s(np.diff(even) * 1e-9) == 0.0


def test_repeated_stamps_are_named() -> None:
    def repeated(stamps_ns: IntArray) -> IntArray:
        found = stamps_ns.copy()
        found[20::20] = found[19::20][: found[20::20].size]
        return found

    assert _bad(_restamped(repeated)) == {"/scan": {"stamps_repeated"}}


def test_all_stamps_the_same_is_a_verdict() -> None:
    names = _bad(_restamped(lambda stamps_ns: np.full_like(stamps_ns, 5)))
    assert "stamps_repeated" in names["/scan"]


@pytest.mark.parametrize("sigma_s", [0.008, 0.02, 0.04])
def test_scatter_about_a_beat_is_measured(sigma_s: float) -> None:
    scattered = _restamped(
        lambda t: np.sort(t + RNG.normal(0.0, sigma_s * 1e9, t.size).astype(np.int64)), 120.0
    )
    found = next(f for f in stamp_findings(scattered) if f.fault == "stamps_jitter")
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(1e3 * sigma_s, rel=0.25)


def test_a_sensor_without_a_beat_is_not_accused() -> None:
    """What comes unevenly may be stamped rightly: this is not to be told from stamps."""
    uneven = np.cumsum(RNG.uniform(0.07e9, 0.3e9, 2000)).astype(np.int64)
    found = stamp_findings(Recording("u", "memory", streams=(scans_at(uneven),)))
    scatter = next(f for f in found if f.check == "time.scatter")
    assert scatter.verdict == "inconclusive" and "beat" in scatter.words
    assert not [f.words for f in found if f.fault]


@pytest.mark.parametrize(("share", "is_bad"), [(0.003, False), (0.05, True)])
def test_missing_messages_are_counted(share: float, is_bad: bool) -> None:
    keep = np.random.default_rng(4).random(3000) >= share
    scans = scans_at(stamps(10.0, 300.0)[keep])
    found = next(
        f
        for f in stamp_findings(Recording("m", "memory", streams=(scans,)))
        if f.check == "time.gaps"
    )
    assert (found.fault == "stream_gaps") == is_bad
    assert f"{int((~keep[1:-1]).sum())} missing" in found.words


def test_one_long_gap_is_enough() -> None:
    keep = np.ones(6000, dtype=np.bool_)
    keep[3000:3015] = False
    scans = scans_at(stamps(10.0, 600.0)[keep])
    assert _bad(Recording("g", "memory", streams=(scans,)))["/scan"] == {"stream_gaps"}


@pytest.mark.parametrize("lost", [False, True])
def test_a_recorder_that_keeps_a_scan_each_half_metre_loses_none(lost: bool) -> None:
    """As logs that were thinned for a pose graph: steps are no whole numbers of the usual one, and
    long where the robot rests. What is missing while it drives is missing all the same."""
    beat_s, rng = 0.44, np.random.default_rng(5)
    speed_m_s = np.repeat(rng.choice([0.14, 0.25, 0.29], 200, p=[0.2, 0.2, 0.6]), 30)
    speed_m_s[3000:3150] = 0.0
    since_s = beat_s * np.arange(speed_m_s.size)
    travel_m = np.concatenate([[0.0], np.cumsum(beat_s * speed_m_s[1:])])
    kept = np.unique(np.floor(travel_m / 0.5), return_index=True)[1]
    kept = np.union1d(kept, kept[::10] + 1)[:-1]  # it turned: sooner than half a metre
    if lost:
        kept = np.delete(kept, slice(400, 430))
    stamps_ns = np.rint(1e9 * since_s[kept]).astype(np.int64)
    poses = odometry_at(stamps_ns)
    line_m = np.column_stack([travel_m[kept], *np.zeros((2, kept.size))])
    made = Recording(
        "k", "memory", streams=(scans_at(stamps_ns), replace(poses, positions_m=line_m))
    )
    (gaps,) = [f for f in stamp_findings(made) if f.check == "time.gaps" and f.subject == "/scan"]
    assert gaps.verdict == ("fault" if lost else "ok"), gaps.words


def _hole(odometry: RawOdometry | None) -> Finding:
    """About a lidar without a beat that is silent for 60 s, while the robot drives on."""
    uneven = np.cumsum(np.random.default_rng(3).uniform(0.07e9, 0.3e9, 1000)).astype(np.int64)
    uneven[500:] += 60_000_000_000
    streams: list[RawStream] = [scans_at(uneven)]
    streams += [] if odometry is None else [odometry]
    found = stamp_findings(Recording("h", "memory", streams=tuple(streams)))
    return next(f for f in found if f.check == "time.gaps" and f.subject == "/scan")


@pytest.mark.parametrize(
    "odometry", ["none", "stands", "elsewhere", "ends early", "no numbers", "drives"]
)
def test_no_odometry_hides_a_hole(odometry: str) -> None:
    made = odometry_at(stamps(20.0, 260.0, 0.0))
    kinds = {
        "none": None,
        "stands": replace(made, positions_m=0.0 * made.positions_m),
        "elsewhere": odometry_at(stamps(20.0, 260.0, 1.7e9)),
        "ends early": odometry_at(stamps(20.0, 60.0, 0.0)),
        "no numbers": replace(made, positions_m=np.nan * made.positions_m),
        "drives": made,
    }
    gaps = _hole(kinds[odometry])
    assert gaps.fault == "stream_gaps" and "longest gap 60" in gaps.words


def test_scans_that_come_late_or_twice_hide_no_gap() -> None:
    """One in twelve a millisecond after another: no recorder that keeps scans by distance."""
    at_ns = stamps(10.0, 200.0)
    at_ns = np.delete(at_ns, slice(900, 982))
    twice_ns = np.sort(np.append(at_ns, at_ns[::12] + 1_000_000))
    made = (scans_at(twice_ns), odometry_at(stamps(20.0, 210.0, 95.0)))
    found = stamp_findings(Recording("t", "memory", streams=made))
    assert [f.fault for f in found if f.check == "time.gaps" and f.subject == "/scan"] == [
        "stream_gaps"
    ]


def test_the_stream_of_another_epoch_is_named_and_put_back() -> None:
    found = stamp_findings(_restamped(lambda t: t + 1_700_000_000_000_000_000))
    named = [f for f in found if f.fault]
    assert [(f.fault, f.subject) for f in named] == [("epoch_mismatch", "/scan")]
    offset = named[0].repairs[0].parameters["offset_s"]
    assert float(offset) == pytest.approx(-1_700_000_000.0, abs=0.1)


@pytest.mark.parametrize(("by_s", "name"), [(-0.2, "stamps_future"), (0.9, "stamps_late")])
def test_receipt_before_the_stamp_or_long_after(by_s: float, name: str) -> None:
    found = _with_scans(lambda s: replace(s, received_ns=s.stamps_ns + round(by_s * 1e9)))
    assert _bad(found) == {"/scan": {name}}


@pytest.mark.parametrize("ppm", [-300.0, 250.0, 1000.0])
def test_a_drifting_clock_is_measured_against_the_receiver(ppm: float) -> None:
    def drifting(scans: RawScans) -> RawScans:
        since = scans.stamps_ns - scans.stamps_ns[0]
        queue = RNG.exponential(3e6, since.size).astype(np.int64)
        received = scans.stamps_ns + 70_000_000 + queue
        stamps_ns = scans.stamps_ns + np.rint(since * ppm * 1e-6).astype(np.int64)
        return replace(scans, stamps_ns=stamps_ns, received_ns=received)

    found = [f for f in stamp_findings(_with_scans(drifting, 300.0)) if f.fault == "clock_drift"]
    assert [f.subject for f in found] == ["/scan"]
    assert found[0].estimate is not None
    low, high = found[0].estimate.interval
    assert low - 2.0 < ppm < high + 2.0


@pytest.mark.parametrize("jump_s", [-0.08, -0.02, 0.02, 0.3, 40.0])
def test_a_clock_that_is_set_is_named_and_set_back(jump_s: float) -> None:
    fault = load_fault("lidar_clock_step").with_size(jump_s)
    made = recording(60.0)
    jumped = fault.inject(made, RNG)
    (found,) = [one for one in stamp_findings(jumped) if one.fault == "clock_step"]
    assert found.subject == "/scan" and found.estimate is not None
    assert found.estimate.value == pytest.approx(1e3 * abs(jump_s), abs=0.01)
    repaired = apply_repairs(jumped, found.repairs)
    np.testing.assert_allclose(repaired.scans[0].stamps_ns, made.scans[0].stamps_ns, atol=2)
    told = {one.fault for one in explained(stamp_findings(jumped)) if one.fault is not None}
    assert told == {"clock_step"}


@settings(max_examples=12)
@given(st.lists(st.tuples(st.integers(0, 599), st.floats(0.0, 0.5)), max_size=8), st.booleans())
def test_messages_that_wait_in_a_queue_are_no_clock_that_is_set(
    waits: list[tuple[int, float]], for_good: bool
) -> None:
    """Delays of the network, for a while or for the rest of the recording: stamps stay even."""
    made = recording(60.0).scans[0]
    assert made.received_ns is not None
    received = made.received_ns.copy()
    for at, wait_s in waits:
        until = at + 60 if not for_good else received.size
        received[at:until] += round(1e9 * wait_s)
    late = replace(made, received_ns=np.maximum.accumulate(received))
    findings = stamp_findings(recording(60.0).with_streams(RawScans, (late,)))
    assert not [one for one in findings if one.fault == "clock_step"]


def test_messages_in_bursts_are_not_counted_as_missing() -> None:
    """Ten at a time, a tenth of a millisecond apart, as a driver stamps what it reads at once."""
    made = recording(60.0)
    count = np.arange(len(made.imus[0]))
    burst = np.asarray(count // 10 * 100_000_000 + count % 10 * 100_000, dtype=np.int64)
    findings = stamp_findings(
        made.with_streams(RawImu, (replace(made.imus[0], stamps_ns=burst, received_ns=None),))
    )
    (gaps,) = [one for one in findings if (one.check, one.subject) == ("time.gaps", "/imu")]
    assert gaps.verdict == "ok" and "100.1 messages a second, 0 missing" in gaps.words


@settings(max_examples=12)
@given(share=st.floats(0.06, 0.4), sigma_ms=st.floats(0.0, 2.0), seed=st.integers(0, 999))
def test_lost_messages_are_no_scatter(share: float, sigma_ms: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kept = rng.random(600) >= share
    kept[[0, -1]] = True
    scattered = 100_000_000 * np.arange(600) + rng.normal(0.0, 1e6 * sigma_ms, 600).astype(int)
    made = recording(60.0)
    lost = scans_at(np.asarray(scattered[kept], dtype=np.int64))
    bad = _bad(made.with_streams(RawScans, (replace(lost, received_ns=None),)))
    assert bad == {"/scan": {"stream_gaps"}}


def test_messages_that_come_late_and_then_all_at_once_are_not_missing() -> None:
    """Stamped when received, by a computer that is busy for 0.4 s now and then."""
    made = recording(60.0).imus[0]
    late = made.stamps_ns.copy()
    for at in range(300, late.size, 700):
        late[at : at + 40] = late[at + 40]
    restamped = replace(made, stamps_ns=late, received_ns=None)
    findings = stamp_findings(recording(60.0).with_streams(RawImu, (restamped,)))
    (gaps,) = [one for one in findings if (one.check, one.subject) == ("time.gaps", "/imu")]
    assert gaps.verdict == "ok"
    (scatter,) = [one for one in findings if (one.check, one.subject) == ("time.scatter", "/imu")]
    assert scatter.fault == "stamps_jitter" and "360 of 6,000" in scatter.words


@given(
    rate_hz=st.floats(5.0, 200.0),
    pauses=st.integers(0, 6),
    pause_s=st.floats(0.05, 0.5),
    seed=st.integers(0, 2**32 - 1),
)
@example(rate_hz=9.5, pauses=4, pause_s=0.18461831060645423, seed=213978912)
@example(rate_hz=5.0, pauses=5, pause_s=0.4564838504213904, seed=5)
def test_held_up_messages_against_what_was_held_up(
    rate_hz: float, pauses: int, pause_s: float, seed: int
) -> None:
    """Messages that were due in a pause are let through at its end, one behind the other."""
    rng = np.random.default_rng(seed)
    even = stamps(rate_hz, 60.0, 0.0)
    stamped = even.copy()
    for number in range(pauses):
        begin_ns = even[0] + round(1e9 * (3.0 + 8.0 * number + rng.uniform(0.0, 4.0)))
        waits = (even > begin_ns) & (even < begin_ns + 1e9 * pause_s)
        stamped[waits] = begin_ns + round(1e9 * pause_s) + 1000 * np.arange(waits.sum())
    late_s = held_up_s(stamped)
    # A single message that waits leaves a long step and a short one: any jitter does.
    true_s = (stamped - even) * 1e-9
    several = (true_s > 0.0) & (late_s > 0.0)
    assert np.abs(late_s - true_s)[several].max(initial=0.0) < 1.0 / rate_hz
    # One that comes right behind is late by as much as the usual step is off, for each message.
    off_s = abs(usual_step_s(np.diff(stamped) * 1e-9) - 1.0 / rate_hz)
    assert late_s[true_s == 0.0].max(initial=0.0) < (pause_s * rate_hz + 2.0) * off_s + 1e-6
    assert off_s < 0.01 / rate_hz
    if pause_s * rate_hz > 4.0:
        assert (late_s > 0.0).sum() >= 0.5 * (true_s > 0.0).sum()


def test_a_pause_after_which_messages_are_missing_holds_none_up() -> None:
    even = stamps(50.0, 60.0, 0.0)
    assert not held_up_s(np.delete(even, np.s_[500:520])).any()


@pytest.mark.parametrize(
    ("period_ns", "others_late_ms", "invented"),
    [
        (100_000_000, (2.0, 3.0), True),
        (100_013_713, (2.0, 3.0), True),
        (100_013_713, (0.0, 0.0), True),
        (100_000_000, (0.0, 0.0), False),
        (33_333_333, (0.0, 0.0), False),
        (100_000_000, (2.5, 2.5), False),
        (116_666_667, (0.0, 0.0), False),  # each seventh step at 60 Hz
    ],
)
def test_counted_stamps(
    period_ns: int, others_late_ms: tuple[float, float], invented: bool
) -> None:
    """A simulator's are as even, and received at once, or always as late; at a round rate."""
    made = recording(60.0)
    even = 100_000_000_000 + period_ns * np.arange(600)
    scans = scans_at(even, even.copy())
    rng = np.random.default_rng(0)

    def received(one: RawStream) -> RawStream:
        late_ns = (1e6 * rng.uniform(*others_late_ms, len(one))).astype(np.int64)
        return replace(one, received_ns=one.stamps_ns + late_ns)

    made = made.changed(RawStream, received)
    findings = stamp_findings(made.with_streams(RawScans, (scans,)))
    (found,) = [one for one in findings if (one.check, one.subject) == ("time.invented", "/scan")]
    assert (found.fault == "stamps_invented") == invented
    others = {one.subject for one in findings if one.check == "time.invented" and one.fault}
    assert others <= {"/scan"}


@pytest.mark.parametrize("rate_hz", [400.0, 300.0, 150.0, 70.0])
def test_stamps_in_whole_milliseconds_miss_nothing(rate_hz: float) -> None:
    made = recording(60.0)
    count = np.arange(round(60.0 * rate_hz))
    whole = np.asarray(count / rate_hz * 1e3, dtype=np.int64) * 1_000_000
    series = imu_at(whole)
    findings = stamp_findings(made.with_streams(RawImu, (replace(series, received_ns=None),)))
    (gaps,) = [one for one in findings if (one.check, one.subject) == ("time.gaps", "/imu")]
    assert gaps.verdict == "ok" and " 0 missing" in gaps.words


def test_one_stamp_on_all_messages_is_no_even_beat() -> None:
    stuck = _restamped(np.zeros_like)
    (scatter,) = [
        one
        for one in stamp_findings(stuck)
        if (one.check, one.subject) == ("time.scatter", "/scan")
    ]
    assert scatter.verdict == "inconclusive" and "1 different stamps" in scatter.words


def test_a_coarse_clock_is_not_blamed_on_another_sensor() -> None:
    coarse = judge(ROUNDING, "/imu", "coarse", verdict="fault")
    late = judge(CULPRITS["lidar"], "/scan", "early", verdict="fault")
    assert [one.verdict for one in explained([coarse, late])] == ["fault", "inconclusive"]


@pytest.mark.slow
def test_a_replay_at_another_speed_is_no_drift() -> None:
    """All streams gain alike on the receiver: nothing is wrong between them."""
    made = recording(60.0)

    def slower(stamps_ns: IntArray) -> IntArray:
        return 5_000_000_000 + 2 * (stamps_ns - 100_000_000_000)

    found = (
        made.changed(RawScans, lambda s: replace(s, received_ns=slower(s.stamps_ns)))
        .changed(RawImu, lambda s: replace(s, received_ns=slower(s.stamps_ns)))
        .changed(RawTicks, lambda s: replace(s, received_ns=slower(s.stamps_ns)))
        .changed(RawOdometry, lambda s: replace(s, received_ns=slower(s.stamps_ns)))
    )
    drifts = [f for f in stamp_findings(found) if f.check == "time.receipt_drift"]
    assert {finding.verdict for finding in drifts} == {"ok"}


def test_stamps_made_up_at_a_constant_rate_are_contradicted_by_their_receipt() -> None:
    def numbered(scans: RawScans) -> RawScans:
        keep = RNG.random(len(scans)) >= 0.2
        return replace(scans_at(scans.stamps_ns[: keep.sum()], scans.stamps_ns[keep] + 70_000_000))

    assert _bad(_with_scans(numbered, 120.0))["/scan"] >= {"stamps_invented"}


@pytest.mark.parametrize("same", [True, False])
def test_parts_of_a_recording_that_overlap_are_told_by_their_copies(same: bool) -> None:
    """Copies are left out; others with one stamp are stamped anew."""
    made = recording(60.0)
    rows = np.sort(np.concatenate([np.arange(200), np.arange(100, len(made.scans[0]))]))

    def overlapping(scans: RawScans) -> RawScans:
        twice = select(scans, rows)
        noise = np.arange(len(twice), dtype=np.float32)[:, None] * (not same)
        return replace(twice, ranges_m=np.asarray(twice.ranges_m) + noise)

    faulty = made.changed(RawScans, overlapping)
    (found,) = (one for one in stamp_findings(faulty) if one.fault)
    assert {repair.operation for repair in found.repairs} == {
        "drop_copies" if same else "restamp_evenly"
    }
    if same:
        fixed = apply_repairs(faulty, found.repairs).scans[0]
        np.testing.assert_array_equal(fixed.stamps_ns, made.scans[0].stamps_ns)
        np.testing.assert_array_equal(fixed.ranges_m, made.scans[0].ranges_m)


def test_scans_that_last_longer_than_their_period() -> None:
    found = _with_scans(lambda s: replace(s, layouts=(replace(LAYOUT, beam_dt_s=3e-3),)))
    assert _bad(found) == {"/scan": {"scans_overlap"}}


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("which", "lasts_s", "told"),
    [
        (slice(None, None, 10), 0.3, {"scans_overlap"}),
        (slice(None, None, 150), 0.3, set()),
        (slice(200, 201), 30.0, {"scans_overlap"}),
        (slice(0, 1), 30.0, set()),
    ],
    ids=["many", "few", "one for seconds", "the first for seconds"],
)
def test_some_scans_that_end_after_the_next_one_has(
    which: slice, lasts_s: float, told: set[str], way: float
) -> None:
    """A few may, for a computer is late, but not by many periods unless the motor starts."""

    def longer(scans: RawScans) -> RawScans:
        layout_of = np.zeros(len(scans), dtype=np.int32)
        layout_of[which] = 1
        longest = replace(LAYOUT, beam_dt_s=way * lasts_s / (scans.ranges_m[0].size - 1))
        return replace(scans, layouts=(LAYOUT, longest), layout_of=layout_of)

    assert _bad(_with_scans(longer)).get("/scan", set()) == told


def test_receipt_by_the_wall_clock_is_read_on_the_simulated_one() -> None:
    """A simulation at 0.7 of real time, recorded with the wall's clock beside /clock."""
    made = recording(60.0)
    wall = 1_700_000_000_000_000_000
    clock = np.arange(100_000_000_000, 165_000_000_000, 20_000_000)

    def wall_of(sim_ns: IntArray) -> IntArray:
        return wall + ((sim_ns - 100_000_000_000) / 0.7).astype(np.int64)

    found = replace(
        made.changed(RawScans, lambda s: replace(s, received_ns=wall_of(s.stamps_ns + 70_000_000))),
        clock_ns=np.column_stack([clock, wall_of(clock)]),
    )
    latency_s = series_of(found)[0].latency_s
    assert latency_s is not None
    assert latency_s == pytest.approx(0.07, abs=1e-3)


def test_few_messages_and_none() -> None:
    assert stamp_findings(Recording("none", "memory"))[0].verdict == "inconclusive"
    for count in (1, 2, 3, 19):
        found = check_stamps(
            RecordingEvidence(
                Recording("few", "memory", streams=(scans_at(stamps(10.0, 2.0)[:count]),))
            )
        )
        assert {f.verdict for f in found if f.check == "time.spacing"} <= {"inconclusive"}
        assert not [f for f in found if f.fault]


def test_transforms_are_asked_for_their_order_only() -> None:
    backward = stamps(50.0, 20.0)[::-1].copy()
    found = check_stamps(
        RecordingEvidence(
            Recording("tf", "memory", transforms=(edge("odom", "base", backward, static=False),))
        )
    )
    assert [f.fault for f in found if f.subject == "/tf odom -> base"] == ["stamps_backward"]
