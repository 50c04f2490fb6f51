"""Sensors in ``sensors.additional``: those of the package, and one that is installed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_example import room_depth
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from sensing_example import Robot, figure_eight, room, standing, windows

from slamsim.config.loading import load_run_config
from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import mount_transform
from slamsim.guard.errors import OverrideRefused, SlamsimError
from slamsim.io.ros.encoding import stream_messages
from slamsim.recording.images import RawCameraInfos, RawImages
from slamsim.sensors.base import static_frames
from slamsim.sensors.kinds.depth_camera import DepthBatch
from slamsim.sensors.rig import SensorRig
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header

CAMERA = {
    "type": "depth_camera",
    "name": "front_camera",
    "rate_hz": 9.0,
    "width": 12,
    "height": 8,
    "mount": {"x_m": 0.1, "z_m": 0.3, "pitch_deg": 20.0, "yaw_deg": 30.0},
    "clock": {"jitter_s": 0.001, "latency_s": 0.01, "drop_probability": 0.1},
}
REAR = {
    "type": "planar_lidar",
    "name": "rear",
    "rate_hz": 13.0,
    "beam_count": 31,
    "angle_step_deg": 5.0,
    "mount": {"x_m": -0.1, "z_m": 0.2, "yaw_deg": 180.0},
}
CONFIG = SensorsConfig.model_validate({"additional": [CAMERA, REAR]})
DRIVE = figure_eight(0.7)


def messages(cuts: list[int]) -> dict[str, bytes]:
    """The CDR bytes of each topic, end to end."""
    rig, found = SensorRig(room(), Robot(), CONFIG, seed=3), dict[str, bytes]()
    for window in windows(DRIVE, cuts):
        for batch in rig.sense(window).additional:
            for stream in batch.streams():
                if len(stream):
                    rows = stream_messages(stream).rows(slice(None))
                    found[stream.topic] = found.get(stream.topic, b"") + rows.tobytes()
    return found


@settings(max_examples=15)
@given(st.lists(st.integers(2, len(DRIVE) - 1), max_size=30))
def test_the_same_bytes_however_the_drive_is_cut(cuts: list[int]) -> None:
    whole = messages([])
    assert whole.keys() == {topic for entry in CONFIG.additional for topic in entry.topics}
    assert messages(cuts) == whole


def test_other_sensors_measure_what_they_do_without_them() -> None:
    alone = SensorRig(room(), Robot(), SensorsConfig(), seed=3).sense(DRIVE)
    beside = SensorRig(room(), Robot(), CONFIG, seed=3).sense(DRIVE)
    np.testing.assert_array_equal(alone.scans.ranges_m, beside.scans.ranges_m)
    np.testing.assert_array_equal(alone.imu.stream.stamps_ns, beside.imu.stream.stamps_ns)


def test_depths_are_those_of_planes_met_by_hand() -> None:
    """A room of axis-aligned walls: the nearest of its planes, pixel by pixel, in plain Python."""
    rig = SensorRig(room(), Robot(), CONFIG, seed=0)
    batch = rig.sense(standing(0.2)).additional[0]
    assert isinstance(batch, DepthBatch)
    entry, T_base_camera = batch.entry, mount_transform(CONFIG.additional[0].mount)
    base = standing(0.2).positions_m[0]
    wrong = 0
    for row in range(entry.height):
        for column in range(entry.width):
            right = (column - 0.5 * (entry.width - 1)) / entry.focal_px
            down = (row - 0.5 * (entry.height - 1)) / entry.focal_px
            toward = T_base_camera[:3, :3] @ np.array([1.0, -right, -down])
            depth = room_depth(base + T_base_camera[:3, 3], toward)
            told = float(batch.depths_mm[0, row, column]) * 1e-3
            inside = entry.depth_min_m <= depth <= entry.depth_max_m
            wrong += abs(told - (depth if inside else 0.0)) > 6e-4
    assert batch.depths_mm[0].max() > 500
    assert wrong == 0


def test_messages_are_what_rosbags_reads() -> None:
    rig = SensorRig(room(), Robot(), CONFIG, seed=0)
    images, infos = rig.sense(standing(0.5)).additional[0].streams()
    assert isinstance(images, RawImages)
    assert isinstance(infos, RawCameraInfos)
    store = get_typestore(Stores.ROS2_HUMBLE)
    for stream in (images, infos):
        rows = stream_messages(stream).rows(slice(None))
        message: Any = store.deserialize_cdr(rows[:1].tobytes(), stream.schema.type_name)
        assert message.header.frame_id == "front_camera_optical_frame"
        assert (message.width, message.height) == (12, 8)
        if stream is images:
            assert (message.encoding, message.step) == ("16UC1", 24)
            assert bytes(message.data) == images.data[0].tobytes()
        else:
            np.testing.assert_array_equal(message.k, infos.k)
            assert message.k[0] == pytest.approx(6.0 / np.tan(np.radians(43.5)))
        assert bytes(store.serialize_cdr(message, stream.schema.type_name)) == rows[:1].tobytes()


def test_frames_of_the_camera() -> None:
    edges = {edge.child: edge for edge in static_frames(CONFIG.additional)}
    assert edges["front_camera_link"].parent == "base_footprint"
    optical = edges["front_camera_optical_frame"].T_parent_child
    np.testing.assert_array_equal(optical[:3, :3] @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    assert np.linalg.det(optical) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ("[{type: depth_cam, name: a, mount: {}}]", "did you mean 'depth_camera'"),
        ("[{type: depth_camera, name: A, mount: {}}]", "must match"),
        ("[{type: depth_camera, name: a}]", "mount"),
        ("[{type: depth_camera, name: a, mount: {z: 1}}]", "unknown key 'z'"),
        ("[{name: a, mount: {}}]", "'type'"),
        ("3", "must be a list"),
        ("[{type: depth_camera, name: ground_truth, mount: {}}]", "name of the truth"),
        (
            "[{type: depth_camera, name: a, mount: {}}, {type: planar_lidar, name: a, mount: {}}]",
            "two additional sensors are named 'a'",
        ),
    ],
)
def test_wrong_entries_are_refused(entries: str, told: str) -> None:
    with pytest.raises(OverrideRefused, match=told):
        load_run_config(None, None, [f"sensors.additional={entries}"])


def test_a_frame_of_the_robot_is_not_taken_twice() -> None:
    twice = "sensors.additional=[{type: depth_camera, name: camera, mount: {}}]"
    config = load_run_config(None, None, [twice])
    with pytest.raises(SlamsimError, match="'camera_link' already"):
        log_header(build_robot(config.robot), config)


OUTPUT: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 60}
SONAR = """
from typing import Literal
from slamsim.config.streams import SensorEntry

