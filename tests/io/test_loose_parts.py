"""Folders with recordings and no metadata.yaml: what is one recording is read, in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_data import ROS1, ROS2, SCANS, Message, Robot, as_mcap, as_ros1, as_rosbag2

from slamsim.guard.errors import InputRefused
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import read_log, read_recording, recording_at, survey_recording

ROBOT = Robot(ROS2)


def later(messages: list[Message], seconds: int) -> list[Message]:
    """Received later, stamped as they were."""
    return [(topic, log_ns + seconds * 10**9, message) for topic, log_ns, message in messages]


def in_parts(folder: Path, names: list[str], pause_s: int = 0) -> Path:
    """A drive in several MCAP files, each received so much later than the one before."""
    folder.mkdir()
    messages = ROBOT.drive()
    per = -(-len(messages) // len(names))
    for number, name in enumerate(names):
        part = messages[number * per : (number + 1) * per]
        as_mcap(folder / name, later(part, number * pause_s))
    return folder


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_a_single_recording_in_a_folder_is_read(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "notes.txt").write_text("the second floor")
    if kind == "mcap":
        as_mcap(folder / "drive.mcap", ROBOT.drive())
    elif kind == "bag":
        as_ros1(folder / "drive.bag", Robot(ROS1).drive())
    else:
        made = next(as_rosbag2(tmp_path / "made", ROBOT.drive()).glob("*.db3"))
        made.rename(folder / "drive.db3")
    assert len(read_log(folder).scans) == SCANS
    assert recording_at(folder) == folder / f"drive.{kind}"


def test_parts_without_metadata_are_read_in_order(tmp_path: Path) -> None:
    """Twelve parts: by their names, the tenth would come after the first."""
    whole = read_log(as_mcap(tmp_path / "whole.mcap", ROBOT.drive()))
    folder = in_parts(tmp_path / "bag", [f"bag_{number}.mcap" for number in range(12)])
    log = read_log(folder)
    assert [each.stamp_ns for each in log.scans] == [each.stamp_ns for each in whole.scans]
    received = read_recording(folder).odometries[0].received_ns
    assert received is not None and (np.diff(received) > 0).all()
    assert survey_recording(folder).topics


def test_parts_in_sqlite_are_read_and_copied(tmp_path: Path) -> None:
    messages = ROBOT.drive()
    folder = tmp_path / "bag"
    folder.mkdir()
    for number, part in enumerate((messages[:100], messages[100:])):
        made = next(as_rosbag2(tmp_path / f"made_{number}", part).glob("*.db3"))
        made.rename(folder / f"bag_{number}.db3")
    recording = read_recording(folder)
    copy_recording(folder, recording, recording, tmp_path / "copy")
    assert len(read_log(tmp_path / "copy").scans) == SCANS


@pytest.mark.parametrize(
    ("names", "pause_s"),
    [
        (["kitchen.mcap", "hall.mcap"], 0),
        (["bag_0.mcap", "bag_2.mcap"], 0),
        (["bag_0.mcap", "bag_1.mcap"], 3600),
        (["bag_0.mcap", "bag_1.mcap"], -3600),
    ],
    ids=["other names", "one is missing", "an hour later", "an hour earlier"],
)
def test_recordings_that_are_not_one_are_listed(
    names: list[str], pause_s: int, tmp_path: Path
) -> None:
    folder = in_parts(tmp_path / "bags", names, pause_s)
    for read in (read_log, survey_recording):
        with pytest.raises(InputRefused, match="holds several recordings") as refusal:
            read(folder)
        assert refusal.value.path == folder
        assert all(name in str(refusal.value) for name in names)


def test_bags_of_different_kinds_are_listed_and_a_folder_without_any_says_what_is_read(
    tmp_path: Path,
) -> None:
    folder = in_parts(tmp_path / "bags", ["a.mcap"])
    as_ros1(folder / "b.bag", Robot(ROS1).drive())
    with pytest.raises(InputRefused, match=r"a\.mcap, b\.bag; name the one that is meant"):
        recording_at(folder)
    (folder / "a.mcap").unlink()
    (folder / "b.bag").unlink()
    with pytest.raises(InputRefused, match=r"no recording in this folder; a log is .*\.mcap"):
        recording_at(folder)
