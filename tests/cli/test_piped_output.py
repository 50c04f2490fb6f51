"""What each command prints where nothing is a terminal: results on stdout, plain, for people."""

from __future__ import annotations

import functools
import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
import yaml
from board_images import TYPED, board_views, write_views
from rgbd_room import write_images
from table_numbers import numbers_without_source
from typer.testing import CliRunner

from slamsim.cameras.lens import pinhole
from slamsim.check.registry import registry
from slamsim.cli.main import app
from slamsim.config.bundled import bundled_names
from slamsim.config.drive import RouteConfig
from slamsim.console.reporter import Reporter
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.sensors.faults.registry import bundled_faults

FEW_BEAMS = ("--set", "sensors.lidar=lds_01")
SHORT = ("--set", "drive.route.max_path_length_m=2", *FEW_BEAMS)
FEW_TRIALS = (
    *("--set", "steps={first_s: 0.01, last_s: 0.02, by_s: 0.01}"),
    *("--set", "other_solvers={}"),
)
LIVE = (
    *("tiny", "--drive", "tour", "--rate", "max", "--duration", "2", "--no-slam", "--record"),
    *("--page-port", "0", "--rosbridge-port", "0", "--foxglove-port", "0"),
)
COMMANDS: Mapping[str, tuple[str, ...] | None] = {
    "world": ("tiny", "--out", "OUT"),
    "simulate": ("tiny", "--out", "OUT", *SHORT),
    "map": ("RUN", "--out", "OUT"),
    "localise": ("RUN", "--in", "RUN", "--out", "OUT"),
    "evaluate": ("RUN",),
    "live": (*LIVE, "--out", "OUT"),
    "replay": ("LIVE/drive_1", "--out", "OUT"),
    "info": ("RUN",),
    "check": ("RUN", "--quick"),
    "fix": ("RUN", "OUT", "--apply", "none"),
    "recover": ("RUN/log", "--out", "OUT"),
    "odometry": ("IMAGES", "--out", "OUT", "--intrinsics", "116,116,79.5,59.5"),
    "calibrate": ("BOARDS", "--board", TYPED, "--out", "OUT"),
    "convert": ("IMAGES", "OUT"),
    "demo": ("--out", "OUT"),
    "scenario": ("integrator", "--out", "OUT", "--jobs", "1", *FEW_TRIALS),
    "identify": ("turtlebot2_study", "--out", "OUT", "--jobs", "1"),
    "verify": ("RUN",),
    "dataset make": ("RECIPE", "-n", "1", "--out", "OUT", "--workers", "1"),
    "dataset plan": ("RECIPE", "-n", "1", "--workers", "1"),
    "dataset preview": ("tiny", "-n", "1", "--out", "OUT.png"),
    "dataset verify": ("SET",),
    "dataset stats": ("SET",),
    "view": None,
    "bench": ("sense", "--seconds", "5", "--repeats", "1", "--world", "tiny", *FEW_BEAMS),
    "fault": ("RUN", "OUT", "--fault", "laser_yaw:2"),
    "config": ("tiny",),
}
"""How each is called; OUT is a new folder, PLACES has the others. None: it prints nothing but
errors."""

PLACES = {
    "RUN": "mapped",
    "LIVE": "lived",
    "IMAGES": "images",
    "BOARDS": "boards",
    "RECIPE": "recipe",
    "SET": "small_set",
}
"""The fixture behind each name, which is made where a command is called with it."""

LONG = {"demo", "identify"}
WITHOUT_JSON = {"config"}
"""Its result is YAML, with keys."""
WITHOUT_RESULT = {"demo", "recover"}
"""``--json`` prints nothing."""


NAMES_FRAMES = {"info"}
"""It lists the names of the recording's own frames."""


