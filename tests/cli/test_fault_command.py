"""Faults from the command line: simulated with a run, or put into a recording that exists."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from typed import typed

from slamsim.config.faults import typed_choices
from slamsim.config.loading import load_run_config
from slamsim.guard.errors import NotFound, OverrideRefused, SlamsimError
from slamsim.io.open import open_recording, read_recording, read_truth
from slamsim.recording.edits.base import CannotEdit
from slamsim.run.fixing import fault_facts, fault_table, inject_faults

pytestmark = pytest.mark.usefixtures("drives_here")

SHORT = ("--set", "drive.route.max_duration_s=6", "--set", "sensors.lidar.rate_hz=10")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a healthy run and one with rays fixed to the world and late stamps."""
    cwd = tmp_path_factory.mktemp("runs")
    faults = ("--fault", "laser_world_fixed", "--fault", "lidar_late:0.25")
    for out, extra in (("healthy", ()), ("faulty", faults)):
        done = typed("simulate", "tiny", "-q", "--out", out, *SHORT, *extra, cwd=cwd)
        assert done.returncode == 0, done.stderr
    return cwd


def test_a_faulty_run_is_the_healthy_one_but_for_its_faults(runs: Path) -> None:
    healthy, faulty = (read_recording(runs / name) for name in ("healthy", "faulty"))

    assert np.array_equal(
        faulty.scans[0].stamps_ns, np.asarray(healthy.scans[0].stamps_ns) + 250_000_000
    )
    np.testing.assert_array_equal(
        faulty.imus[0].angular_velocity_rad_s, healthy.imus[0].angular_velocity_rad_s
    )
    np.testing.assert_array_equal(faulty.ticks[0].ticks, healthy.ticks[0].ticks)
    assert not np.array_equal(faulty.scans[0].ranges_m[50], healthy.scans[0].ranges_m[50])


def test_a_faulty_run_has_all_other_messages_of_the_healthy_one(runs: Path) -> None:
    """Truth with its twist, commands, covariances, what stands beside them: byte for byte."""
    found = []
    for name in ("healthy", "faulty"):
        with (runs / name / "log" / "log_0.mcap").open("rb") as stream:
            reader = make_reader(stream)
            messages = [
                (channel.topic, channel.metadata, message.log_time, message.data)
                for _, channel, message in reader.iter_messages()
                if channel.topic != "/scan"
            ]
            found.append((sorted(messages, key=str), [r.metadata for r in reader.iter_metadata()]))
    assert found[0] == found[1]
    truth = open_recording(runs / "faulty" / "log").contents.truth
    assert truth is not None
    assert np.abs(truth.linear_m_s[:, 0]).max() > 0.05


def test_a_faulty_run_keeps_its_truth(runs: Path) -> None:
    healthy, faulty = (read_truth(runs / name) for name in ("healthy", "faulty"))

    assert healthy is not None
    assert faulty is not None
    np.testing.assert_array_equal(faulty.stamps_ns, healthy.stamps_ns)
    np.testing.assert_array_equal(faulty.positions_m, healthy.positions_m)


def test_a_saved_configuration_holds_the_faults_with_their_sizes(runs: Path) -> None:
    saved = yaml.safe_load((runs / "faulty" / "config.yaml").read_text())["faults"]

    assert saved == [
        {"name": "laser_world_fixed", "size": None},
        {"name": "lidar_late", "size": 0.25},
    ]


def test_a_configuration_may_name_faults_in_short(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("faults: [laser_yaw, 'lidar_late:0.01', {name: tf_loop}]")

    config = load_run_config("tiny", str(tmp_path / "mine.yaml"))

    assert [(one.name, one.size) for one in config.faults] == [
        ("laser_yaw", None),
        ("lidar_late", 0.01),
        ("tf_loop", None),
    ]


def test_a_recording_is_damaged_into_a_copy(runs: Path, tmp_path: Path) -> None:
    choices = typed_choices(["gyro_degrees", "tf_unknown_frame"])

    inject_faults(runs / "healthy", tmp_path / "damaged", choices)

    clean, damaged = read_recording(runs / "healthy"), read_recording(tmp_path / "damaged")
    assert damaged.scans[0].frame_ids == ("laser",)
    np.testing.assert_allclose(
        damaged.imus[0].angular_velocity_rad_s,
        np.degrees(clean.imus[0].angular_velocity_rad_s),
        rtol=1e-12,
    )
    np.testing.assert_array_equal(damaged.scans[0].ranges_m[3], clean.scans[0].ranges_m[3])
    assert read_truth(tmp_path / "damaged") is not None


def test_nothing_is_left_of_a_copy_that_could_not_be_made(runs: Path, tmp_path: Path) -> None:
    with pytest.raises(CannotEdit, match="no such part"):
        inject_faults(
            runs / "healthy", tmp_path / "damaged", typed_choices(["urdf_cut:0.05", "urdf_inertia"])
        )

    assert not (tmp_path / "damaged").exists()


@pytest.mark.parametrize(
    ("text", "error", "told"),
    [
        ("laser_yw", NotFound, "did you mean the bundled 'laser_yaw'"),
        ("laser_yaw:1000", SlamsimError, "angle_deg = 1000"),
        ("laser_mirrored:1", SlamsimError, "has no size"),
    ],
)
def test_a_fault_that_is_none_is_told_before_anything_is_read(
    tmp_path: Path, text: str, error: type[SlamsimError], told: str
) -> None:
    with pytest.raises(error, match=told):
        inject_faults(tmp_path / "nowhere", tmp_path / "out", typed_choices([text]))


@pytest.mark.parametrize("text", ["laser_yaw:nan", "laser_yaw:inf", ""])
def test_what_is_typed_must_be_a_name_and_a_number(text: str) -> None:
    with pytest.raises(OverrideRefused, match="write name or name:size"):
        typed_choices([text])


def test_a_colon_in_a_path_is_no_size() -> None:
    assert typed_choices(["C:/mine.yaml"])[0].name == "C:/mine.yaml"


def test_all_faults_are_told_with_their_meaning(tmp_path: Path) -> None:
    done = typed("fault", "--list", "--json", cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    listed = json.loads(done.stdout)["faults"]
    assert listed == fault_facts()
    assert {one["name"] for one in listed} == set(fault_table())
    assert fault_table()["laser_yaw"].endswith("(angle_deg 3)")


def test_what_is_missing_on_the_command_line_is_told(tmp_path: Path) -> None:
    done = typed("fault", "log", cwd=tmp_path)

    assert done.returncode == 2
    assert "--fault" in done.stderr
