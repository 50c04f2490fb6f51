"""Consequences are explained away, independent faults are not."""

from __future__ import annotations

from dataclasses import replace

from slamsim.check.diagnosis import explained
from slamsim.check.findings import Finding, Measurement
from slamsim.check.registry import registry


def bad(check: str, subject: str, fault: str) -> Finding:
    return Finding(check, subject, "fault", "words", fault, "advice")


def names(*findings: Finding) -> set[str | None]:
    return {one.fault for one in explained(findings) if one.verdict == "fault"}


def test_a_consequence_is_no_fault_of_its_own() -> None:
    cause = bad("wheels.wiring", "/ticks", "wheels_swapped")
    consequence = bad("odometry.wheels", "/odom", "odometry_contradicts_wheels")
    found = explained([consequence, cause])
    assert [one.verdict for one in found] == ["inconclusive", "fault"]
    assert "left and right wheel are exchanged" in found[0].words
    assert not found[0].repairs


def test_two_faults_are_both_told() -> None:
    assert names(
        bad("wheels.radius", "/ticks", "wheel_radius"), bad("gyro.bias", "/imu", "gyro_bias")
    ) == {"wheel_radius", "gyro_bias"}


def test_scans_with_counted_stamps_do_not_tell_how_far_they_turn() -> None:
    counted = bad("time.invented", "/scan", "stamps_invented")
    turned = bad("laser.rotation", "/scan", "laser_angle_step")
    assert names(counted, turned) == {"stamps_invented"}
    assert names(bad("time.receipt", "/scan", "stamps_invented"), turned) == {"laser_angle_step"}


def test_an_angle_between_beams_by_which_scans_still_turn_too_far_is_not_told() -> None:
    """Half of the right angles was told once by the turns, and as 9 % too small by the scans."""
    turned, step = (
        bad(check, "/scan", "laser_angle_step") for check in ("laser.rotation", "laser.angle_step")
    )
    assert [one.verdict for one in explained([turned, step])] == ["fault", "inconclusive"]
    assert [one.verdict for one in explained([step])] == ["fault"]


def test_a_fan_of_wrong_angles_is_no_scan_of_several_turns() -> None:
    folds = bad("ranges.layout", "/scan", "scan_folds")
    assert names(folds) == {"scan_folds"}
    for check in ("laser_angle_step", "laser_degrees"):
        assert names(folds, bad("laser", "/scan", check)) == {check}


def test_scans_that_share_their_stamps_do_not_tell_when_wheels_are_late() -> None:
    late = bad("time.offset.wheels", "/odom", "time_offset_wheels")
    told_by_scans = bad("ranges.offset", "/scan", "range_offset")
    shared = bad("time.repeats", "/scan", "stamps_repeated")
    assert names(shared, late, told_by_scans) == {"stamps_repeated"}
    assert names(replace(shared, subject="/imu"), late) == {"stamps_repeated", late.fault}


def test_wheels_whose_stamps_scatter_tell_no_sizes_of_theirs() -> None:
    scattered = bad("time.scatter", "/odom", "stamps_jitter")
    sizes = [bad("wheels.radius", "/odom", "wheel_radius"), bad("gyro.scale", "/imu", "gyro_scale")]
    assert names(scattered, *sizes) == {"stamps_jitter", "gyro_scale"}
    assert names(bad("time.scatter", "/imu", "stamps_jitter"), sizes[0]) == {
        *("stamps_jitter", "wheel_radius"),
    }


def test_scattered_stamps_hide_no_sizes_larger_than_they_make() -> None:
    scattered = replace(
        bad("time.scatter", "/odom", "stamps_jitter"), estimate=Measurement(6.0, 0.1, "ms")
    )
    for percent, told in ((-4.0, set()), (30.0, {"wheel_radius"})):
        radius = replace(
            bad("wheels.radius", "/odom", "wheel_radius"), estimate=Measurement(percent, 0.1, "%")
        )
        assert names(scattered, radius) == {"stamps_jitter", *told}


