"""Every exit code of the documentation's table, by a command as a user types it; and who is
refused."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fault_processes import MAIN, Run, running
from typed import typed
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.guard.errors import OutputRefused, OverrideRefused
from slamsim.guard.output import partial_folder

pytestmark = pytest.mark.fault

EXIT_CODES = (Path(__file__).parents[2] / "docs" / "reliability.md").read_text()
GENEROUS_S = 60.0
HOLDER = """
import sys, time
from pathlib import Path
from slamsim.guard.lock import locked
with locked(Path("held").resolve(), print):
    print("begun", flush=True)
    time.sleep(1000)
"""


def of(*arguments: object, cwd: Path, limit: Callable[[], None] | None = None) -> tuple[int, str]:
    """(exit code, what it told)."""
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=GENEROUS_S,
        preexec_fn=limit,
        check=False,
    )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a folder ``there`` that slamsim wrote, and ``altered``, in which a byte was changed."""
    for name in ("there", "altered"):
        with partial_folder(tmp_path / name) as partial:
            (partial / "map.yaml").write_text("resolution: 0.05\n")
    (tmp_path / "altered" / "map.yaml").write_text("resolution: 0.06\n")
    (tmp_path / "foreign.mcap").write_text("hello")
    (tmp_path / "foreign.yaml").write_text("*hello")
    return tmp_path


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Another process writes to ``held``."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], cwd=folder, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "begun\n"
        yield
        holder.kill()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["verify", "there"], 0, ""),
        (["world", "tiny", "--out", "there"], 1, "is there already"),
        (["map", "tiny", "--no-such-option"], 2, "No such option"),
        (["map", "tiny", "--set", "sensors.lidar.rat_hz=3"], 2, "did you mean 'rate_hz'"),
        (["config", "--config", "foreign.yaml"], 3, "foreign.yaml"),
        (["verify", "altered"], 4, ""),
        (["map", "labirynth"], 10, "did you mean the bundled 'labyrinth'"),
    ],
)
def test_how_a_command_ended_is_in_its_code(
    folder: Path, arguments: list[str], code: int, words: str
) -> None:
    done = typed(*arguments, cwd=folder)
    assert done.returncode == code and words in done.stderr
    assert f"| {code} |" in EXIT_CODES


WRITING = [
    ["map", "tiny", "--out", "URL"],
    ["simulate", "tiny", "--overwrite", "-o", "URL"],
    ["world", "tiny", "--out", "URL"],
    ["localise", "x.mcap", "--in", "there", "--out", "URL"],
    ["check", "x.mcap", "--html", "URL"],
    ["fix", "x.mcap", "URL"],
    ["fault", "x.mcap", "URL", "--fault", "laser_yaw"],
    ["recover", "x.mcap", "--out", "URL"],
    ["identify", "turtlebot2_study", "--robot-file", "URL"],
    ["demo", "rotation-bug", "--out", "URL"],
    ["scenario", "all", "--out", "URL"],
    ["view", "there", "--screenshot", "URL"],
    ["bench", "accuracy", "--logs", "URL"],
    ["dataset", "preview", "tiny", "--out", "URL"],
]


