"""Camera images of recordings and folders: decoded, in order, with what is claimed of cameras."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_data import ROS1, ROS2, START_NS, Maker, Robot, as_mcap, as_ros1, as_rosbag2
from camera_data import LIVINGROOM, needs
from typed import typed

from slamsim.cameras.codecs.depth import encode_compressed_depth
from slamsim.cameras.codecs.pictures import encode_jpeg, encode_png
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import MOST_WAITING
from slamsim.io.cameras.survey import read_with_cameras
from slamsim.io.open import open_recording
from slamsim.report.viewer.run import write_recording
from slamsim.report.viewer.unmapped import unmapped
from slamsim.run.cameras.odometry import registered

RANDOM = np.random.default_rng(5)
WIDTH, HEIGHT = 8, 6


class Camera:
    """Messages of a camera, in the types of one ROS."""

    def __init__(self, store: Any = ROS2) -> None:
        self.robot, self.types, self._is_ros1 = Robot(store), store.types, store is ROS1

    def raw(self, at_ns: int, pixels: Any, encoding: str, **changes: Any) -> Any:
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
        told = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0}
        fields: dict[str, Any] = told | {"step": data.size // height, "data": data} | changes
        header = self.robot.header(START_NS + at_ns, fields.pop("frame", "camera_optical"))
        return self.types["sensor_msgs/msg/Image"](header, *fields.values())

    def packed(self, at_ns: int, told: str, data: bytes) -> Any:
        header = self.robot.header(START_NS + at_ns, "camera_optical")
        kind = self.types["sensor_msgs/msg/CompressedImage"]
        return kind(header, told, np.frombuffer(data, dtype=np.uint8))

    def info(self, at_ns: int = 0, **changes: Any) -> Any:
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](
            *changes.pop("roi", (0, 0, 0, 0)), False
        )
        fields: dict[str, Any] = {
            "height": HEIGHT,
            "width": WIDTH,
            "distortion_model": "plumb_bob",
            "d": np.array([0.1, -0.05, 0.001, 0.0, 0.0]),
            "k": np.array([10.0, 0.0, 3.5, 0.0, 11.0, 2.5, 0.0, 0.0, 1.0]),
            "r": np.eye(3).ravel(),
            "p": np.zeros(12),
            "binning_x": 0,
            "binning_y": 0,
        } | changes
        header = self.robot.header(START_NS + at_ns, fields.pop("frame", "camera_optical"))
        return self.types["sensor_msgs/msg/CameraInfo"](header, *fields.values(), roi)


CAMERA = Camera()


def bag(path: Path, *messages: tuple[str, Any]) -> Path:
    """(topic, message) received one ns after the other."""
    timed = [(topic, START_NS + i, message) for i, (topic, message) in enumerate(messages)]
    return as_mcap(path, timed)


def colours(*shape: int) -> Any:
    return RANDOM.integers(0, 255, (*(shape or (HEIGHT, WIDTH)), 3), dtype=np.uint8)


def depths_mm(low: int = 300, high: int = 9000) -> Any:
    image = RANDOM.integers(low, high, (HEIGHT, WIDTH), dtype=np.uint16)
    image[0, :2] = 0
    return image


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_frames_of_every_transport_come_as_recorded(kind: str, tmp_path: Path) -> None:
    store = ROS1 if kind == "bag" else ROS2
    camera, colour, depth = Camera(store), colours(), depths_mm()
    in_m = (1e-3 * depth).astype(np.float32)
    messages = [
        ("/cam/color/camera_info", START_NS, camera.info()),
        ("/cam/color/image_raw", START_NS + 5, camera.raw(1, colour, "rgb8")),
        ("/cam/depth/image_rect_raw", START_NS + 6, camera.raw(2, depth, "16UC1")),
        (
            "/cam/depth/image_rect_raw/compressedDepth",
            START_NS + 7,
            camera.packed(3, *encode_compressed_depth(depth, "rvl")),
        ),
        (
            "/cam/color/image_raw/compressed",
            START_NS + 8,
            camera.packed(4, "rgb8; png compressed bgr8", encode_png(colour)),
        ),
        ("/cam/infra1/image_rect_raw", START_NS + 9, camera.raw(5, colour[:, :, 0], "mono8")),
        ("/cam/float", START_NS + 10, camera.raw(6, in_m, "32FC1")),
    ]
    makers: dict[str, Maker] = {"mcap": as_mcap, "db3": as_rosbag2, "bag": as_ros1}
    path = makers[kind](tmp_path / ("recording.bag" if kind == "bag" else f"a.{kind}"), messages)
    with open_cameras(path) as cameras:
        frames = list(cameras.frames())
        assert [frame.stamp_ns - START_NS for frame in frames] == [1, 2, 3, 4, 5, 6]
        assert [frame.received_ns - START_NS for frame in frames] == [5, 6, 7, 8, 9, 10]
        assert [frame.kind for frame in frames] == [
            *("colour", "depth", "depth", "colour", "grey", "depth")
        ]
        assert {frame.frame_id for frame in frames} == {"camera_optical"}
        for k in (0, 3):
            np.testing.assert_array_equal(frames[k].pixels, colour)
        np.testing.assert_array_equal(frames[4].pixels, colour[:, :, 0])
        for k in (1, 2, 5):
            np.testing.assert_allclose(frames[k].pixels, np.where(depth, in_m, np.nan), rtol=1e-6)
        for topic in ("/cam/color/image_raw", "/cam/color/image_raw/compressed"):
            model = cameras.model(topic)
            assert (model.width, model.height, *model.centre_px) == (WIDTH, HEIGHT, 3.5, 2.5)
            np.testing.assert_array_equal(model.coefficients, [0.1, -0.05, 0.001, 0.0, 0.0])
        assert [each.topic for each in cameras.of_kind("grey")] == ["/cam/infra1/image_rect_raw"]
        assert cameras.depth_partners()["/cam/float"] == "/cam/color/image_raw"


def test_only_the_wanted_topics_are_given(tmp_path: Path) -> None:
    messages = [(f"/{name}", CAMERA.raw(k, colours(), "rgb8")) for k, name in enumerate("abab")]
    with open_cameras(bag(tmp_path / "a.mcap", *messages)) as cameras:
        assert [each.stamp_ns - START_NS for each in cameras.frames({"/b"})] == [1, 3]
        with pytest.raises(NotFound, match=r"no images on /c; there are /a, /b"):
            list(cameras.frames({"/c"}))


def test_the_truth_is_shown_only_when_it_is_asked_for(tmp_path: Path) -> None:
    messages = [
        ("/cam/image", CAMERA.raw(0, colours(), "rgb8")),
        ("/ground_truth/cam/depth", CAMERA.raw(1, depths_mm(), "16UC1")),
    ]
    path = bag(tmp_path / "a.mcap", *messages)
    shown = {truth: set(open_cameras(path, truth).topics) for truth in ("without", "with", "only")}
    assert shown["without"] == {"/cam/image"} and shown["only"] == {"/ground_truth/cam/depth"}
    assert shown["with"] == shown["without"] | shown["only"]


def test_red_and_blue_that_were_packed_in_the_order_of_the_image_are_swapped_back(
    tmp_path: Path,
) -> None:
    colour = colours()
    wrong = encode_png(np.ascontiguousarray(colour[:, :, ::-1]))
    message = CAMERA.packed(0, "rgb8; png compressed rgb8", wrong)
    with open_cameras(bag(tmp_path / "a.mcap", ("/a/compressed", message))) as cameras:
        np.testing.assert_array_equal(next(cameras.frames()).pixels, colour)


BAD = {
    "cut jpeg": (CAMERA.packed(9, "jpeg", encode_jpeg(colours())[:-9]), "cut off"),
    "text": (CAMERA.packed(9, "jpeg", b"this is text"), "neither a PNG nor a JPEG"),
    "nothing": (CAMERA.packed(9, "jpeg", b""), "is empty"),
    "encoding": (CAMERA.raw(9, colours(), "rgb9"), "did you mean 'rgb8'"),
    "zero": (CAMERA.raw(9, colours(), "rgb8", width=0), "is empty"),
    "step": (CAMERA.raw(9, colours(), "rgb8", step=5), "cannot hold"),
    "bytes": (CAMERA.raw(9, colours(), "rgb8", data=np.zeros(5, np.uint8)), "cut off"),
    "bomb": (CAMERA.raw(9, colours(), "rgb8", width=1 << 24, height=1 << 24), "at most"),
    "size": (CAMERA.raw(9, colours(3, 4), "rgb8"), "is 4 x 3, while its topic began with 8 x 6"),
    "metres": (CAMERA.raw(9, depths_mm(1, 9), "16UC1"), "metres: 16UC1 holds millimetres"),
    "millimetres": (
        CAMERA.raw(9, depths_mm().astype(np.float32), "32FC1"),
        "millimetres: 32FC1 holds metres",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_an_image_that_cannot_be_right_is_refused_by_its_number(name: str, tmp_path: Path) -> None:
    message, why = BAD[name]
    packed = CAMERA.packed(0, "jpeg", encode_jpeg(colours()))
    good = packed if hasattr(message, "format") else CAMERA.raw(0, colours(), "rgb8")
    path = bag(tmp_path / "a.mcap", ("/cam", good), ("/cam", message), ("/cam", good))
    with open_cameras(path) as cameras:
        frames = list(cameras.encoded())
        assert len(frames) == 3
        with pytest.raises(InputRefused, match=why) as refused:
            frames[1].decoded()
        assert refused.value.where == "topic /cam, image 2"
        assert frames[2].decoded().pixels.shape == (HEIGHT, WIDTH, 3)


def test_a_few_depths_tell_no_unit(tmp_path: Path) -> None:
    """A covered camera sees a few pixels of noise; and one without any depth is none of both."""
    few = np.zeros((20, 20), np.uint16)
    few[0, :3] = 5
    path = bag(tmp_path / "a.mcap", ("/cam", CAMERA.raw(0, few, "16UC1")))
    (frame,) = open_cameras(path).frames()
    assert np.isfinite(frame.pixels).sum() == 3


def test_a_topic_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    broken = [("/bad", CAMERA.packed(k, "jpeg", b"text")) for k in range(12)]
    good = ("/good", CAMERA.raw(0, colours(), "rgb8"))
    late = [*broken[:5], ("/bad", CAMERA.packed(9, "png", encode_png(colours())))]
    with open_cameras(bag(tmp_path / "a.mcap", *broken, good)) as cameras:
        assert set(cameras.topics) == {"/good"}
        assert "neither" in cameras.unread["/bad"]
        with pytest.raises(InputRefused, match=r"no depth is registered.*; /bad: .*neither"):
            registered(cameras)
        with pytest.raises(InputRefused, match="neither"):
            cameras.frames({"/bad"}).__next__()
    with open_cameras(bag(tmp_path / "b.mcap", *late, good)) as cameras:
        assert set(cameras.topics) == {"/good", "/bad"} and not cameras.unread
    whole, some = (read_with_cameras(tmp_path / f"{name}.mcap") for name in "ab")
    assert not whole.anomalies and not whole.unread
    ((topic, reason),) = whole.unread_cameras
    assert topic == "/bad" and "neither" in reason
    assert (
        not some.unread_cameras
        and not some.anomalies
        and some.cameras[0].damaged.tolist() == [0, 1, 2, 3, 4]
    )
    with open_cameras(bag(tmp_path / "c.mcap", ("/i", CAMERA.info()))) as cameras:
        assert not cameras.topics and list(cameras.frames()) == []


def test_check_map_and_view_tell_why_images_cannot_be_read(tmp_path: Path) -> None:
    cut = encode_jpeg(colours())[:-9]
    bag(tmp_path / "a.mcap", *(("/cam", CAMERA.packed(k, "jpeg", cut)) for k in range(3)))
    found = typed("map", "a.mcap", "--out", "mapped", cwd=tmp_path)
    assert found.returncode == 3 and not (tmp_path / "mapped").exists()
    assert "/cam: cannot be read: the JPEG is cut off" in " ".join(found.stderr.split())
    seen = typed("view", "a.mcap", "--screenshot", "a.png", cwd=tmp_path)
    assert seen.returncode == 3
    assert "none of its images can be read; /cam: the JPEG is" in " ".join(seen.stderr.split())
    checked = typed("check", "a.mcap", cwd=tmp_path)
    assert checked.returncode == 1, "a fault, whatever else is in order"
    told = " ".join(checked.stdout.split())
    assert "camera_damaged /cam" in told and "can be decoded: the JPEG is cut off" in told


def test_info_tells_the_images_of_a_recording(tmp_path: Path) -> None:
    bag(
        tmp_path / "a.mcap",
        ("/cam/camera_info", CAMERA.info()),
        ("/cam/image", CAMERA.raw(1, colours(), "rgb8")),
        ("/depth", CAMERA.raw(1, np.full((6, 8), 900, np.uint16), "16UC1")),
        *(("/bad", CAMERA.packed(k, "jpeg", b"text")) for k in range(3)),
    )
    told = typed("info", "a.mcap", cwd=tmp_path)
    assert told.returncode == 0
    for words in (
        "Images: /cam/image: colour, 1 images of 8 x 6, with its camera",
        "Images: /depth: depth, 1 images of 8 x 6",
        "Images: /bad: not read: ",
        "Missing: no scans: the depth camera maps in their place",
        "Next: slamsim map a.mcap",
    ):
        assert words in told.stdout
    facts = json.loads(typed("info", "a.mcap", "--json", cwd=tmp_path).stdout)
    assert [each["topic"] for each in facts["images"]] == ["/cam/image", "/depth"]
    assert [each["topic"] for each in facts["unread_images"]] == ["/bad"]


CLAIMS: dict[str, tuple[dict[str, Any], str]] = {
    "size": ({"width": 9}, "says 9 x 6, but images of /cam/image are 8 x 6"),
    "uncalibrated": ({"k": np.zeros(9)}, "singular"),
    "singular": ({"k": np.array([10.0, 0, 3.5, 0, 0, 2.5, 0, 0, 1])}, "singular"),
    "nan": ({"k": np.array([np.nan, 0, 3.5, 0, 10, 2.5, 0, 0, 1])}, "not finite"),
    "fold": ({"d": np.array([-3.0, 0, 0, 0, 0])}, "folds inside the image"),
    "model": ({"distortion_model": "plumb_bobb"}, "did you mean 'plumb_bob'"),
    "many": ({"d": np.ones(9)}, "has 5 coefficients"),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_a_claim_that_no_camera_can_be_is_refused(name: str, tmp_path: Path) -> None:
    changes, why = CLAIMS[name]
    image = ("/cam/image", CAMERA.raw(1, colours(), "rgb8"))
    path = bag(tmp_path / "a.mcap", ("/cam/camera_info", CAMERA.info(**changes)), image)
    with open_cameras(path) as cameras:
        with pytest.raises(InputRefused, match=why) as refused:
            cameras.model("/cam/image")
        assert "/cam/camera_info" in refused.value.where
        assert cameras.infos["/cam/image"].frame_id == "camera_optical"
    with (
        open_cameras(bag(tmp_path / "b.mcap", image)) as cameras,
        pytest.raises(NotFound, match="CameraInfo"),
    ):
        cameras.model("/cam/image")


def test_claims_are_for_the_whole_sensor_images_for_its_window(tmp_path: Path) -> None:
    """A point of the world lies at the same place, whichever part is read out and binned."""
    whole = CAMERA.info(width=64, height=48, d=np.zeros(5))
    part = CAMERA.info(
        width=64, height=48, d=np.zeros(14), roi=(12, 20, 12, 16), binning_x=2, binning_y=2
    )
    part.k = whole.k = np.array([40.0, 0, 31.5, 0, 40.0, 23.5, 0, 0, 1])
    path = bag(
        tmp_path / "a.mcap",
        ("/whole/camera_info", whole),
        ("/part/camera_info", part),
        ("/whole/image", CAMERA.raw(0, colours(48, 64), "rgb8")),
        ("/part/image", CAMERA.raw(0, colours(6, 8), "rgb8")),
    )
    with open_cameras(path) as cameras:
        models = [cameras.model(f"/{name}/image") for name in ("whole", "part")]
    assert (models[1].width, models[1].height) == (8, 6)
    point = np.array([[-0.2, 0.1, 1.0]])
    pixel, inside = (model.project(point)[0][0] for model in models)
    # roi: x_offset, y_offset, height, width; pixel edges are half a pixel before the middle.
    np.testing.assert_allclose((pixel + 0.5 - [12, 20]) / 2 - 0.5, inside, atol=1e-12)


def test_a_fisheye_by_the_name_that_opencv_gives_it_is_equidistant(tmp_path: Path) -> None:
    d = np.array([0.1, 0.0, 0.0, 0.0])
    messages = [
        ("/ros/camera_info", CAMERA.info(distortion_model="equidistant", d=d)),
        ("/cv/camera_info", CAMERA.info(distortion_model="fisheye", d=d)),
        ("/ros/image", CAMERA.raw(0, colours(), "rgb8")),
        ("/cv/image", CAMERA.raw(0, colours(), "rgb8")),
    ]
    with open_cameras(bag(tmp_path / "a.mcap", *messages)) as cameras:
        models = [cameras.model(f"/{name}/image") for name in ("ros", "cv")]
        assert cameras.infos["/cv/image"].distortion_model == "equidistant"
    point = np.array([[-0.2, 0.1, 1.0]])
    pixels = [model.project(point)[0] for model in models]
    np.testing.assert_array_equal(pixels[0], pixels[1])


def test_the_only_claim_of_the_same_frame_is_taken(tmp_path: Path) -> None:
    messages = [
        ("/elsewhere/info", CAMERA.info()),
        ("/other/info", CAMERA.info(frame="other")),
        ("/cam/image", CAMERA.raw(0, colours(), "rgb8")),
    ]
    with open_cameras(bag(tmp_path / "a.mcap", *messages)) as cameras:
        assert cameras.infos["/cam/image"].source == "topic /elsewhere/info"


def test_pairs_are_the_nearest_in_time(tmp_path: Path) -> None:
    ms = 1_000_000
    depths = [("/d", CAMERA.raw(k * 33 * ms, depths_mm(), "16UC1")) for k in range(9)]
    colour = [("/c", CAMERA.raw(k * 66 * ms + 4 * ms, colours(), "rgb8")) for k in range(5)]
    shuffled = [*colour[:2], *depths[:5], *colour[2:], *depths[5:]]
    with open_cameras(bag(tmp_path / "a.mcap", *shuffled)) as cameras:
        found = [
            (a.stamp_ns - START_NS, b.stamp_ns - START_NS) for a, b in cameras.pairs("/c", "/d")
        ]
        none = list(cameras.pairs("/c", "/d", within_ns=ms))
    assert found == [(k * 66 * ms + 4 * ms, k * 66 * ms) for k in range(5)]
    assert none == []


def test_frames_without_a_partner_do_not_pile_up(tmp_path: Path) -> None:
    alone = [("/d", CAMERA.raw(k, depths_mm(), "16UC1")) for k in range(2 * MOST_WAITING)]
    late = 10**12
    last = [
        ("/c", CAMERA.raw(late, colours(), "rgb8")),
        ("/d", CAMERA.raw(late, depths_mm(), "16UC1")),
    ]
    with open_cameras(bag(tmp_path / "a.mcap", *alone, *last)) as cameras:
        assert len(list(cameras.pairs("/d", "/c"))) == 1


def test_a_recording_is_shown_with_its_cameras(tmp_path: Path) -> None:
    drive = Robot(ROS2).drive()
    jpeg = CAMERA.packed(3, "jpeg", encode_jpeg(colours()))
    images = [
        ("/a", START_NS, jpeg),
        ("/bad", START_NS, CAMERA.packed(3, "jpeg", b"text")),
        *(("/b", START_NS + k, CAMERA.raw(k, depths_mm(), "16UC1")) for k in range(20)),
    ]
    path = as_mcap(tmp_path / "a.mcap", [*drive, *images])
    log = open_recording(path).log()
    with open_cameras(path) as cameras:
        thinned = list(cameras.thinned(7))
        write_recording(tmp_path / "with.rrd", unmapped(log), thinned)
    assert [each.number for each in thinned if each.topic == "/b"] == [0, 3, 6, 9, 12, 15, 18]
    write_recording(tmp_path / "without.rrd", unmapped(log))
    written = (tmp_path / "with.rrd").read_bytes()
    assert len(written) > (tmp_path / "without.rrd").stat().st_size
    assert b"cameras/a" in written and b"cameras/bad" not in written


def tum(folder: Path, name: str = "freiburg1_room") -> Path:
    place = folder / name
    for kind in ("rgb", "depth"):
        (place / kind).mkdir(parents=True)
        lines = ["# time file\n"]
        for k in range(3):
            image = colours(480, 640) if kind == "rgb" else np.full((480, 640), 5000 + k, np.uint16)
            (place / kind / f"{k}.png").write_bytes(encode_png(image))
            lines.append(f"130503128{k}.{20 + 5 * (kind == 'depth')} {kind}/{k}.png\n")
        (place / f"{kind}.txt").write_text("".join(lines))
    return place


def test_a_folder_of_tum_rgbd(tmp_path: Path) -> None:
    with open_cameras(tum(tmp_path)) as cameras:
        frames = list(cameras.frames())
        assert [(f.topic, f.stamp_ns) for f in frames[:3]] == [
            ("rgb", 1305031280_200000000),
            ("depth", 1305031280_250000000),
            ("rgb", 1305031281_200000000),
        ]
        np.testing.assert_allclose(frames[3].pixels, 5001 / 5000, rtol=1e-6)
        assert cameras.model("rgb").focal_px[0] == pytest.approx(517.306408)
        assert cameras.depth_partners() == {"depth": "rgb"}
        assert len(list(cameras.pairs("depth", "rgb", within_ns=60_000_000))) == 3


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("abc rgb/0.png", "line 5: a line is 'time file'"),
        ("1.0", "line 5"),
        ("2.0 ../0.png", "inside the folder"),
        ("2.0 /etc/passwd", "inside the folder"),
    ],
)
def test_a_wrong_line_of_tum_is_refused(line: str, why: str, tmp_path: Path) -> None:
    place = tum(tmp_path)
    with (place / "rgb.txt").open("a") as file:
        file.write(line + "\n")
    with pytest.raises(InputRefused, match=why):
        open_cameras(place)


def test_a_missing_image_of_a_folder_is_named(tmp_path: Path) -> None:
    place = tum(tmp_path)
    (place / "rgb" / "1.png").unlink()
    with open_cameras(place) as cameras, pytest.raises(NotFound, match=r"1\.png"):
        list(cameras.frames({"rgb"}))
    (place / "rgb" / "1.png").write_bytes(encode_png(colours(3, 4)))
    with open_cameras(place) as cameras, pytest.raises(InputRefused, match="is 4 x 3"):
        list(cameras.frames({"rgb"}))


SENSOR = """
sensor_type: camera
comment: left
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]
rate_hz: 20
resolution: [8, 6]
camera_model: pinhole
intrinsics: [10.0, 11.0, 3.5, 2.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.02, 0.01, 0.0001, 0.0002]
"""


def asl(folder: Path, sensor: str = SENSOR) -> Path:
    for name in ("cam0", "cam1"):
        place = folder / "mav0" / name
        (place / "data").mkdir(parents=True)
        lines = ["#timestamp [ns],filename\r\n"]
        for k in (1, 0):
            stamp_ns = 1403636579763555584 + 50_000_000 * k
            (place / "data" / f"{stamp_ns}.png").write_bytes(encode_png(colours()[:, :, 0]))
            lines.append(f"{stamp_ns},{stamp_ns}.png\r\n")
        (place / "data.csv").write_text("".join(lines))
        (place / "sensor.yaml").write_text(sensor)
    return folder


@pytest.mark.parametrize("part", [".", "mav0"])
def test_a_folder_of_euroc(part: str, tmp_path: Path) -> None:
    with open_cameras(asl(tmp_path) / part) as cameras:
        assert [each.topic for each in cameras.of_kind("grey")] == ["cam0", "cam1"]
        stamps_ns = [each.stamp_ns for each in cameras.frames()]
        assert stamps_ns == sorted(stamps_ns) and len(stamps_ns) == 4
        assert cameras.model("cam0").distortion_model == "plumb_bob"
        T_body_camera = cameras.infos["cam1"].T_body_camera
        assert T_body_camera is not None
        np.testing.assert_array_equal(T_body_camera[:3, 3], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("radial-tangential", "fov", "is 'fov'; known are radial-tangential, radtan, equidistant"),
        ("pinhole", "omni", "camera_model: a pinhole is needed, not 'omni'"),
        ("resolution: [8, 6]", "resolution: [8]", "resolution: holds 1 numbers, not width, height"),
        ("[10.0, 11.0, 3.5, 2.5]", "[10.0, 11.0]", "intrinsics: holds 2 numbers, not fx, fy, cx"),
        ("intrinsics: [10.0", "intrinsics: [no", "cam0/sensor.yaml"),
    ],
)
def test_a_wrong_sensor_of_euroc_is_refused(old: str, new: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=why):
        open_cameras(asl(tmp_path, SENSOR.replace(old, new)))


def test_a_folder_whose_first_image_is_damaged_is_read(tmp_path: Path) -> None:
    """It is told of the others; where none can be read, the folder is refused."""
    (tmp_path / "rgb").mkdir()
    (tmp_path / "rgb.txt").write_text("".join(f"{k}.0 rgb/{k}.png\n" for k in range(4)))
    whole = encode_png(colours())
    for number in range(4):
        (tmp_path / "rgb" / f"{number}.png").write_bytes(whole[:-9] if number == 0 else whole)
    (seen,) = read_with_cameras(tmp_path).cameras
    assert (seen.size, seen.damaged.tolist()) == ((WIDTH, HEIGHT), [0])
    for number in range(4):
        (tmp_path / "rgb" / f"{number}.png").write_bytes(whole[:-9])
    with pytest.raises(InputRefused, match=r"image 4: the PNG is cut off"):
        read_with_cameras(tmp_path)


def open3d(folder: Path, colour: str = "color") -> Path:
    for name in (colour, "depth"):
        (folder / name).mkdir(parents=True)
        for k in range(3):
            image = colours() if name == colour else depths_mm()
            (folder / name / f"{10 * k:05d}.png").write_bytes(encode_png(image))
    K = [10.0, 0.0, 0.0, 0.0, 11.0, 0.0, 3.5, 2.5, 1.0]
    told = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K}
    (folder / "camera_intrinsic.json").write_text(json.dumps(told))
    return folder


@pytest.mark.parametrize("colour", ["color", "image", "rgb"])
def test_a_folder_of_open3d(colour: str, tmp_path: Path) -> None:
    with open_cameras(open3d(tmp_path / "a", colour)) as cameras:
        assert [f.stamp_ns for f in cameras.frames({"depth"})] == [0, 333_333_330, 666_666_660]
        assert list(cameras.model(colour).centre_px) == [3.5, 2.5]
    (tmp_path / "a" / "depth" / "last.png").write_bytes(b"")
    with pytest.raises(InputRefused, match="which frame"):
        open_cameras(tmp_path / "a")


@needs(LIVINGROOM)
def test_real_frames_of_open3d() -> None:
    with open_cameras(LIVINGROOM) as cameras:
        (depth,), (colour,) = cameras.of_kind("depth"), cameras.of_kind("colour")
        first, second = next(cameras.pairs(depth.topic, colour.topic))
    assert first.pixels.shape == (480, 640) and second.pixels.shape == (480, 640, 3)
    assert 1.0 < np.nanmedian(first.pixels) < 4.0
    seen = cv2.imread(str(next(iter(sorted((LIVINGROOM / "depth").iterdir())))), -1)
    assert seen is not None
    np.testing.assert_allclose(np.nan_to_num(first.pixels), seen * 1e-3, rtol=1e-6)


@pytest.mark.parametrize("name", ["nothing", "empty", "text.log"])
def test_what_holds_no_images_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.log").write_text("PARAM a b 0 c 0\n")
    with pytest.raises((InputRefused, NotFound)) as refused:
        open_cameras(tmp_path / name)
    if name == "text.log":
        assert "rgb.txt" in str(refused.value)
