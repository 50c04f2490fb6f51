"""CARMEN logs: the three real ones, and every oddity in made-up ones."""

from __future__ import annotations

import bz2
import gzip
import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from real_logs import needs_radish, radish

from slamsim.core.geometry import between, compose, inverse
from slamsim.core.types import Log
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused
from slamsim.io.open import read_log, read_truth
from slamsim.io.selection import Selection
from slamsim.io.text.relations import read_relations
from slamsim.io.text.tum import decimal_from_stamp_ns, stamp_ns_from_decimal


@lru_cache
def _real(name: str) -> Log:
    return read_log(radish(name)[0])


def _flaser(stamp: str, ranges: list[float | str], odom: tuple[float, float, float]) -> str:
    x, y, yaw = odom
    laser = f"{x + 0.1 * math.cos(yaw):.6f} {y + 0.1 * math.sin(yaw):.6f} {yaw}"
    return (
        f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {laser} {x} {y} {yaw} {stamp} host 0.5"
    )


def _odom(stamp: str, x: float) -> str:
    return f"ODOM {x} 0 0 0.1 0.0 0.0 {stamp} host 0.5"


def _write(tmp_path: Path, *lines: str, name: str = "made.log") -> Path:
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return path


def _small(tmp_path: Path, *more: str) -> Log:
    lines = [_flaser(f"{i + 1}.5", [1.0] * 180, (0.1 * i, 0.0, 0.2)) for i in range(3)]
    return read_log(_write(tmp_path, *lines, *more))


@pytest.mark.long
@needs_radish
@pytest.mark.parametrize(
    ("name", "scans", "beams", "step_deg", "laser_x_m", "duration_s", "odometry_error"),
    [
        ("aces", 7374, 180, 1.0, 0.0, 1366, (0.549, 2.33)),
        pytest.param(*("intel", 13631, 180, 1.0, 0.0, 2691, (7.37, 39.2)), marks=pytest.mark.slow),
        ("fr079", 4934, 360, 0.5, -0.04, 1061, (6.50, 30.3)),
    ],
)
def test_real_logs(
    name: str,
    scans: int,
    beams: int,
    step_deg: float,
    laser_x_m: float,
    duration_s: float,
    odometry_error: tuple[float, float],
) -> None:
    log = _real(name)
    relations = read_relations(radish(name)[1])
    stamps = np.array([scan.stamp_ns for scan in log.scans])
    geometry = next(iter(log.scans)).geometry
    assert (len(log.scans), geometry.beam_count, geometry.beam_dt_ns) == (scans, beams, 0)
    assert (np.diff(stamps) > 0).all()
    assert np.degrees(geometry.angle_step_rad) == pytest.approx(step_deg)
    assert log.T_base_laser[0, 3] == pytest.approx(laser_x_m, abs=1e-6)
    assert (stamps[-1] - stamps[0]) * 1e-9 == pytest.approx(duration_s, abs=6)
    assert np.isin(relations.from_ns, stamps).all()
    assert np.isin(relations.to_ns, stamps).all()
    assert log.odometry is not None
    measured = between(log.odometry.at(relations.from_ns), log.odometry.at(relations.to_ns))
    error = compose(inverse(relations.planar), measured)
    mean = np.abs(np.column_stack([np.hypot(*error[:, :2].T), np.degrees(error[:, 2])])).mean(0)
    assert mean == pytest.approx(odometry_error, rel=5e-3)


@pytest.mark.long
@needs_radish
def test_stamps_of_intel_that_run_backwards_are_sorted_counted_and_told() -> None:
    log = _real("intel")
    assert any("631 of 13,631 scans" in warning for warning in log.warnings)
    assert log.epoch == "unix"


@pytest.mark.long
@needs_radish
@pytest.mark.parametrize(("name", "limit_m"), [("aces", 50.0), ("fr079", 80.99), ("intel", 81.83)])
def test_no_return_begins_where_the_log_says(name: str, limit_m: float) -> None:
    log = _real(name)
    scans = list(log.scans)
    finite = np.concatenate([scan.ranges_m[np.isfinite(scan.ranges_m)] for scan in scans])
    assert finite.max() < limit_m == scans[0].geometry.range_max_m
    assert any(np.isinf(scan.ranges_m).any() for scan in scans)
    assert finite.min() > 0.05


