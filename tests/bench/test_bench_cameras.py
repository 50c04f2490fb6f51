"""Figures of cameras that do not depend on the machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slamsim.bench.cameras.command import flow_error_px
from slamsim.bench.cameras.faults import (
    FAULTS,
    CameraCampaign,
    CameraTrial,
    faults_of,
    run_camera_check,
    summary,
    typed_faults,
)
from slamsim.bench.cameras.halls import TAGS, ate_m, hall, mapped
from slamsim.bench.logs import Children
from slamsim.console.reporter import Reporter
from slamsim.core.landmarks import NO_TAGS
from slamsim.guard.errors import OverrideRefused
from slamsim.sensors.faults.registry import load_fault


def test_flow_is_within_a_hundredth_of_a_pixel_of_homographies() -> None:
    assert 0.0 < flow_error_px() < 0.01


@pytest.mark.long
def test_tags_hold_a_robot_whose_lidar_sees_nothing() -> None:
    true, log, tags = hall(0, 60.0)  # half as long as those that bench measures against 20 mm
    held = mapped(log, tags)
    assert ate_m(held, true) < 0.02 * 2.0**0.5  # half as many images
    assert len(held.landmarks) == TAGS
    assert ate_m(mapped(log, NO_TAGS), true) > 10.0 * ate_m(held, true)


def test_six_drives_have_each_fault_of_cameras_once() -> None:
    drawn = [fault for number in range(6) for fault in faults_of(number)]
    assert sorted(map(str, drawn)) == sorted(map(str, FAULTS))
    assert len(set(FAULTS)) == len(FAULTS) >= 30
    assert all(load_fault(name) for name, _ in FAULTS)
    assert faults_of(6) == faults_of(0)


def test_a_fault_with_something_false_beside_it_is_not_named() -> None:
    about = 1, "loop", "oak_d"
    trials = [
        CameraTrial(*about, "", None, (), (), False),
        CameraTrial(*about, "", None, ("camera_mount",), ("camera_mount",), False),
        CameraTrial(*about, "camera_late", 0.1, ("camera_time_offset",), (), True),
        CameraTrial(*about, "camera_late", 0.1, ("camera_mount",), ("camera_mount",), False),
    ]
    assert summary(trials) == {
        "camera_faults": 2,
        "camera_named_share": 0.5,
        "camera_clean": 2,
        "camera_false_alarms": 1,
    }


@pytest.mark.long
@pytest.mark.usefixtures("drives_here")
def test_a_drive_whose_log_is_kept_is_not_rendered_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered = []

    class Here(Children):
        """In this process, which has loaded its libraries."""

        def run(self, work: Any, *arguments: Any, **keywords: Any) -> Any:
            if work.__name__ == "_simulate":
                rendered.append(arguments[1])
            return work(*arguments, **keywords)

    monkeypatch.setattr("slamsim.bench.logs.Children", Here)
    campaign, quiet = CameraCampaign((), (4,), seconds=5.0, kept=tmp_path), Reporter(quiet=True)
    first, again = (run_camera_check(campaign, quiet) for _ in range(2))
    assert len(rendered) == 1 and rendered[0].is_dir()
    assert first == again and first["camera_clean"] == 1
    other = run_camera_check(replace(campaign, seconds=6.0), quiet)
    assert other["failed"] == 1 and other["camera_clean"] == 0
    assert "another drive.route.max_duration_s" in str(other["failures"])


def test_faults_that_are_typed_are_put_into_each_drive() -> None:
    campaign = CameraCampaign((7, 8), (9,), typed_faults("camera_late:0.2,depth_unit"))
    two = (("camera_late", 0.2), ("depth_unit", None))
    assert campaign.drives() == [(7, two), (8, two), (9, ())]
    with pytest.raises(OverrideRefused, match=r"lidar_late: is none of cameras.*camera_frozen"):
        typed_faults("camera_late,lidar_late")