def commands(group: Any, above: str = "") -> Iterator[str]:
    """All of them, those of groups with the name of the group before theirs."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{above}{name} ")
        else:
            yield f"{above}{name}"


pytestmark = pytest.mark.usefixtures(
    "drives_here", "made_by_one_worker", "tried_by_one_worker", "undrawn_figures"
)


def test_no_command_is_forgotten() -> None:
    assert set(commands(typer.main.get_command(app))) == set(COMMANDS)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("piped") / "run"
    done = CliRunner().invoke(app, ["map", "tiny", "-q", "--out", str(folder), *SHORT])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a live run."""
    folder = tmp_path_factory.mktemp("piped") / "live"
    done = CliRunner().invoke(app, ["live", "-q", "--out", str(folder), *LIVE])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of colour and depth images."""
    folder = tmp_path_factory.mktemp("piped") / "images"
    write_images(folder, pinhole(160, 120, 69.0), 3)
    return folder


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of images of a chessboard."""
    folder = tmp_path_factory.mktemp("piped") / "boards"
    write_views(folder, board_views(14))
    return folder


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a data set of drives that are shorter than those of the recipe ``tiny``."""
    told = load_recipe("tiny").model_dump(mode="json")
    path = tmp_path_factory.mktemp("piped") / "tiny.yaml"
    path.write_text(yaml.safe_dump({**told, "duration_s": 4.0}))
    return path


def arguments(
    name: str, request: pytest.FixtureRequest, out: Path
) -> tuple[list[str], tuple[Path, ...]]:
    """The words of a command, and the places that they name."""
    told = COMMANDS[name]
    assert told is not None
    places = {"OUT": out} | {
        place: request.getfixturevalue(fixture)
        for place, fixture in PLACES.items()
        if any(re.match(rf"{place}(?=$|[./])", word) for word in told)
    }
    names = re.compile(rf"^({'|'.join(places)})(?=$|[./])")
    typed = (names.sub(lambda m: str(places[m[1]]), word) for word in told)
    return [*name.split(), *typed], tuple(places.values())


@functools.cache
def names_of_things() -> set[str]:
    """What a user types is called so in tables too."""
    faults = {fault.name for fault in bundled_faults()}
    for question in registry().questions.values():
        faults |= {fault.name for fault in question.faults}
    presets = bundled_names("configs/sensors") + bundled_names("worlds")
    return {*faults, *presets, *get_args(RouteConfig.model_fields["kind"].annotation)}


KEY = re.compile(r"(?<![\w./~=-])[a-z0-9]+(?:_[a-z0-9]+)+(?![\w/.=]|-[a-z])")
REPR = re.compile(r"\['|\{'|\bNone\b|\bTrue\b|\bFalse\b|Path\(|np\.|\bnan\b|<[a-z]+\.")
LONG_NUMBER = re.compile(r"(?<![\w.-])-?\d[\d,]*\.\d+(?![\w.])")
NOT_A_FIGURE = re.compile(r"(?<![\w.])-0(?:\.0*)?(?![\w.,])|\bh/h\b|(?<!\d)0\.0\d* h\b")


def digits(number: str) -> int:
    """Significant ones."""
    return len(number.lstrip("-").replace(",", "").replace(".", "").lstrip("0"))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in LONG else [])
        for name, words in COMMANDS.items()
        if words is not None
    ],
)
def test_what_is_piped_is_plain_and_for_people_and_its_numbers_are_those_of_json(
    name: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results: list[Mapping[str, object]] = []
    monkeypatch.setattr(Reporter, "result", lambda _, values: results.append(values))
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr("slamsim.dataset.recipe.plan.PILOT_S", (1.0, 2.0))
    words, named = arguments(name, request, tmp_path / "out")
    done = CliRunner().invoke(app, words)
    assert done.exit_code in (0, 1) and not isinstance(done.exception, Exception), done.output
    assert done.stdout and "\x1b" not in done.stdout + done.stderr
    assert not re.search("━| left$", done.stdout)
    if name in WITHOUT_JSON:
        return
    places = re.compile("|".join(re.escape(str(place)) for place in (*named, tmp_path)))
    for line in places.sub("/", done.stdout).splitlines():
        assert line == line.rstrip() and "│" not in line, line
        assert not REPR.search(line), line
        assert not NOT_A_FIGURE.search(line), line
        assert not [one for one in LONG_NUMBER.findall(line) if digits(one) > 4], line
        assert name in NAMES_FRAMES or set(KEY.findall(line)) <= names_of_things(), line
    if name not in WITHOUT_RESULT:
        assert results, "no result"
        assert not numbers_without_source(done.stdout, results, (*named, tmp_path))


@pytest.mark.parametrize("name", ["world", "evaluate", "check", "verify", "dataset stats"])
def test_json_alone_is_on_stdout_where_it_is_asked_for(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    words, _ = arguments(name, request, tmp_path / "out")
    done = CliRunner().invoke(app, [*words, "--json"])
    assert json.loads(done.stdout) and done.stderr == ""


MAIN = "from slamsim.entry import main; main()"


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_a_terminal_that_shows_no_colours_gets_no_escape_codes(
    environment: dict[str, str], mapped: Path
) -> None:
    """Neither in tables nor in bars."""
    leader, follower = pty.openpty()
    words = [sys.executable, "-c", MAIN, "verify", str(mapped)]
    with subprocess.Popen(
        words, stdout=follower, stderr=follower, env={"TERM": "xterm", **os.environ, **environment}
    ) as command:
        os.close(follower)
        shown = b""
        try:
            while piece := os.read(leader, 65536):
                shown += piece
        except OSError:  # the end of a terminal
            pass
        os.close(leader)
    assert command.returncode == 0
    assert "│ compared with" in shown.decode() and b"\x1b" not in shown


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        pytest.param(["check", "--quick"], marks=pytest.mark.slow),
        ["info", "--json"],
        ["verify"],
    ],
)
def test_a_reader_that_has_seen_enough_changes_nothing(words: list[str], mapped: Path) -> None:
    """The verdict stays the exit code."""
    command = [sys.executable, "-c", MAIN, words[0], str(mapped), *words[1:]]
    whole = CliRunner().invoke(app, command[3:])
    closed, written = os.pipe()
    os.close(closed)
    cut = subprocess.run(command, stdout=written, stderr=subprocess.PIPE, check=False)
    os.close(written)
    assert cut.returncode == whole.exit_code
    assert b"Traceback" not in cut.stderr and b"Broken" not in cut.stderr