@pytest.mark.parametrize("command", WRITING, ids=lambda words: words[0])
@pytest.mark.parametrize("url", ["s3://bucket/x", "file:///tmp/x", "gs+cache://x"])
def test_where_a_url_makes_no_sense_it_makes_no_folder(
    command: list[str], url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [url if word == "URL" else word for word in command]
    (tmp_path / "x.mcap").write_bytes(b"")
    error = CliRunner().invoke(app, words).exception
    assert isinstance(error, OutputRefused) and "is a URL" in str(error)
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


@pytest.mark.parametrize("url", ["memory://x", "simplecache::memory://x", "data:text/plain,x"])
def test_a_data_set_is_not_made_where_it_does_not_stay(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    error = CliRunner().invoke(app, ["dataset", "make", "tiny", "-n", "1", "--out", url]).exception
    assert isinstance(error, OverrideRefused) and "is gone when this command ends" in str(error)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ["--version"],
        ["--help"],
        ["config", "tiny"],
        ["verify", "there", "--json"],
        pytest.param(["world", "tiny", "--json"], marks=pytest.mark.slow),
        pytest.param(["fault", "--list", "--json"], marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
def test_a_full_disk_behind_standard_output_is_75(arguments: list[str], folder: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", MAIN, *arguments],
            cwd=folder,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=GENEROUS_S,
            check=False,
        )
    assert done.returncode == 75
    assert done.stderr.endswith(": the disk is full\n") and "Traceback" not in done.stderr
    assert "| 75 |" in EXIT_CODES


@pytest.mark.long
@pytest.mark.parametrize("arguments", [["--version"], ["config", "tiny"]])
def test_who_reads_no_more_and_who_never_did_hear_nothing(
    arguments: list[str], tmp_path: Path
) -> None:
    """``| head``, and ``>&-``."""
    closed, written = os.pipe()
    os.close(closed)
    command = [sys.executable, "-c", MAIN, *arguments]
    done = subprocess.run(
        command, cwd=tmp_path, stdout=written, stderr=subprocess.PIPE, check=False
    )
    os.close(written)
    assert (done.returncode, done.stderr) == (0, b"")

    def close() -> None:
        os.close(1)

    done = subprocess.run(
        command, cwd=tmp_path, stderr=subprocess.PIPE, check=False, preexec_fn=close
    )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.long
@pytest.mark.parametrize("hard_s", [1, 1000])
def test_the_limit_of_processor_time_is_told(hard_s: int, tmp_path: Path) -> None:
    """By SIGXCPU at the soft limit; where the hard one is the same, by SIGKILL."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (1, hard_s))

    code, told = of("map", "labyrinth", "--out", "run", "-q", cwd=tmp_path, limit=limit)
    assert code == 1 and "at the limit of processor time (1 s, ulimit -t)" in told


@pytest.mark.parametrize(
    ("number", "code", "at_s"),
    [
        (signal.SIGINT, 130, 0.0),
        (signal.SIGTERM, 143, 0.1),
        (signal.SIGQUIT, 131, 0.5),
        (signal.SIGHUP, 129, 2.0),
        *(
            pytest.param(number, code, at_s, marks=pytest.mark.slow)
            for number, code, moments_s in (
                (signal.SIGINT, 130, (0.1, 0.5, 4.0)),
                (signal.SIGTERM, 143, (0.0, 0.5, 2.0)),
                (signal.SIGHUP, 129, (0.1,)),
            )
            for at_s in moments_s
        ),
    ],
)
def test_a_command_that_is_stopped_at_once_tells_so(
    number: signal.Signals, code: int, at_s: float, tmp_path: Path
) -> None:
    with running("map", "labyrinth", "--out", "run", "-q", cwd=tmp_path) as run:
        run.await_child()
        time.sleep(at_s)
        run.process.send_signal(number)
        ended, told, _ = run.ended(GENEROUS_S)
        assert run.orphans() == []
    assert list(tmp_path.iterdir()) == []
    assert (ended, told) == (code, "slamsim: stopped; nothing was left half-written\n")
    assert "| 129, 130, 131, 143 |" in EXIT_CODES


WITHIN_HELD = (
    ("map", "tiny", "--out", "held"),
    ("simulate", "tiny", "--overwrite", "--out", "held"),
    ("dataset", "make", "tiny", "--out", "held"),
    ("fix", "foreign.mcap", "held"),
    ("fault", "foreign.mcap", "held", "--fault", "laser_yaw:2"),
)


def test_a_second_process_on_a_folder_is_told_before_it_loads_anything(folder: Path) -> None:
    counting = (
        "import json, sys; from slamsim.process.exit_codes import run_command\n"
        "from slamsim.cli.main import app\n"
        "for words in json.loads(sys.argv[1]):\n"
        "    code = run_command(lambda: app(words))\n"
        "    print(code, [name for name in ('numba', 'scipy', 'open3d', 'gtsam')"
        " if name in sys.modules])"
    )
    with held(folder), running(json.dumps(WITHIN_HELD), cwd=folder, code=counting) as run:
        told, says = run.process.communicate(timeout=GENEROUS_S)
    assert told.splitlines() == ["11 []"] * len(WITHIN_HELD)
    assert says.count("held is being written by process") == len(WITHIN_HELD)
    assert "| 11 |" in EXIT_CODES
    assert not (folder / "held").exists()


@pytest.mark.long
def test_runs_that_begin_at_once_take_names_of_their_own(tmp_path: Path) -> None:
    arguments = ("world", "tiny", "--json")
    runs = [Run(*arguments, cwd=tmp_path) for _ in range(2)]
    told = [run.process.communicate(timeout=4 * GENEROUS_S)[0] for run in runs]
    names = {"outputs/tiny_world", "outputs/tiny_world_2"}
    assert {json.loads(one)["folder"] for one in told} == names
    assert {f"outputs/{path.name}" for path in (tmp_path / "outputs").iterdir()} == names
