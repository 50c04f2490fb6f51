"""Odd logs through the whole ``map`` command: every scan is used, or a sentence says why not."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import ROS2, Message, Robot, as_mcap
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.core.types import Float32Array, FloatArray
from slamsim.io.ros.message_types import inflate
from slamsim.process.exit_codes import run_command

pytestmark = pytest.mark.usefixtures("undrawn_figures")
BEAMS, COUNT = 181, 60
SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND


def quick(names: Iterable[str], *always: str) -> list[Any]:
    """Parameters of which only some are in the default suite: each maps a whole log."""
    return [n if n in always else pytest.param(n, marks=pytest.mark.slow) for n in names]


def poses(count: int = COUNT) -> FloatArray:
    at = np.arange(count)
    return np.column_stack([0.06 * at, 0.3 * np.sin(0.1 * at), 0.1 * np.sin(0.05 * at)])


def ranges(pose: FloatArray) -> Float32Array:
    """In a room of 12 x 6 m, in centimetres, with noise."""
    angles = pose[2] + np.radians(np.arange(BEAMS) - 90.0)
    cos, sin = np.cos(angles) + 1e-12, np.sin(angles) + 1e-12
    x_m, y_m = (
        (np.copysign(6.0, cos) + 2.0 - pose[0]) / cos,
        (np.copysign(3.0, sin) - pose[1]) / sin,
    )
    noise = np.random.default_rng(round(1e6 * pose[0])).normal(0.0, 0.01, BEAMS)
    return np.asarray(np.round(np.minimum(x_m, y_m) + noise, 2), dtype=np.float32)


ROOM = [ranges(pose) for pose in poses()]


def flaser(stamps: list[str], rows: list[Float32Array], odometry: FloatArray,
           logged: list[str] | None = None) -> list[str]:  # fmt: skip
    """Lines with a laser 0.22 m before the base, which these ranges do not show."""
    lines = []
    for i, (stamp, row, (x, y, yaw)) in enumerate(zip(stamps, rows, odometry, strict=True)):
        laser = f"{x + 0.22 * math.cos(yaw):.6f} {y + 0.22 * math.sin(yaw):.6f} {yaw:.6f}"
        base = f"{x:.6f} {y:.6f} {yaw:.6f}"
        readings = " ".join(f"{value:.2f}" for value in row)
        at = stamp if logged is None else logged[i]
        lines.append(f"FLASER {row.size} {readings} {laser} {base} {stamp} host {at}")
    return lines


def regular(count: int = COUNT, dt_s: float = 0.2) -> list[str]:
    return [f"{10.0 + dt_s * i:.3f}" for i in range(count)]


def nothing(value: float) -> list[Float32Array]:
    return [np.full(BEAMS, value, dtype=np.float32)] * COUNT


def jumping() -> FloatArray:
    moved = poses()
    moved[::20, :2] += [5000.0, -5000.0]
    return moved


def with_spread() -> list[Float32Array]:
    rows = [row.copy() for row in ROOM]
    for i, row in enumerate(rows):
        row[60:75] = np.round(np.random.default_rng(i).uniform(51.05, 51.12, 15), 2)
    return rows


def mixed() -> list[Float32Array]:
    """180 and 181 beams, as fr-clinic has them: the fan begins at the same angle."""
    return [row[: 181 - i % 2] for i, row in enumerate(ROOM)]


def mapped(path: Path, *words: str) -> tuple[int, str, dict[str, Any]]:
    """(exit code, sentence, report on disk) of ``slamsim map``."""
    folder = path.parent / "run"
    result = CliRunner().invoke(app, ["map", str(path), "--out", str(folder), "--json", *words])
    sentence, code = "", result.exit_code

    def again() -> None:
        if result.exception is not None:
            raise result.exception

    if not isinstance(result.exception, SystemExit | None):
        sentence, code = str(result.exception), run_command(again)
    report = folder / "report.json"
    return code, sentence, json.loads(report.read_text()) if report.is_file() else {}


def carmen(tmp_path: Path, lines: list[str]) -> Path:
    path = tmp_path / "odd.log"
    path.write_text("\n".join(lines) + "\n")
    return path


EQUAL = ["0"] * COUNT
STAMPS: dict[str, tuple[list[str], list[str] | None, str]] = {
    "equal": (EQUAL, None, "in the order of the recording"),
    "equal, but logged": (EQUAL, regular(), "times at which they were received"),
    "whole seconds": ([stamp[:-4] for stamp in regular()], EQUAL, "spread evenly"),
    "tenths": ([stamp[:-2] for stamp in regular(dt_s=0.07)], EQUAL, "spread evenly"),
    "set back": ([f"{10.0 + 0.2 * i - 100 * (i > 30):.3f}" for i in range(COUNT)], EQUAL,
                 "spread evenly"),
    "some missing": ([s if i % 3 else "0" for i, s in enumerate(regular())], EQUAL,
                     "spread evenly"),
}  # fmt: skip


@pytest.mark.parametrize("name", quick(STAMPS, "equal", "set back"))
def test_all_scans_are_used_whatever_their_stamps(tmp_path: Path, name: str) -> None:
    stamps, logged, told = STAMPS[name]
    code, _, report = mapped(carmen(tmp_path, flaser(stamps, ROOM, poses(), logged)))
    assert code == 0 and report["scans_used"] == report["scans"] == COUNT
    assert sum(told in words for words in report["warnings"]) == 1
    assert report["path_length_m"] == pytest.approx(4.0, abs=0.5)


WHOLE: dict[str, Callable[[], list[str]]] = {
    "one scan": lambda: flaser(regular(1), ROOM[:1], poses(1)),
    "two scans": lambda: flaser(regular(2), ROOM[:2], poses(2)),
    "at rest": lambda: flaser(regular(), ROOM[:1] * COUNT, poses()[:1].repeat(COUNT, axis=0)),
    "odometry jumps by kilometres": lambda: flaser(regular(), ROOM, jumping()),
    "beams of two kinds": lambda: flaser(regular(), mixed(), poses()),
    "no return from 51.05 to 51.12 m": lambda: flaser(regular(), with_spread(), poses()),
}


@pytest.mark.parametrize("name", quick(WHOLE, "one scan", "odometry jumps by kilometres"))
def test_whatever_can_be_mapped_is(tmp_path: Path, name: str) -> None:
    lines = WHOLE[name]()
    code, _, report = mapped(carmen(tmp_path, lines))
    assert code == 0 and report["scans_used"] == report["scans"] == len(lines)
    for written in ("map.pgm", "trajectory.tum", "report.html"):
        assert (tmp_path / "run" / written).is_file()
    assert report["map_rows"] * report["map_resolution_m"] < 20.0
    assert report["map_columns"] * report["map_resolution_m"] < 30.0


REFUSED: dict[str, tuple[Callable[[], list[str]], int, str]] = {
    "one beam": (lambda: ["FLASER 1 2.0 0 0 0 0 0 0 1.0 host 1.0"], 3, "1 beams, where 2"),
    "two beams": (
        lambda: flaser(regular(), [row[:2] for row in ROOM], poses()),
        1,
        "none of the 60 scans shows a surface",
    ),
    "all 81.91": (lambda: flaser(regular(), nothing(81.91), poses()), 1, "shows a surface"),
    "all 50": (lambda: flaser(regular(), nothing(50.0), poses()), 1, "shows a surface"),
    "all nan": (lambda: flaser(regular(), nothing(math.nan), poses()), 1, "shows a surface"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_mapped_is_told(tmp_path: Path, name: str) -> None:
    lines, wanted, told = REFUSED[name]
    code, sentence, report = mapped(carmen(tmp_path, lines()))
    assert code == wanted and told in sentence and "\n" not in sentence and report == {}


def bag(scan_ns: list[int], received_ns: list[int], rows: list[Float32Array]) -> list[Message]:
    """Scans and odometry of a robot straight on at 0.3 m/s."""
    robot = Robot(ROS2)
    step = {"angle_min": -math.pi / 2, "angle_max": math.pi / 2, "range_max": 81.9,
            "angle_increment": math.pi / 180, "time_increment": 0.0, "range_min": 0.05,
            "frame": "base_footprint"}  # fmt: skip
    messages = [
        ("/scan", at, robot.scan(stamp, row.tolist(), **step))
        for stamp, at, row in zip(scan_ns, received_ns, rows, strict=True)
    ]
    for i in range(2 * COUNT):
        at = START_NS + i * SECOND // 10
        messages.append(("/odom", at, robot.odometry(at, 0.03 * i)))
    return sorted(messages, key=lambda message: message[1])


STRAIGHT = [ranges(np.array([0.06 * i, 0.0, 0.0])) for i in range(COUNT)]
RECEIVED = [START_NS + i * SECOND // 5 for i in range(COUNT)]
ROS: dict[str, tuple[list[int], str]] = {
    "equal": ([0] * COUNT, "times at which they were received"),
    "whole seconds": ([t // SECOND * SECOND for t in RECEIVED], "spread evenly"),
    "set back": ([t - 90 * SECOND * (i > 40) for i, t in enumerate(RECEIVED)],
                 "times at which they were received"),
}  # fmt: skip


@pytest.mark.parametrize("name", quick(ROS, "equal"))
def test_all_scans_of_a_bag_are_used(tmp_path: Path, name: str) -> None:
    stamps_ns, told = ROS[name]
    path = as_mcap(tmp_path / "odd.mcap", bag(stamps_ns, RECEIVED, STRAIGHT))
    code, _, report = mapped(path)
    assert code == 0 and report["scans_used"] == report["scans"] == COUNT
    assert sum(told in words for words in report["warnings"]) == 1


def test_each_chunk_of_a_mapped_recording_is_decoded_twice_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once for its checksum and what is in it, once for the messages; truth and check included."""
    decoded = Counter[bytes]()

    def counting(data: bytes, *about: Any) -> bytes:
        decoded[bytes(data)] += 1
        return inflate(data, *about)

    monkeypatch.setattr("slamsim.io.mcap.reader.inflate", counting)
    path = as_mcap(tmp_path / "a.mcap", bag(RECEIVED, RECEIVED, STRAIGHT), chunk_size=20_000)

    assert mapped(path)[0] == 0

    assert len(decoded) > 3
    assert set(decoded.values()) == {2}