def test_a_sweep_that_is_too_long_explains_an_offset_up_to_its_length() -> None:
    long = replace(
        bad("time.overlap", "/scan", "scans_overlap"), estimate=Measurement(199.0, 0.0, "ms")
    )
    for late_ms, told in ((102.0, set()), (300.0, {"time_offset_lidar"})):
        late = replace(
            bad("time.offset.lidar", "/scan", "time_offset_lidar"),
            estimate=Measurement(late_ms, 1.0, "ms"),
        )
        assert names(long, late) == {"scans_overlap", *told}


def test_two_publishers_of_an_odometry_tell_no_sizes() -> None:
    shared = bad("topic.publishers", "/odom", "topic_shared")
    assert names(shared, bad("ranges.scale", "/scan", "range_scale")) == {"topic_shared"}


def test_sizes_are_not_told_where_wheels_and_scans_contradict_each_other_once_they_are_fitted() -> (
    None
):
    misfit = bad("motion.wheels", "/odom", "does_not_fit")
    mount = bad("laser.x", "laser", "laser_position")
    knocks = bad("imu.spikes", "/imu", "imu_spikes")
    assert names(mount, knocks) == {"laser_position", "imu_spikes"}
    assert names(misfit, mount, knocks) == {"does_not_fit", "imu_spikes"}
    # What takes part in the fit may be why.
    stuck = bad("imu.stuck", "/imu", "imu_stuck")
    assert names(misfit, mount, stuck) == {"laser_position", "imu_stuck"}
    # Slip in some of these seconds is none of the others.
    assert names(misfit, mount, bad("wheels.slip", "/odom", "wheel_slip")) == {"wheel_slip"}


def test_a_twist_is_not_compared_with_poses_of_which_stamps_say_nothing() -> None:
    twist = bad("odometry.twist", "/odom", "odometry_twist")
    for name in ("stamps_quantised", "stamps_repeated", "stamps_jitter", "stamps_backward"):
        assert names(twist, bad("time.rounding", "/odom", name)) == {name}
        assert names(twist, bad("time.rounding", "/scan", name)) == {name, "odometry_twist"}


def test_a_slash_before_a_name_hides_nothing() -> None:
    slash = bad("tf.slash", "/scan", "frame_slash")
    for other in (
        bad("motion.fit", "/scan", "does_not_fit"),
        bad("camera.turns", "/camera", "camera_flipped"),
        bad("camera.pitch", "/camera", "camera_mount"),
        bad("camera.depth_scale", "/depth", "camera_depth_scale"),
    ):
        assert names(slash, other) == {"frame_slash", other.fault}
    mount = bad("laser.x", "laser", "laser_position")
    misfit = bad("motion.wheels", "/odom", "does_not_fit")
    assert names(slash, misfit, mount) == {"frame_slash", "does_not_fit"}


def test_scans_that_turn_by_another_factor_than_all_others_tell_no_sizes() -> None:
    """Every second beam of a full circle, at the angle between all: half the turn, half the way."""
    folded = bad("laser.rotation", "/scan", "laser_angle_step")
    sizes = (
        bad("wheels.radius", "/odom", "wheel_radius"),
        bad("gyro.scale", "/imu", "gyro_scale"),
        bad("gyro.bias", "/imu", "gyro_bias"),
    )
    assert names(folded, *sizes) == {"laser_angle_step", "gyro_bias"}
    bent = replace(folded, check="laser.angle_step")
    assert names(bent, *sizes) == {"laser_angle_step", "wheel_radius", "gyro_scale", "gyro_bias"}


def test_rounded_stamps_explain_no_larger_offset_than_the_rounding() -> None:
    def of(check: str, subject: str, fault: str, ms: float) -> Finding:
        return replace(bad(check, subject, fault), estimate=Measurement(ms, 0.0, "ms"))

    rounded = of("stamps.rounding", "/imu", "stamps_quantised", 10.0)
    for late_ms, told in ((6.0, set()), (30.0, {"time_offset_wheels"})):
        wheels = of("time.offset.wheels", "/ticks", "time_offset_wheels", late_ms)
        assert names(rounded, wheels) == {"stamps_quantised", *told}
    for leap_ms, told in ((9.8, set()), (30.0, {"clock_step"})):
        leap = of("time.step", "/imu", "clock_step", leap_ms)
        assert names(rounded, leap) == {"stamps_quantised", *told}
        assert names(rounded, replace(leap, subject="/scan")) == {"stamps_quantised", "clock_step"}


