"""``slamsim calibrate``: images in, lenses, mounts and clocks out, or what is missing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from board_images import MODEL, TYPED, board_views, write_views
from scipy.spatial.transform import Rotation
from tag_drive import T_CLAIMED, Driven, Setting, driven
from typed import typed

from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import EncodedFrame
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose
from slamsim.core.types import PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.io.cameras import open_pictures
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.perception.calibration.mount import fit_mount
from slamsim.run.cameras import calibrating
from slamsim.run.cameras import calibration_inputs as inputs
from slamsim.run.cameras.calibrating import Wanted, calibrate_cameras
from slamsim.run.cameras.calibration_inputs import by_visits
from slamsim.run.cameras.calibration_report import quantity

QUIET = Reporter(quiet=True)
SETTING = Setting(seconds=30.0)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards") / "views"
    write_views(folder, board_views(14))
    return folder


@pytest.fixture(scope="module")
def thirty() -> Driven:
    """A drive of half a minute."""
    return driven(3, SETTING)


def test_a_folder_of_boards_gives_a_lens(boards: Path, tmp_path: Path) -> None:
    words = ("calibrate", boards, "--board", TYPED, "-o", "out", "--json")
    done = typed(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (camera,) = json.loads(done.stdout)["cameras"]
    assert camera["board_images"] >= 10 and camera["residual_px"] < 0.3
    for each in camera["quantities"][:4]:
        true = (
            MODEL.K[0, 0]
            if each["name"].startswith("f")
            else MODEL.K["xy".index(each["name"][1]), 2]
        )
        assert abs(each["value"] - true) < 4.5 * each["sigma"] and each["sigma"] < 2.0
        low, high = each["interval"]
        assert low < each["value"] < high and each["verdict"] == "measured"
    shown = (tmp_path / "out" / "report.html").read_text()
    assert "0 of" not in shown and shown.count("<svg") == 2 and "Where corners of board" in shown
    told = yaml.safe_load((tmp_path / "out" / "calibration.yaml").read_text())
    ((topic, entry),) = told["cameras"].items()
    info = yaml.safe_load((tmp_path / "out" / entry["camera_info"]).read_text())
    assert topic == camera["topic"] and info["image_width"] == MODEL.width
    assert info["camera_matrix"]["data"][0] == camera["quantities"][0]["value"]


def test_the_claim_is_judged(boards: Path, tmp_path: Path) -> None:
    folder = tmp_path / "claimed"
    shutil.copytree(boards, folder)
    (folder / "depth").mkdir()  # as Open3D's examples are
    wrong = MODEL.K.copy()
    wrong[0, 0] *= 1.2
    claim = {"width": 320, "height": 240, "intrinsic_matrix": wrong.T.ravel().tolist()}
    (folder / "camera_intrinsic.json").write_text(json.dumps(claim))
    found = calibrate_cameras(folder, tmp_path / "out", Wanted(board=TYPED), QUIET)
    verdicts = {each.name: each.verdict for each in found.cameras[0].quantities}
    assert verdicts["fx"] == "fault" and verdicts["fy"] != "fault"


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (Wanted(), "name a board .* or tags"),
        (Wanted(board="chessboard:9x6:0.03"), "none of 14 images shows a board of 9 x 6"),
        (Wanted(board="chess"), "describes no board"),
        (Wanted(tags="apriltag_36h11:0.16"), "none of 14 images shows a tag of apriltag_36h11"),
        (Wanted(tags="apriltag:0.16"), "no family of tags"),
        (Wanted(board=TYPED, topics=("/left",)), "no images on /left; there are"),
        (Wanted(board=TYPED, distortion="fisheye"), "fisheye.* is not one of plumb_bob"),
    ],
)
def test_what_cannot_be_calibrated_is_told(
    boards: Path, tmp_path: Path, wanted: Wanted, said: str
) -> None:
    with pytest.raises(SlamsimError, match=said):
        calibrate_cameras(boards, tmp_path / "out", wanted, QUIET)
    assert list(tmp_path.iterdir()) == []


def test_raw_and_packed_images_of_one_imager_are_one_camera() -> None:
    def topic(name: str, kind: Kind = "colour", messages: int = 10) -> CameraTopic:
        return CameraTopic(name, kind, messages, 64, 48, "rgb8", "optical")

    class Opened(Cameras):
        def encoded(self, topics: object = None) -> Iterator[EncodedFrame]:
            return iter(())

    names = ("/a/image_raw", "/a/image_raw/compressed", "/a/image_rect", "/b/image_raw/compressed")
    topics = {name: topic(name) for name in names} | {"/c": topic("/c", "depth")}
    opened = Opened(Path("bag"), topics, {}, {})
    shown = [each.topic for each in opened.pictures()]
    assert shown == ["/a/image_raw", "/a/image_rect", "/b/image_raw/compressed"]
    assert [each.topic for each in inputs.pictures_of(opened, ())] == shown
    (packed,) = inputs.pictures_of(opened, ("/a/image_raw/compressed",))
    assert packed.topic == "/a/image_raw/compressed"


@pytest.mark.long
def test_two_topics_of_one_camera_info_are_no_pair(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_views(tmp_path / "views", board_views(9))
    for side in ("left", "right"):
        shutil.copytree(tmp_path / "views" / "color", tmp_path / "both" / side)
    found = calibrate_cameras(tmp_path / "both", tmp_path / "one", Wanted(board=TYPED), QUIET)
    assert len(found.pairs) == 1
    claim = SimpleNamespace(source="topic /camera_info")
    monkeypatch.setattr(calibrating._Work, "_claim", lambda *_: None)

    def claimed(path: Path) -> Cameras:
        cameras: Any = open_pictures(path)
        cameras.infos = dict.fromkeys(cameras.topics, claim)
        return cameras  # type: ignore[no-any-return]

    monkeypatch.setattr(calibrating, "open_pictures", claimed)
    found = calibrate_cameras(tmp_path / "both", tmp_path / "two", Wanted(board=TYPED), QUIET)
    assert len(found.cameras) == 2 and found.pairs == ()


def test_few_views_and_views_alike_are_told(tmp_path: Path) -> None:
    write_views(tmp_path / "few", board_views(5))
    with pytest.raises(SlamsimError, match="differ from each other; 8 are needed"):
        calibrate_cameras(tmp_path / "few", tmp_path / "out", Wanted(board=TYPED), QUIET)
    write_views(tmp_path / "alike", board_views(1) * 20)
    with pytest.raises(SlamsimError, match="20 images, of which 1 differ"):
        calibrate_cameras(tmp_path / "alike", tmp_path / "out", Wanted(board=TYPED), QUIET)


def test_views_that_are_not_tilted_give_no_number(tmp_path: Path) -> None:
    write_views(tmp_path / "flat", board_views(10, tilt=0.0))
    found = calibrate_cameras(tmp_path / "flat", tmp_path / "out", Wanted(board=TYPED), QUIET)
    (camera,) = found.cameras
    assert camera.model is None and camera.quantities[0].verdict == "inconclusive"
    assert "tilted" in found.notes[0]
    assert [each.name for each in (tmp_path / "out").glob("*.yaml")] == ["calibration.yaml"]


def test_tags_of_a_folder_need_a_path(
    boards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thirty: Driven
) -> None:
    seen = {"image": (thirty.views, SETTING.model)}
    monkeypatch.setattr(inputs, "tags_of", lambda *_: seen)
    with pytest.raises(SlamsimError, match="tells no path of the robot"):
        calibrate_cameras(boards, tmp_path / "out", Wanted(tags="apriltag_36h11:0.16"), QUIET)


@pytest.mark.long
def test_tags_on_a_drive_give_mount_and_clock(
    boards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thirty: Driven
) -> None:
    setting, one = SETTING, thirty
    monkeypatch.setattr(
        inputs,
        "tags_of",
        lambda cameras, topics, *_: {topics[0].topic: (one.views, setting.model)},
    )
    monkeypatch.setattr(inputs, "path_of", lambda *_: (one.path, None, "lidar"))
    monkeypatch.setattr(calibrating, "_claimed_mount", lambda *_: ("base_link", T_CLAIMED))
    wanted = Wanted(tags="apriltag_36h11:0.16")
    found = calibrate_cameras(boards, tmp_path / "out", wanted, QUIET)
    told = {each.name: each for each in found.cameras[0].quantities}
    assert {name: each.verdict for name, each in told.items() if name in "xyz"} == {
        **{"x": "fault", "y": "fault", "z": "inconclusive"}
    }
    assert told["stamps late by"].value == pytest.approx(0.012, abs=0.001)
    assert "--surveyed" in told["z"].wanted
    written = yaml.safe_load((tmp_path / "out" / "calibration.yaml").read_text())
    (entry,) = written["cameras"].values()
    words = entry["static_transform"].split()
    quat = {word[2:]: float(words[k + 1]) for k, word in enumerate(words) if word[:3] == "--q"}
    turn = Rotation.from_quat([quat[k] for k in ("qx", "qy", "qz", "qw")]).as_matrix()
    assert np.abs(turn - setting.T_base_camera[:3, :3]).max() < 0.002
    assert entry["mount"]["x_m"] == pytest.approx(0.12, abs=0.004)
    assert entry["mount"]["yaw_deg"] == pytest.approx(np.degrees(0.026), abs=0.1)


def test_what_would_tell_a_lens_by_tags_is_more_of_them() -> None:
    unsure: Any = SimpleNamespace(explains=True, model=MODEL, sigma=lambda _: 1e3)
    _, told = calibrating._chosen(unsure, unsure, MODEL)
    assert [each.name for each in told] == ["fx", "fy", "cx", "cy"]
    for each in told:
        assert each.verdict == "inconclusive"
        assert "tags" in each.wanted and "board" not in each.wanted, "there is none on a drive"


def test_a_path_that_drifts_is_used_visit_by_visit() -> None:
    setting = Setting(path_sigmas=(0.0, 0.0), seconds=30.0, rate_hz=4.0)
    one = driven(3, setting)
    steps = between(one.path.poses[:-1], one.path.poses[1:]) * np.array([1.003, 1.003, 1.002])
    poses = [one.path.poses[0]]
    for step in steps:
        poses.append(compose(poses[-1], step))
    visits = by_visits(one.views)
    assert len(np.unique(visits.numbers)) > len(np.unique(one.views.numbers))
    odometry = PlanarTrajectory(one.path.stamps_ns, np.array(poses))
    found = fit_mount(visits, setting.model, odometry, T_CLAIMED)
    off = found.moved_from(setting.T_base_camera)
    assert np.abs(off[:2]).max() < 0.01 and np.degrees(np.abs(off[3:]).max()) < 0.2
    assert abs(found.late_s - setting.late_s) < 0.002
    unsure = inputs.unsure_by_wheels(found)
    assert unsure.sigma("x_m") > 0.01 and unsure.sigma("yaw_rad") > np.radians(0.5)
    assert unsure.sigma("roll_rad") == found.sigma("roll_rad")


def test_a_quantity_is_judged_by_its_interval() -> None:
    def verdict(sigma: float, claimed: float | None) -> str:
        return quantity("x", (0.5, sigma, "m"), claimed, 0.01, "more turns").verdict

    assert verdict(0.001, 0.5) == "ok"
    assert verdict(0.001, 0.4) == "fault"
    assert verdict(0.1, 0.5) == "inconclusive"
    assert verdict(0.001, None) == "measured"
    assert verdict(1.0, None) == "inconclusive"
    near = quantity("x", (0.5, 0.001, "m"), 0.4905, 0.01, "more turns")
    assert near.verdict == "inconclusive" and "off by 0.0095 m" in near.wanted
    well_within = quantity("x", (0.5, 0.0046, "m"), 0.4985, 0.01, "more turns")
    assert (well_within.verdict, well_within.wanted) == ("inconclusive", "more turns")


def test_visits_of_one_tag_are_told_apart_by_time(thirty: Driven) -> None:
    same = thirty.views.those(np.zeros(6, dtype=np.int64))
    at_s = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 30.0])
    visits = by_visits(replace(same, stamps_ns=(at_s * 1e9).astype(np.int64)))
    assert len(np.unique(visits.numbers)) == 3
    assert np.unique(visits.numbers % 1_000_000).size == 1