@pytest.mark.parametrize("code_m", [81.83, pytest.param(65.535, marks=pytest.mark.slow)])
def test_a_code_within_the_declared_range_of_a_bag(tmp_path: Path, code_m: float) -> None:
    rows = [np.where(np.arange(BEAMS) // 12 == 6, np.float32(code_m), row) for row in STRAIGHT]
    code, _, report = mapped(as_mcap(tmp_path / "odd.mcap", bag(RECEIVED, RECEIVED, rows)))
    told = f"readings of {code_m:g} m come so often that they mean no return"
    assert code == 0 and any(told in words for words in report["warnings"])
    assert report["map_columns"] * report["map_resolution_m"] < 30.0


def test_a_run_that_used_less_than_half_says_why_and_is_written(tmp_path: Path) -> None:
    messages = bag(RECEIVED, RECEIVED, STRAIGHT)
    scans = [message for topic, _, message in messages if topic == "/scan"]
    for scan in scans[20:]:
        scan.angle_increment = 0.0
    code, sentence, report = mapped(as_mcap(tmp_path / "odd.mcap", messages))
    assert code == 1 and report["scans_used"] == 20 and report["scans"] == COUNT
    assert "only 20 of 60 scans were used: /scan: 40 scans that describe no lidar" in sentence
    assert (tmp_path / "run" / "report.html").is_file()