def test_each_scan_has_its_own_odometry(tmp_path: Path) -> None:
    log = _small(tmp_path, _odom("2.0", 99.0), _odom("9.0", 7.0))
    assert log.odometry is not None
    stamps = np.array([scan.stamp_ns for scan in log.scans])
    np.testing.assert_allclose(log.odometry.at(stamps)[:, 0], [0.0, 0.1, 0.2])
    assert log.odometry.poses[-1, 0] == 7.0
    assert log.epoch == "unknown"
    np.testing.assert_allclose(log.T_base_laser[:3, 3], [0.1, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("beams", "start_deg", "step_deg"),
    [
        (180, -90, 1.0),
        (181, -90, 1.0),
        (360, -90, 0.5),
        (361, -90, 0.5),
        (401, -50, 0.25),
        (91, -90, 2.0),
    ],
)
def test_fan_by_number_of_beams(
    tmp_path: Path, beams: int, start_deg: float, step_deg: float
) -> None:
    log = read_log(_write(tmp_path, _flaser("1.0", [2.0] * beams, (0, 0, 0))))
    geometry = next(iter(log.scans)).geometry
    assert np.degrees(geometry.angle_min_rad) == pytest.approx(start_deg)
    assert np.degrees(geometry.angle_step_rad) == pytest.approx(step_deg)


def test_readings_that_are_none(tmp_path: Path) -> None:
    path = _write(
        tmp_path,
        "PARAM robot_front_laser_max 80.99 host 0",
        _flaser("1.0", [1.0, 80.98, 80.99, 81.91, 0.0, -1.0, "nan", "inf"], (0, 0, 0)),
    )
    (scan,) = read_log(path).scans
    expected = np.array([1.0, 80.98, np.inf, np.inf, np.nan, np.nan, np.nan, np.inf])
    np.testing.assert_array_equal(scan.ranges_m, expected.astype(np.float32))


def test_new_laser_format_describes_itself(tmp_path: Path) -> None:
    body = "0 -1.0 2.0 0.5 20.0 0.01 1 5 1 2 3 19 21 5 10 20 30 40 50"
    path = _write(
        tmp_path,
        f"ROBOTLASER1 {body} 0.2 0 0 0 0 0 0.5 0.1 0.3 0.2 0 12.25 host 0.1",
        f"RAWLASER1 {body} 12.30 host 0.1",
    )
    log = read_log(path)
    (scan,) = log.scans
    assert scan.stamp_ns == 12_250_000_000
    assert (scan.geometry.angle_min_rad, scan.geometry.angle_step_rad) == (-1.0, 0.5)
    np.testing.assert_array_equal(scan.ranges_m, [1, 2, 3, 19, np.inf])
    assert scan.intensities is not None
    np.testing.assert_array_equal(scan.intensities, [10, 20, 30, 40, 50])
    assert log.T_base_laser[0, 3] == pytest.approx(0.2)
    assert "scans from ROBOTLASER1 (not RAWLASER1)" in log.sources
    raw = read_log(
        path, Selection(("RAWLASER1",))
    )  # which no line gives a pose for, as in a ROS recording
    assert raw.odometry is None
    assert any("without odometry" in warning for warning in raw.warnings)


def test_raw_lines_take_odometry_from_odom_lines(tmp_path: Path) -> None:
    raw = "RAWLASER1 0 -1.0 2.0 0.5 20.0 0.01 0 5 1 2 3 4 5 0"
    odometry = [_odom("1.0", 0.0), _odom("3.0", 2.0)]
    scans = [f"{raw} {stamp} host 0" for stamp in ("0.5", "0.6", "2.0", "3.5")]
    log = read_log(_write(tmp_path, *odometry, *scans, "PARAM robot_frontlaser_offset 0.3"))
    assert log.odometry is not None
    np.testing.assert_array_equal(log.odometry.poses[:, 0], [0.0, 2.0])
    assert len(log.scans) == 4
    said = "odometry does not cover all scans: 2 of 4 are before its beginning, 1 after its end"
    assert said in log.warnings
    assert log.T_base_laser[0, 3] == pytest.approx(0.3)


def test_one_scan_at_each_end_may_be_without_odometry(tmp_path: Path) -> None:
    raw = "RAWLASER1 0 -1.0 2.0 0.5 20.0 0.01 0 5 1 2 3 4 5 0"
    scans = [f"{raw} {stamp} host 0" for stamp in ("0.9", "1.5", "2.0", "3.1")]
    log = read_log(_write(tmp_path, _odom("1.0", 0.0), _odom("3.0", 2.0), *scans))
    assert not any("odometry" in warning for warning in log.warnings)


def test_a_laser_that_looks_back_does_so_in_every_line(tmp_path: Path) -> None:
    """Its yaw is written as one half turn or the other."""
    raw = "ROBOTLASER1 0 -1.0 2.0 0.5 20.0 0.01 0 5 1 2 3 4 5 0"
    lines = [
        f"{raw} {i - 0.2} 0 {yaw} {i} 0 0 0 0 0 0 0 {i}.5 host 0"
        for i, yaw in enumerate((3.141593, -3.141593, -3.141592, 3.141592))
    ]
    log = read_log(_write(tmp_path, *lines))
    assert log.T_base_laser[0] == pytest.approx([-1.0, 0.0, 0.0, -0.2], abs=1e-5)


def test_malformed_and_unknown_lines_are_counted_with_the_first_place(tmp_path: Path) -> None:
    log = _small(tmp_path, "FLASER 180 1 2", "ODOM 1 x", "# a comment", "SYNC tag", "RLASER oops")
    assert any(w.startswith("3 malformed lines") and "line 4" in w for w in log.warnings)
    assert any("SYNC (1)" in w for w in log.warnings)


def test_repeated_stamps_and_changing_beams_are_told(tmp_path: Path) -> None:
    more = [_flaser("1.5", [2.0] * 180, (9, 9, 9)), _flaser("9.0", [2.0] * 360, (0.3, 0, 0.2))]
    log = _small(tmp_path, *more)
    assert [scan.geometry.beam_count for scan in log.scans] == [180, 180, 180, 360]
    assert any("1 scans carry the stamp of another" in w for w in log.warnings)
    assert any("number of beams changes" in w for w in log.warnings)


@pytest.mark.parametrize("suffix", [".gz", ".bz2"])
def test_compressed_the_same(tmp_path: Path, suffix: str) -> None:
    plain = _write(tmp_path, *[_flaser(f"{i}.1", [1.0] * 180, (0, 0, 0)) for i in range(50)])
    packed = tmp_path / f"made.log{suffix}"
    compress = gzip.compress if suffix == ".gz" else bz2.compress
    packed.write_bytes(compress(plain.read_bytes()))
    stamps = [[scan.stamp_ns for scan in read_log(path).scans] for path in (plain, packed)]
    assert stamps[0] == stamps[1]
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(InputRefused, match=r"cut off|damaged"):
        read_log(packed)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ([], "empty"),
        (["hello world"], "not a CARMEN log"),
        (["{", '"json": 1', "}"], "not a CARMEN log"),
        ([_odom("1.0", 0.0)], "without scans: a FLASER or ROBOTLASER1 line .* there is ODOM"),
        (["FLASER 180 1 2 3"], "not a CARMEN log.*line 1"),
    ],
)
def test_refused_in_a_sentence(tmp_path: Path, lines: list[str], told: str) -> None:
    path = tmp_path / "made.clf"
    path.write_text("\n".join(lines))
    with pytest.raises(InputRefused, match=told) as refusal:
        read_log(path)
    assert refusal.value.path == path


