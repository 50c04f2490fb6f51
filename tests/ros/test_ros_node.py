"""The ROS 2 node: its parameters, its launch file, and a whole run of it by the stub of rclpy."""

from __future__ import annotations

import json
import math
import os
import runpy
import signal
import subprocess
import sys
import time
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_data import ODOM, SCAN
from ros_stub import STUB, TIMEOUT_S, node, publisher, stub  # noqa: F401
from scan_recording import healthy, truth

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused, SlamsimError
from slamsim.io.open import open_recording
from slamsim.recording.cleaning.streams import odometry_of
from slamsim.ros.parameters import NodeParameters

START_NS = 1_700_000_000_000_000_000
LAUNCH_FILE = Path(__file__).parents[2] / "slamsim" / "ros" / "slamsim.launch.py"


def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *arguments: str) -> Any:
    """Start the node up to where mapping begins: (source, setup, ports) as mapping gets them."""
    from slamsim.ros import node as module

    given: list[Any] = []

    def live_remote(source: Any, setup: Any, ports: Any, reporter: Any) -> dict[str, object]:
        given.extend((source, setup, ports))
        return {"messages": 0}

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "live_remote", live_remote)
    module.run_node(["slamsim.ros", *arguments])
    return given


def test_without_parameters_topics_are_chosen_by_type(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source, setup, ports = run(monkeypatch, tmp_path)
    assert source.url == "ROS 2 node /slamsim"
    wanted = setup.wanted
    assert (wanted.scans, wanted.odometry, wanted.imu) == ((), "", "")
    assert not setup.record and setup.publishes_transform and setup.map_topic == ""
    assert setup.folder == Path("outputs/robot_live")
    assert (ports.page, ports.rosbridge, ports.foxglove) == (0, 0, 0)


def test_parameters_reach_the_mapping(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    robot = node("robot")
    publisher(robot, "/base_scan", SCAN.type_name)
    publisher(robot, "/wheels", ODOM.type_name)
    (tmp_path / "my.yaml").write_text("mapping: {resolution_m: 0.1}\n")
    words = (
        "-p scan_topic:=scan -p odom_topic:=/wheels -p map_topic:=map -p record:=true "
        "-p publish_tf:=false -p config:=my.yaml -p output_folder:=out -r scan:=base_scan"
    )
    _, setup, _ = run(monkeypatch, tmp_path, "--ros-args", *words.split())
    assert (setup.wanted.scans, setup.wanted.odometry) == (("/base_scan",), "/wheels")
    assert setup.record and not setup.publishes_transform and setup.map_topic == "/map"
    assert setup.folder == Path("out") and setup.config.mapping.resolution_m == 0.1


@pytest.mark.parametrize(
    ("words", "kind", "reason"),
    [
        ("scan:=/scan", OverrideRefused, "settings of the node are ROS parameters"),
        ("--ros-args -p record:=7", OverrideRefused, "parameter record: .* expecting type"),
        ("--ros-args -p scan_topic:=a//b/", OverrideRefused, "scan_topic: 'a//b/' is no name"),
        ("--ros-args -x", SlamsimError, "ROS 2 does not start: Found unknown ROS arguments: '-x'"),
        ("--ros-args -p config:=no.yaml", NotFound, "no.yaml"),
        ("--ros-args -p imu_topic:=/imu", InputRefused, "nothing publishes /imu within 0 s"),
    ],
)
def test_what_a_user_gets_wrong_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: str, kind: Any, reason: str
) -> None:
    from slamsim.ros import node as module

    monkeypatch.setattr(module, "PATIENCE_S", 0.1)
    with pytest.raises(kind, match=reason):
        run(monkeypatch, tmp_path, *words.split())


@pytest.mark.parametrize("overwrite", ["true", "false"])
def test_files_of_others_are_not_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, overwrite: str
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("x")
    words = f"--ros-args -p output_folder:=out -p overwrite:={overwrite}"
    with pytest.raises(SlamsimError, match="holds files that slamsim did not write"):
        run(monkeypatch, tmp_path, *words.split())
    assert (tmp_path / "out" / "mine.txt").read_text() == "x"


def test_parameters_cannot_be_changed_while_the_node_runs() -> None:
    from slamsim.ros.node import _parameters

    made = node("slamsim")
    assert asdict(_parameters(made)) == asdict(NodeParameters())
    for one in fields(NodeParameters):
        assert made.descriptors[one.name].read_only
        assert made.descriptors[one.name].description == one.metadata["help"]


def test_the_launch_file_passes_each_parameter_as_its_type() -> None:
    arguments: Any
    *arguments, started = runpy.run_path(str(LAUNCH_FILE))["generate_launch_description"]().entities
    declared = {one.name: one.default_value for one in arguments}
    assert declared.pop("python") == "python3"
    (values,) = started.parameters
    assert values.keys() == declared.keys()
    defaults = asdict(NodeParameters()) | {"use_sim_time": False}
    assert declared == {name: str(default).lower() for name, default in defaults.items()}
    for name, default in defaults.items():
        assert values[name].value.name == name and values[name].value_type is type(default)
    assert (started.executable.name, [*started.arguments]) == ("python", ["-m", "slamsim.ros"])
    assert started.name == "slamsim" and float(started.sigterm_timeout) > 60


def node_process(*arguments: str, path: Path | None = None, **environment: str) -> Any:
    """Options for a process of the node; path: before all others where modules are sought."""
    paths = [str(path)] if path else []
    paths += [entry for entry in sys.path if entry and entry != str(STUB)]
    return {
        "args": [sys.executable, "-m", "slamsim.ros", *arguments],
        "env": os.environ | {"PYTHONPATH": os.pathsep.join(paths)} | environment,
        "text": True,
    }


def ended(*arguments: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    options = node_process(*arguments, path=path)
    return subprocess.run(**options, capture_output=True, timeout=60, check=False)


def test_without_ros_the_node_says_what_to_source() -> None:
    if any((Path(entry) / "rclpy").exists() for entry in sys.path if entry != str(STUB)):
        pytest.skip("ROS 2 is installed here")
    done = ended("--ros-args", "-p", "record:=true")
    assert done.returncode == NotFound.exit_code and done.stdout == ""
    assert done.stderr.startswith(
        "slamsim: there is no ROS 2 here (no module rclpy): source /opt/ros/"
    )
    assert done.stderr.count("\n") == 1 and "setup.bash, then start again" in done.stderr


def test_a_ros_for_another_python_is_told(tmp_path: Path) -> None:
    (tmp_path / "rclpy").mkdir()
    words = "The C extension '/opt/ros/humble/_rclpy.so' isn't present on the system."
    (tmp_path / "rclpy" / "__init__.py").write_text(f"raise ImportError({words!r})")
    done = ended(path=tmp_path)
    assert done.returncode == NotFound.exit_code
    version = ".".join(map(str, sys.version_info[:2]))
    assert f"rclpy cannot be loaded by this Python {version} (ImportError: {words})" in done.stderr


def test_help_and_launch_file_are_told_without_ros() -> None:
    shown = ended("--help")
    assert shown.returncode == 0
    assert all(f"  {one.name} " in shown.stdout for one in fields(NodeParameters))
    assert Path(ended("--launch-file").stdout.strip()) == LAUNCH_FILE


@pytest.mark.long
def test_a_node_that_waits_for_a_robot_ends_at_ctrl_c(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--ros-args", "-p", "odom_topic:=/odom", "-p", f"output_folder:={out}")
    with subprocess.Popen(**node_process(*words, path=STUB), stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "[INFO] Waiting for /odom\n"
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 128 + signal.SIGINT
    assert told == "slamsim: stopped; nothing was left half-written\n"
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("with_tf", [True, False])
def test_a_robot_is_mapped_until_ctrl_c(with_tf: bool, tmp_path: Path) -> None:
    """A simulated drive through the stub, some times faster than real; see ``ros_player``."""
    heard_file, out = tmp_path / "heard.json", tmp_path / "out"
    options = node_process(
        *("--ros-args", "-p", "use_sim_time:=true", "-p", "record:=true"),
        *("-p", f"output_folder:={out}"),
        path=STUB,
        SLAMSIM_TEST_ROBOT="ros_player",
        SLAMSIM_TEST_HEARD=str(heard_file),
        **({"SLAMSIM_TEST_TF": "1"} if with_tf else {}),
    )
    with subprocess.Popen(**options, stderr=subprocess.PIPE) as process:
        begun_s = time.monotonic()
        while not _is_mapped(heard_file):
            assert process.poll() is None and time.monotonic() - begun_s < 10 * TIMEOUT_S
            time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=2 * TIMEOUT_S)
    assert process.returncode == 0, told
    assert f"[INFO] Written to {out}/: duration" in told
    heard = json.loads(heard_file.read_text())
    (edge,) = heard["/tf"]["transforms"]
    assert (edge["header"]["frame_id"], edge["child_frame_id"]) == ("map", "odom")
    assert np.abs(_error_of(edge)[:2]).max() < 0.05 and abs(_error_of(edge)[2]) < 0.01
    status = {
        one["key"]: one["value"] for one in heard["/slamsim/diagnostics"]["status"][0]["values"]
    }
    assert status["tracking"] == "tracking" and status["dropped"] == "0"
    cells = np.array(heard["/map"]["data"])
    assert (
        np.count_nonzero(cells > 70) > 100 and np.count_nonzero((cells >= 0) & (cells < 30)) > 1000
    )
    assert (out / "map" / "map.yaml").exists()
    opened = open_recording(out / "drive_1")
    assert {len(one) for one in opened.recording.scans} == {200}
    parents = {edge.parent for edge in opened.recording.transforms}
    assert ("odom" in parents) == with_tf and "map" not in parents


def _is_mapped(heard: Path) -> bool:
    """The last scan was placed, and a map of most of them is there."""
    if not heard.exists():
        return False
    last = json.loads(heard.read_text())
    if not last.keys() >= {"/map", "/tf", "/slamsim/diagnostics"}:
        return False
    placed_ns, drawn_ns = map(_stamp_ns, (last["/tf"]["transforms"][0], last["/map"]))
    scans_ns = START_NS + healthy().scans[0].stamps_ns
    return bool(placed_ns == scans_ns[-1] and drawn_ns > scans_ns[-50])


def _stamp_ns(message: Any) -> int:
    stamp = message["header"]["stamp"]
    return int(stamp["sec"]) * 10**9 + int(stamp["nanosec"])


def _error_of(edge: Any) -> FloatArray:
    """(3,) of the pose that map -> odom gives, against the truth; the map begins at the first."""
    at_ns = np.array([_stamp_ns(edge) - START_NS])
    part, turn = edge["transform"]["translation"], edge["transform"]["rotation"]
    T_map_odom = np.array([part["x"], part["y"], 2.0 * math.atan2(turn["z"], turn["w"])])
    odometry, _ = odometry_of(healthy().odometries[0])
    assert odometry is not None
    T_odom_base, T_world_base = (one.at(at_ns)[0] for one in (odometry, truth()))
    expected = between(truth().poses[0], T_world_base)
    return between(expected, compose(T_map_odom, T_odom_base))
