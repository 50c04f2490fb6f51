"""The bench of the checker: which trials there are, and what is counted of their outcomes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamsim.bench.check.campaign import CheckCampaign, random_scenario, run_campaign, run_seed
from slamsim.bench.check.outcome import (
    CheckOutcome,
    Measured,
    clean_trial,
    curve_trials,
    fault_trials,
    outcome_of,
    pair_trials,
)
from slamsim.bench.check.summary import coverage, run_line, summarise, summary_tables
from slamsim.bench.check.truth import truths
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import SlamsimError
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import bundled_faults, load_fault


def outcome(
    sort: str = "fault",
    expects: tuple[str, ...] = ("gyro_sign",),
    said: tuple[str, ...] = ("gyro_sign",),
    also: tuple[str, ...] = (),
    measured: tuple[Measured, ...] = (),
    skipped: str = "",
) -> CheckOutcome:
    truth = {"gyro.scale": 1.0}
    return CheckOutcome("gyro_sign", sort, expects, also, said, (), measured, truth, 0.5, skipped)


def run_of(*outcomes: CheckOutcome) -> dict[str, object]:
    listed = [one.as_json() for one in outcomes]
    return {"drive": "seed 1", "world": "loop", "lidar": "lds_01", "outcomes": listed}


def test_a_scenario_is_the_same_each_time_and_another_for_another_seed() -> None:
    assert random_scenario(5, 30.0) == random_scenario(5, 30.0)
    assert random_scenario(5, 30.0).config != random_scenario(6, 30.0).config


def test_scenarios_draw_every_world_and_lidar() -> None:
    drawn = [random_scenario(seed, 30.0) for seed in range(1, 41)]

    assert {one.world for one in drawn} == {"labyrinth", "rooms", "loop", "symmetric"}
    assert len({one.lidar for one in drawn}) == 5


def test_a_scenario_is_healthy() -> None:
    """Errors that a careful user leaves, no offsets or drifts of clocks."""
    for seed in range(1, 21):
        sensors = random_scenario(seed, 30.0).config.sensors
        for stream in (sensors.lidar, sensors.imu, sensors.encoders):
            assert stream.clock.offset_s == 0.0
            assert stream.clock.drift_ppm == 0.0
            assert stream.clock.jitter_s <= 1e-4
        assert abs(sensors.encoders.wheel_radius_error) <= 0.005
        assert abs(sensors.encoders.track_error) <= 0.01


def test_every_fault_and_every_size_is_tried_once() -> None:
    faults = bundled_faults()

    names = [trial.name for trial in [clean_trial(), *fault_trials(faults), *curve_trials(faults)]]

    assert len(set(names)) == len(names)
    assert len(names) == 1 + len(faults) + sum(len(fault.sizes) for fault in faults)


def test_a_fault_that_the_checker_cannot_report_is_refused() -> None:
    mistyped = load_fault("laser_mirrored").model_copy(update={"expects": "laser_mirored"})
    with pytest.raises(SlamsimError, match="cannot report; did you mean 'laser_mirrored'"):
        run_campaign(CheckCampaign([mistyped], seeds=()), Reporter(quiet=True, as_json=False))


def test_pairs_can_both_be_told() -> None:
    pairs = pair_trials(bundled_faults(), 200, seed=1)

    assert len({trial.name for trial in pairs}) == 200
    for trial in pairs:
        one, other = trial.faults
        assert one.expects != other.expects
        assert one.expects not in (*other.also, *other.hides)
        assert other.expects not in (*one.also, *one.hides)


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ("lidar_late", "lidar_early", False),
        ("lidar_late", "gyro_scale", True),
        ("laser_world_fixed", "laser_forward", False),
        ("urdf_cut", "urdf_inertia", False),
        ("wheel_radius", "wheel_track", True),
    ],
)
def test_what_hides_what(one: str, other: str, apart: bool) -> None:
    assert load_fault(one).told_apart(load_fault(other)) is apart
    assert load_fault(other).told_apart(load_fault(one)) is apart


def test_what_was_asked_for_and_what_follows_from_it_are_not_invented() -> None:
    told = outcome(said=("gyro_sign", "imu_axis", "tf_loop"), also=("imu_axis",))

    assert told.named
    assert told.invented == ("tf_loop",)


def test_a_pair_is_named_if_both_are() -> None:
    assert outcome(expects=("a", "b"), said=("b", "a", "c")).named
    assert not outcome(expects=("a", "b"), said=("b",)).named


def test_an_outcome_survives_json() -> None:
    one = outcome(measured=(Measured("gyro.scale", "/imu", "ok", 1.5, 0.2, "%", None),))

    assert CheckOutcome.from_json(json.loads(json.dumps(one.as_json()))) == one


def test_the_summary_counts_what_was_named_invented_and_skipped() -> None:
    summary = summarise(
        [
            run_of(
                outcome(),
                outcome(said=("tf_loop",)),
                outcome(said=("gyro_sign", "tf_loop")),
                outcome(skipped="no gyroscope"),
                outcome(sort="clean", expects=(), said=()),
                outcome(sort="clean", expects=(), said=("tf_loop",)),
            ),
            {"drive": "seed 2", "error": "the robot is stuck", "outcomes": []},
        ]
    )

    assert summary["drives"] == 2
    assert summary["failed"] == 1
    assert summary["clean"] == {"trials": 2, "alarmed": 1, "names": {"tf_loop": 1}}
    assert summary["faults"] == {
        "gyro_sign": {
            "trials": 3,
            "named": 2,
            "alone": 1,
            "instead": {"tf_loop": 1},
            "besides": {"tf_loop": 1},
        }
    }
    assert summary["skipped"] == {"gyro_sign": 1}
    tables = summary_tables(summary)
    assert tables["Faults"]["gyro_sign"] == "2/3; instead tf_loop 1; besides tf_loop 1"
    assert tables["Checker"]["faults named"].startswith("2 of 3 (66.7 %)")


def test_sizes_of_a_fault_stand_in_one_row() -> None:
    sizes = [replace(outcome(sort="curve"), trial=f"gyro_sign:{size}") for size in (1, 2, 2)]

    tables = summary_tables(summarise([run_of(*sizes)]))

    assert tables["Named, by size"] == {"gyro_sign": "1: 1/1, 2: 2/2"}


def test_a_line_tells_what_was_missed_and_what_was_invented() -> None:
    line = run_line(run_of(outcome(said=()), outcome(sort="clean", expects=(), said=("tf_loop",))))

    assert "clean, yet tf_loop" in line
    assert "missed gyro_sign" in line


def test_honest_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    values = 1.0 + 0.2 * rng.standard_normal(4000)

    figures = coverage(
        outcome(measured=(Measured("gyro.scale", "", "ok", value, 0.2, "%", 0.1),))
        for value in values.tolist()
    )["gyro.scale"]

    assert figures["inside"] == pytest.approx(0.95, abs=0.02)
    assert figures["ratio"] == pytest.approx(1.0, abs=0.05)
    assert figures["over_bound"] == pytest.approx(2.0)
    assert figures["count"] == 4000


def test_an_estimate_without_a_known_truth_is_left_out() -> None:
    measured = (
        Measured("gyro.bias", "", "ok", 1.0, 0.1, "rad/s", None),
        Measured("gyro.scale", "", "cannot tell", 1.0, float("inf"), "%", None),
    )

    assert coverage([outcome(measured=measured)]) == {}


@pytest.mark.parametrize(
    ("name", "size", "check", "value"),
    [
        ("lidar_late", 0.01, "time.offset.lidar_imu", -10.0),
        ("imu_late", 0.01, "time.offset.lidar_imu", 10.0),
        ("wheels_late", 0.01, "time.offset.lidar_wheels", 10.0),
        ("laser_yaw", 2.0, "laser.yaw", 2.0),
        ("laser_forward", 0.02, "laser.x", 20.0),
        ("laser_sideways", 0.02, "laser.y", 20.0),
        ("gyro_scale", 1.02, "gyro.scale", 2.0),
        ("wheel_track", 0.1, "wheels.track", 10.55),
        ("angle_step_wide", 0.002, "laser.angle_step", 0.2),
        ("range_offset", 0.03, "ranges.offset", 30.0),
        ("isaac_half_stamps", 0.5, "laser.sweep", 2.0),
    ],
)
def test_the_truth_of_an_injected_size(name: str, size: float, check: str, value: float) -> None:
    """On the default sensors, whose track is believed half a per cent too long."""
    truth = truths(RunConfig(), [load_fault(name).with_size(size)])

    assert truth[check] == pytest.approx(value)


def test_the_truth_of_a_healthy_drive_holds_what_its_driver_believes() -> None:
    truth = truths(RunConfig(), [])

    assert truth["wheels.radius"] == pytest.approx(0.2)
    assert truth["wheels.track"] == pytest.approx(0.5)
    assert truth["wheels.unequal"] == pytest.approx(0.1)


def test_of_two_faults_no_number_is_known() -> None:
    assert truths(RunConfig(), [load_fault("lidar_late"), load_fault("laser_yaw")]) == {}


def test_a_fault_that_finds_nothing_to_change_is_skipped() -> None:
    def damaged(faults: Sequence[Fault]) -> Recording:
        raise CannotEdit("no gyroscope")

    skipped = outcome_of(fault_trials([load_fault("gyro_sign")])[0], damaged, {})

    assert skipped.skipped == "no gyroscope"
    assert skipped.said == ()


def test_a_broken_description_is_named_in_an_otherwise_empty_recording() -> None:
    """End to end, on what costs nothing to make."""
    recording = Recording("bare", "memory", robot_description="<robot name='r'><link")

    told = outcome_of(fault_trials([load_fault("urdf_cut")])[0], lambda faults: recording, {})

    assert told.named


@pytest.mark.slow
def test_what_was_kept_is_taken_over(tmp_path: Path) -> None:
    """A campaign in processes of their own; then the same from what it kept, without a drive."""
    faults = [load_fault("gravity_units"), load_fault("urdf_inertia")]
    campaign = CheckCampaign(faults, [2], [3], pairs=1, seconds=8.0, kept=tmp_path)

    first = run_campaign(campaign, Reporter(quiet=True))
    again = run_campaign(campaign, Reporter(quiet=True))

    assert again == first
    summary = summarise([run_seed(campaign, seed) for seed in (2, 3)])
    assert summary == first["summary"]
    assert summary["clean"]["trials"] == 2  # type: ignore[index]
    for name in ("gravity_units", "urdf_inertia"):
        assert summary["faults"][name]["named"] == 1  # type: ignore[index]
    assert summary["pairs"]["named"] == 1  # type: ignore[index]