def test_unknown_topic_missing_file_and_truth(tmp_path: Path) -> None:
    path = _write(tmp_path, _flaser("1.0", [2.0] * 180, (0, 0, 0)))
    assert read_truth(path) is None
    with pytest.raises(OverrideRefused, match=r"the nearest .* is FLASER"):
        read_log(path, Selection(("/scan",)))
    with pytest.raises(NotFound):
        read_log(tmp_path / "nothing.clf")


@given(st.integers(min_value=-(2**62), max_value=2**62))
def test_stamps_survive_text_to_the_nanosecond(stamp_ns: int) -> None:
    assert stamp_ns_from_decimal(decimal_from_stamp_ns(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("976052857.337284", 976052857337284000),
        ("0", 0),
        ("5.", 5_000_000_000),
        ("1.1e3", 1_100_000_000_000),
        ("-0.5", -500_000_000),
        ("1.9999999999", 1_999_999_999),
    ],
)
def test_decimal_stamps(text: str, stamp_ns: int) -> None:
    assert stamp_ns_from_decimal(text) == stamp_ns


@pytest.mark.parametrize("text", ["", ".", "nan", "inf", "1e999999", "12a", "1,5", "99999999999"])
def test_what_is_no_stamp(text: str) -> None:
    with pytest.raises(ValueError, match=r"stamp|fit"):
        stamp_ns_from_decimal(text)