def test_what_depths_tell_beside_scans_stands_beside_wheels_that_are_somewhat_wrong() -> None:
    late = replace(
        bad("time.offset.wheels", "/odom", "time_offset_wheels"),
        estimate=Measurement(44.0, 0.4, "ms"),
    )
    mount = bad("camera.yaw", "camera_optical", "camera_mount")
    by_depths = bad("camera.time_offset", "/depth", "camera_time_offset")
    by_turns = replace(by_depths, subject="/color")
    scale = Finding("camera.depth_scale", "/depth", "ok", "words")
    told = {
        one.subject for one in explained([late, mount, by_depths, by_turns, scale]) if one.fault
    }
    assert told == {"/odom", "camera_optical", "/depth"}

    much = replace(late, estimate=Measurement(400.0, 0.4, "ms"))
    wrong_scans = bad("laser.yaw", "laser", "laser_yaw")
    for cause in (much, wrong_scans):
        found = explained([cause, mount, by_depths, scale])
        assert [one.subject for one in found if one.fault] == [cause.subject]


def test_what_faults_explain_are_faults_and_none_explains_itself_in_a_circle() -> None:
    faults = registry().faults
    explained_by = {
        (where, name): {
            fault for one in kind.explains if one.where == where for fault in one.faults
        }
        for name, kind in faults.items()
        for where in ("same subject", "anywhere")
    }
    assert sum(map(len, explained_by.values())) > 100
    for (where, cause), consequences in explained_by.items():
        assert consequences <= set(faults)
        assert cause not in consequences
        for other in consequences:
            assert cause not in explained_by[where, other], (cause, other)


def test_sizes_wait_until_somebody_knows_how_far_the_scans_turn() -> None:
    offset = Finding("ranges.offset", "/scan", "fault", "too long", "range_offset")
    unsure = Measurement(18.0, 9.0, "%")
    rotation = Finding("laser.rotation", "/scan", "inconclusive", "gain 0.3", estimate=unsure)
    step = Finding("laser.angle_step", "/scan", "inconclusive", "unsure", estimate=unsure)

    assert [one.verdict for one in explained([offset, rotation])] == ["fault", "inconclusive"]
    told = explained([offset, rotation, step])
    assert {one.verdict for one in told} == {"inconclusive"}
    assert "contradict" in told[0].words


def test_a_sweep_of_milliseconds_explains_no_offset_of_a_tenth_of_a_second() -> None:
    sweep = replace(
        bad("laser.sweep", "/scan", "rolling_scan_untimed"), estimate=Measurement(8.0, 1.0, "ms")
    )
    late = bad("time.offset.lidar", "/scan", "time_offset_lidar")

    small, large = (replace(late, estimate=Measurement(ms, 1.0, "ms")) for ms in (5.0, 130.0))
    assert names(sweep, small) == {"rolling_scan_untimed"}
    assert names(sweep, large) == {"rolling_scan_untimed", "time_offset_lidar"}


def test_a_drift_that_the_times_of_receipt_contradict_is_not_told() -> None:
    drift = replace(
        bad("time.drift", "/scan", "clock_drift"), estimate=Measurement(3000.0, 300.0, "ppm")
    )
    for ppm, told in ((-10.0, set()), (2500.0, {"clock_drift"})):
        pace = Measurement(ppm, 20.0, "ppm")
        receipt = Finding("time.receipt_drift", "/scan", "ok", "keeps pace", estimate=pace)
        assert names(drift, receipt) == told


def test_held_up_stamps_explain_no_larger_offset_of_another_stream() -> None:
    jitter = replace(
        bad("time.scatter", "/imu", "stamps_jitter"), estimate=Measurement(8.0, 0.0, "ms")
    )
    late = bad("time.offset.lidar", "/scan", "time_offset_lidar")
    small, large = (replace(late, estimate=Measurement(ms, 1.0, "ms")) for ms in (5.0, 130.0))
    assert names(jitter, small) == {"stamps_jitter"}
    assert names(jitter, large) == {"stamps_jitter", "time_offset_lidar"}