class SonarEntry(SensorEntry):
    type: Literal["sonar"]

    @property
    def topics(self):
        return {f"/{self.name}/range": "sensor_msgs/msg/Range"}

    def build(self, site):
        raise NotImplementedError
"""


def test_an_installed_distribution_adds_a_kind(tmp_path: Path) -> None:
    install(tmp_path, SONAR, "slamsim.sensors.kinds")
    done = with_installed(
        tmp_path,
        "from slamsim.config.loading import load_run_config",
        "entry = 'sensors.additional=[{type: sonar, name: nose, mount: {}}]'",
        "print(load_run_config(None, None, [entry]).sensors.additional[0].topics)",
    )
    assert done.stdout.strip() == "{'/nose/range': 'sensor_msgs/msg/Range'}", done.stderr


GROUPS = (
    "slamsim.sensors.kinds",
    "slamsim.simulation.sinks",
    "slamsim.check.questions",
    "slamsim.sensors.faults",
)
TAKEN = """
from typing import Literal
from slamsim.check.question import FaultKind, Question
from slamsim.config.streams import SensorEntry, SinkEntry
from slamsim.sensors.faults.base import Fault

class TakenSensor(SensorEntry):
    type: Literal["depth_camera"]
    @property
    def topics(self): ...
    def build(self, site): ...

class TakenSink(SinkEntry):
    type: Literal["foxglove"]
    def start(self, topics): ...

class TakenFault(Fault):
    kind: Literal["gyro_bias"]
    def edit(self, recording, rng): ...

TAKEN = Question("laser.yaw", "x", (FaultKind("mine", "x"),), ask=lambda evidence: ())
"""
UNRESOLVED = """
from __future__ import annotations
from slamsim.config.streams import SensorEntry

class Unresolved(SensorEntry):
    type: Nothing["sonar"]
    @property
    def topics(self): ...
    def build(self, site): ...
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("raise SystemExit(3)", "SystemExit"),
        pytest.param("def broken(:", "SyntaxError", marks=pytest.mark.slow),
        (TAKEN, "there is a kind 'gyro_bias' already"),
        (UNRESOLVED, "no type 'sonar'.*Nothing"),
    ],
)
def test_a_broken_distribution_costs_only_what_it_adds(
    tmp_path: Path, module: str, why: str
) -> None:
    install(tmp_path, module, *GROUPS)
    (tmp_path / "fault.yaml").write_text("name: a\nkind: sonar\n")
    done = with_installed(
        tmp_path,
        "from slamsim.check.registry import registry",
        "from slamsim.config.loading import load_run_config",
        "from slamsim.guard.errors import SlamsimError",
        "from slamsim.sensors.faults.registry import kinds, load_fault",
        "assert load_run_config(None, None, []).sensors.additional == ()",
        "assert kinds()['gyro_bias'].__module__ == 'slamsim.sensors.faults.imu'",
        "assert 'laser.yaw' in registry().questions and 'mine' not in registry().faults",
        "entry = 'sensors.additional=[{type: sonar, name: nose, mount: {}}]'",
        "for used in (lambda: load_run_config(None, None, [entry]), lambda: load_fault(FAULT)):",
        "    try: used()",
        "    except SlamsimError as error: print(error)",
        FAULT=str(tmp_path / "fault.yaml"),
    )
    assert done.returncode == 0, done.stderr
    told = done.stdout.splitlines()
    assert len(told) == 2
    if module == UNRESOLVED:  # which is no fault, nor a question
        told = told[:1]
    assert all("sonar_of_mine of the distribution sonar-of-mine" in line for line in told)
    assert re.search(why, done.stdout)
    assert ("questions are not asked" in done.stderr) is (module != UNRESOLVED)


def install(folder: Path, module: str, *groups: str) -> None:
    """A distribution with one module, in these groups of entry points."""
    (folder / "sonar_of_mine.py").write_text(module)
    told = folder / "sonar_of_mine-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: sonar-of-mine\nVersion: 1.0\n")
    lines = [f"[{group}]\nsonar = sonar_of_mine\n" for group in groups]
    (told / "entry_points.txt").write_text("\n".join(lines))


def with_installed(folder: Path, *code: str, **constants: str) -> subprocess.CompletedProcess[str]:
    """What Python says that finds the distributions in a folder."""
    known = [f"{name} = {value!r}" for name, value in constants.items()]
    lines = [f"import sys; sys.path.insert(0, {str(folder)!r})", *known, *code]
    return subprocess.run([sys.executable, "-c", "\n".join(lines)], check=False, **OUTPUT)
