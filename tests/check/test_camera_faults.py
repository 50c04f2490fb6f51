"""Faults of cameras in recordings with images: what changes in messages, and what does not."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import as_mcap
from test_check_cameras import DEPTH, FRAMES, LEFT, RIGHT, ROBOT, Scene, answers

from slamsim.cameras.changes import Flicker, ScaleDepths, SwapRedBlue
from slamsim.cameras.codecs.depth import decode_compressed_depth, encode_compressed_depth
from slamsim.cameras.codecs.pictures import decode_picture, encode_jpeg, encode_png
from slamsim.check.check import check_recording
from slamsim.config.faults import FaultChoice
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import SlamsimError
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.survey import read_with_cameras, survey
from slamsim.io.copy.images import _packed, _raw
from slamsim.io.copy.recording import copy_recording
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.run.checking import check_log
from slamsim.run.fixing import inject_faults
from slamsim.run.info import tell_info

Images = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Scene().write(tmp_path_factory.mktemp("healthy") / "a.mcap")


def images(path: Path) -> Images:
    """(stamp, pixels as they are stored) of each topic."""
    found: Images = {}
    with open_cameras(path) as cameras:
        for frame in cameras.encoded():
            found.setdefault(frame.topic, []).append((frame.stamp_ns, frame.stored()[1]))
    return found


def faulty(healthy: Path, folder: Path, name: str, size: float | None = None) -> Path:
    inject_faults(healthy, folder / "out", [FaultChoice(name=name, size=size)])
    return folder / "out"


def assert_same(one: list[tuple[int, Any]], other: list[tuple[int, Any]]) -> None:
    assert [stamp for stamp, _ in one] == [stamp for stamp, _ in other]
    for (_, ours), (_, theirs) in zip(one, other, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_depths_are_scaled_and_images_stay(healthy: Path, tmp_path: Path) -> None:
    before, after = images(healthy), images(faulty(healthy, tmp_path, "depth_scale", 0.1))
    for topic in (LEFT, RIGHT):
        assert_same(before[topic], after[topic])
    for (_, ours), (_, theirs) in zip(before[DEPTH], after[DEPTH], strict=True):
        np.testing.assert_array_equal(theirs, np.rint(ours * 1.1).astype(np.uint16))


def test_stamps_of_images_and_camera_info_move_together(healthy: Path, tmp_path: Path) -> None:
    path = faulty(healthy, tmp_path, "camera_late", 0.1)
    before, after = images(healthy), images(path)
    for topic in (LEFT, RIGHT, DEPTH):
        moved = [b[0] - a[0] for a, b in zip(before[topic], after[topic], strict=True)]
        assert moved == [100_000_000] * FRAMES
    from slamsim.io.ros.bag import open_bag
    from slamsim.io.ros.images import stamp_of

    with open_bag(path) as bag:
        infos = [
            stamp_of(bag.deserialize(topic, data))
            for topic, _, data in bag.received({"/cam/left/camera_info"})
        ]
    assert infos == [stamp for stamp, _ in after[LEFT]]


def test_what_is_told_of_shutters_is_custom_data_of_the_recording(
    healthy: Path, tmp_path: Path
) -> None:
    def told(path: Path) -> dict[str, float | None]:
        with open_cameras(path) as cameras:
            return {name: claim.readout_s for name, claim in cameras.infos.items()}

    assert set(told(healthy).values()) == {None}
    rolling = faulty(healthy, tmp_path / "rolling", "camera_readout", 0.02)
    assert told(rolling) == {LEFT: 0.02, RIGHT: 0.02, DEPTH: None}
    assert told(next(rolling.glob("*.mcap"))) == told(rolling)
    still = faulty(rolling, tmp_path / "still", "camera_readout", -0.03)
    assert told(still) == {LEFT: 0.0, RIGHT: 0.0, DEPTH: None}
    with pytest.raises(SlamsimError, match="no camera that its shutter rolls"):
        faulty(still, tmp_path / "again", "camera_readout", -0.03)


def test_a_readout_that_is_no_time_is_told_and_nothing_is_refused(
    healthy: Path, tmp_path: Path
) -> None:
    made = faulty(healthy, tmp_path, "camera_readout", 0.02)
    path = tmp_path / "copied out"
    path.mkdir()
    for file in (made / "metadata.yaml", *made.glob("*.mcap")):
        shutil.copy(file, path)
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("left/image_raw: '0.02'", "left/image_raw: x"))
    read = read_with_cameras(path)
    assert [each.claim.readout_s for each in read.cameras if each.claim] == [None, None, 0.02]
    assert any("readout_s:/cam/left/image_raw are 'x'" in each for each in read.anomalies)


def test_stereo_images_are_exchanged_with_their_frames(healthy: Path, tmp_path: Path) -> None:
    path = faulty(healthy, tmp_path, "stereo_swapped")
    before, after = images(healthy), images(path)
    assert_same(before[LEFT], after[RIGHT])
    assert_same(before[RIGHT], after[LEFT])
    with open_cameras(path) as cameras:
        assert (cameras.topics[LEFT].frame_id, cameras.topics[RIGHT].frame_id) == ("left", "right")


def test_repeated_images_keep_their_stamps(healthy: Path, tmp_path: Path) -> None:
    before = images(healthy)
    after = images(faulty(healthy, tmp_path, "camera_duplicates", 0.5))
    assert [stamp for stamp, _ in after[LEFT]] == [stamp for stamp, _ in before[LEFT]]
    again = [np.array_equal(a[1], b[1]) for a, b in zip(after[LEFT], after[LEFT][1:], strict=False)]
    assert sum(again) == FRAMES // 2


TOLD = {
    "camera_late": None,
    "depth_late": "camera_depth_time",
    "camera_info_size": "camera_intrinsics",
    "camera_info_folds": "camera_intrinsics",
    "depth_unit": "camera_depth_unit",
    "camera_frozen": "camera_frozen",
    "camera_duplicates": "camera_duplicated",
    "camera_flicker": "camera_flicker",
    "stereo_swapped": "camera_stereo_swapped",
    "camera_damaged": "camera_damaged",
    "camera_readout": None,
}
"""Of a camera beside an odometry alone: delays and places need a lidar or a gyroscope."""
SIZES = {"camera_frozen": 0.6, "depth_late": 0.023}


@pytest.mark.long
@pytest.mark.parametrize("name", TOLD)
def test_an_injected_fault_is_named_and_nothing_else(
    name: str, healthy: Path, tmp_path: Path
) -> None:
    recording = read_with_cameras(faulty(healthy, tmp_path, name, SIZES.get(name)))
    asked = answers(recording, place=TOLD[name] is None)
    found = [one for each in asked.values() for one in each]
    assert {one.fault for one in found if one.fault} == ({TOLD[name]} - {None})


@pytest.mark.parametrize(
    "name",
    [
        "stereo_swapped",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("depth_late", "camera_info_size")),
    ],
)
def test_what_fix_proposes_repairs_it(name: str, healthy: Path, tmp_path: Path) -> None:
    """Applied to the recording in memory, and to the copy: both are healthy."""
    path = faulty(healthy, tmp_path, name, SIZES.get(name))
    read = read_with_cameras(path)
    found = [one for each in answers(read).values() for one in each]
    assert any(one.fault for one in found)
    repairs = [repair for one in found if one.fault for repair in one.repairs]
    fixed = apply_repairs(read, repairs)
    copy_recording(path, read, fixed, tmp_path / "fixed")
    for recording in (fixed, read_with_cameras(tmp_path / "fixed")):
        left = [one.fault for each in answers(recording).values() for one in each]
        assert not any(left), (name, left)


def test_repeated_images_are_left_out(healthy: Path, tmp_path: Path) -> None:
    path = faulty(healthy, tmp_path, "camera_duplicates", 0.5)
    read = read_with_cameras(path)
    fixed = apply_repairs(read, [Repair("drop_repeated_images", LEFT)])
    copy_recording(path, read, fixed, tmp_path / "fixed")
    after, before = images(tmp_path / "fixed"), images(healthy)
    assert len(after[LEFT]) == FRAMES // 2
    shown = dict(before[LEFT])
    for stamp, pixels in after[LEFT]:
        np.testing.assert_array_equal(pixels, shown[stamp])


def test_damaged_images_are_left_out(healthy: Path, tmp_path: Path) -> None:
    """Every one, in a copy and in memory, and none beside."""
    path = faulty(healthy, tmp_path, "camera_damaged", 0.3)
    read = read_with_cameras(path)
    lost = {each.topic: set(each.damaged.tolist()) for each in read.cameras}
    assert all(0.1 * FRAMES < len(each) < 0.5 * FRAMES for each in lost.values())
    assert read.cameras[0].sampled.size == FRAMES - len(read.cameras[0].damaged)
    found = answers(read)["camera.damaged"]
    fixed = apply_repairs(read, [repair for one in found for repair in one.repairs])
    copy_recording(path, read, fixed, tmp_path / "fixed")
    after, before = images(tmp_path / "fixed"), images(healthy)
    for topic in (LEFT, RIGHT, DEPTH):
        assert_same(
            after[topic], [each for k, each in enumerate(before[topic]) if k not in lost[topic]]
        )
        assert {one.verdict for one in answers(fixed)["camera.damaged"]} == {"ok"}


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_files_that_are_cut_off_are_told_though_they_are_not_looked_at(
    suffix: str, tmp_path: Path
) -> None:
    """Of a folder of many images some are decoded; the ends of all are read."""
    (tmp_path / "rgb").mkdir()
    grey = np.random.default_rng(4).integers(0, 255, (20, 30)).astype(np.uint8)
    whole = encode_jpeg(grey) if suffix == "jpg" else encode_png(grey)
    for number in range(30):
        data = whole[: len(whole) // 2] if number in (4, 23) else whole
        (tmp_path / "rgb" / f"{number}.{suffix}").write_bytes(data)
    (tmp_path / "rgb.txt").write_text("".join(f"{k}.0 rgb/{k}.{suffix}\n" for k in range(30)))
    with open_cameras(tmp_path) as cameras:
        (seen,) = survey(cameras, most=9)
    assert seen.damaged.tolist() == [4, 23]
    assert seen.sampled.tolist() == [0, 1, 2, 10, 11, 12, 20, 21, 22]


def test_packed_images_stay_packed() -> None:
    rng = np.random.default_rng(2)
    colours = rng.integers(0, 255, (20, 30, 3)).astype(np.uint8)
    swapped = decode_picture(
        _packed("rgb8; png compressed bgr8", encode_png(colours), SwapRedBlue(), 0)
    )
    np.testing.assert_array_equal(swapped, colours[:, :, ::-1])
    jpeg = _packed("jpeg", encode_jpeg(np.full((16, 16), 100, np.uint8)), Flicker(0.2), 1)
    assert jpeg.startswith(b"\xff\xd8")
    assert abs(float(decode_picture(jpeg).mean()) - 100 * (1 + 0.2 * np.sin(2 * np.pi / 3))) < 1.0
    depths = rng.integers(500, 4000, (20, 30)).astype(np.uint16)
    for codec in ("png", "rvl"):
        told, data = encode_compressed_depth(depths, codec)
        found = decode_compressed_depth(told, _packed(told, data, ScaleDepths(2.0), 0))
        np.testing.assert_array_equal(found, 2 * depths)
    told, data = encode_compressed_depth((1e-3 * depths).astype(np.float32))
    metres = decode_compressed_depth(told, _packed(told, data, ScaleDepths(1.5), 0))
    np.testing.assert_allclose(metres, 1.5e-3 * depths, rtol=0.01)


def test_damaged_images_stay_as_they_are() -> None:
    """One of them does not keep the others from being changed."""
    jpeg = encode_jpeg(np.full((16, 16), 100, np.uint8))[:40]
    assert _packed("jpeg", jpeg, Flicker(0.2), 1) == jpeg
    told, data = encode_compressed_depth(np.full((20, 30), 900, np.uint16))
    assert _packed(told, data[:30], ScaleDepths(2.0), 0) == data[:30]
    cut = Message(np.full((3, 4), 900, np.uint16), "16UC1", 0, False)
    cut.data = cut.data[:-1]
    np.testing.assert_array_equal(_raw(cut, ScaleDepths(2.0), 0), cut.data)


def test_grey_images_among_colour_are_counted_as_damaged(tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    colour = np.random.default_rng(4).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    for number in range(4):
        pixels = colour[..., 0] if number == 2 else colour
        (tmp_path / "rgb" / f"{number}.png").write_bytes(encode_png(pixels))
    (tmp_path / "rgb.txt").write_text("".join(f"{k}.0 rgb/{k}.png\n" for k in range(4)))
    (seen,) = read_with_cameras(tmp_path).cameras
    assert (seen.kind, seen.damaged.tolist(), seen.sampled.tolist()) == ("colour", [2], [0, 1, 3])
    assert len(seen.colours) == len(seen.thumbnails) == 3


def test_images_alone_are_checked(tmp_path: Path) -> None:
    """In a recording, and in a folder: what is asked of images is answered, nothing is wrong."""
    scene = Scene()
    alone = as_mcap(tmp_path / "alone.mcap", [m for m in scene.messages() if m[0] != "/odom"])
    report = check_recording(read_with_cameras(alone))
    assert {one.check for one in report.findings if one.verdict == "ok"} >= {"camera.stereo"}
    folder = tmp_path / "frames"
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for k in range(12):
        (folder / "color" / f"{k:05d}.png").write_bytes(encode_png(scene.left[k]))
        (folder / "depth" / f"{k:05d}.png").write_bytes(encode_png(scene.depth[k]))
    images_alone = check_recording(read_with_cameras(folder))
    assert {one.check for one in images_alone.findings if one.verdict == "ok"} >= {
        "camera.depth_unit"
    }
    assert not report.faults and not images_alone.faults
    reporter = Reporter(quiet=False, as_json=False)
    tell_info(folder, reporter)
    check_log(folder, reporter)


def test_nothing_at_all_is_refused(tmp_path: Path) -> None:
    odd = ROBOT.store.types["std_msgs/msg/String"]("nothing")
    path = as_mcap(tmp_path / "a.mcap", [("/words", 1, odd)])
    with pytest.raises(SlamsimError, match="nothing that could be checked"):
        read_with_cameras(path)


class Message:
    """A sensor_msgs/Image."""

    def __init__(self, pixels: Any, encoding: str, padding: int, is_bigendian: bool) -> None:
        self.height, self.width = pixels.shape[:2]
        self.encoding, self.is_bigendian = encoding, is_bigendian
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(self.height, -1)
        self.data = np.hstack([rows, np.full((self.height, padding), 7, np.uint8)]).ravel()
        self.step = rows.shape[1] + padding


@pytest.mark.parametrize("padding", [0, 5])
def test_raw_images_keep_order_and_padding(padding: int) -> None:
    depths = np.arange(1000, 1012).reshape(3, 4)
    big = Message(depths.astype(">u2"), "16UC1", padding, True)
    changed = _raw(big, ScaleDepths(2.0), 0).reshape(3, -1)
    found = np.ascontiguousarray(changed[:, :8]).view(">u2")
    np.testing.assert_array_equal(found, 2 * depths)
    assert (changed[:, 8:] == 7).all()
    colours = np.arange(48, dtype=np.uint8).reshape(3, 4, 4)
    swapped = _raw(Message(colours, "bgra8", padding, False), SwapRedBlue(), 0).reshape(3, -1)
    np.testing.assert_array_equal(swapped[:, :16].reshape(3, 4, 4), colours[:, :, [2, 1, 0, 3]])


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "yuv422"])
def test_mosaics_are_not_repainted(encoding: str) -> None:
    pixels = np.zeros((4, 4, 1 + (encoding == "yuv422")), np.uint8)
    with pytest.raises(ValueError, match="mixes colours"):
        _raw(Message(pixels, encoding, 0, False), SwapRedBlue(), 0)


def test_a_recording_without_cameras_cannot_have_their_faults(
    healthy: Path, tmp_path: Path
) -> None:
    with pytest.raises(SlamsimError, match="no fixed transform to a camera"):
        faulty(healthy, tmp_path, "camera_turned")
    with pytest.raises(SlamsimError, match="no colour images"):
        faulty(healthy, tmp_path, "colours_swapped")
