"""Robot descriptions of others, through whole commands: refused in a sentence, before any physics,
and not a byte is changed outside of the output folder."""

from __future__ import annotations

import os
import string
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pybullet_data
import pytest
import trimesh
from fault_corpus_robots import ROBOTS, SOUND
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.config.robot import RobotConfig
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.own_files import with_own_files

pytestmark = [pytest.mark.fault, pytest.mark.usefixtures("drives_here")]

COMMANDS = ("simulate", "map")
PUBLISHED = Path(pybullet_data.getDataPath())
EVIL = b"#!/bin/sh\necho mine\n"
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'


def with_mesh(name: str) -> str:
    """The sound robot, to whose first link a mesh of this name is added."""
    return SOUND.replace("</link>", f"{MESH.format(name)}</link>", 1)


def contents(root: Path) -> dict[str, bytes | str]:
    """Every file and link below a folder; pipes and folders by their kind."""
    return {path.relative_to(root).as_posix(): _content(path) for path in root.rglob("*")}


def _content(path: Path) -> bytes | str:
    if path.is_symlink():
        return str(path.readlink())
    if path.is_file():
        return path.read_bytes() if path.stat().st_size < 1 << 30 else str(path.stat())
    return "no file"


def refused(command: str, urdf: Path, folder: Path) -> SlamsimError:
    """How a command refuses this robot; nothing of its output is left."""
    robot = f"robot.urdf_file={urdf}"
    done = CliRunner().invoke(
        app, [command, "tiny", "-q", "--out", str(folder / "out"), "--set", robot]
    )
    assert isinstance(done.exception, SlamsimError), done.exception
    assert not (folder / "out").exists()
    return done.exception


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder ``cwd/robots`` for hostile robots, a script of the user beside and above it."""
    robots = tmp_path / "cwd" / "robots"
    robots.mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "cwd"):
        (folder / "evil.sh").write_bytes(EVIL)
        (folder / "evil.stl").write_bytes(EVIL)
    monkeypatch.chdir(tmp_path / "cwd")
    monkeypatch.setattr("slamsim.simulation.simulate.plan_route", _must_not_happen)
    return tmp_path


def _must_not_happen(*arguments: object) -> None:
    raise AssertionError("this robot was to be refused before its drive is planned")


def hostile(scene: Path, command: str, fill: Callable[[Path], object]) -> str:
    robots = scene / "cwd" / "robots"
    fill(robots)
    before = contents(scene)
    error = refused(command, robots / "r.urdf", scene / "cwd")
    assert error.exit_code in (2, 3, 10)
    assert contents(scene) == before
    return str(error)


@pytest.mark.parametrize("name", [name for name, (_, words) in ROBOTS.items() if words])
def test_hostile_descriptions(name: str, scene: Path) -> None:
    data, words = ROBOTS[name]
    made = data() if callable(data) else data

    def fill(robots: Path) -> None:
        (robots / "r.urdf").write_bytes(made.encode() if isinstance(made, str) else made)

    command = COMMANDS[len(name) % 2]
    assert words in hostile(scene, command, fill)


def meshed(name: str, make: Callable[[Path], object] = lambda path: None) -> Callable[[Path], None]:
    """A robot that names a mesh, and what stands under that name."""

    def fill(robots: Path) -> None:
        (robots / "r.urdf").write_text(with_mesh(name))
        make(robots / name)

    return fill


def written(data: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(data)


def to(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(20 << 30)


COLLADA = b'<COLLADA xmlns="x">'
MESHES: dict[str, tuple[Callable[[Path], None], str]] = {
    "a script above": (meshed("../../../../evil.sh"), "plain file name"),
    "a file above": (meshed("../evil.stl"), "inside the folder"),
    "a file far above": (meshed("../" * 40 + "evil.stl"), "inside the folder"),
    "above and back": (meshed("../robots/r.stl"), "without '..'"),
    "a file of the machine": (meshed("/etc/passwd.stl"), "inside the folder"),
    "of a package": (meshed("package://robot/m.stl"), "plain file name"),
    "of the file system": (meshed("file:///m.stl"), "plain file name"),
    "of the network": (meshed("http://a.b/m.stl"), "plain file name"),
    "of no name": (meshed(""), "plain file name"),
    "not there": (meshed("m.stl"), "does not exist"),
    "of a long name": (meshed("m" * 300 + ".stl"), "cannot be opened"),
    "of a name of lines": (meshed("a&#10;b.stl"), "does not exist"),
    "of a name of 100,000 letters": (meshed("m/" * 50_000 + ".stl"), "100,004 characters"),
    "a folder": (meshed("m.stl", Path.mkdir), "is a folder"),
    "a pipe": (meshed("m.stl", os.mkfifo), "pipe or device"),
    "a link to endless zeros": (meshed("m.stl", to("/dev/zero")), "inside the folder"),
    "a link to a file above": (meshed("m.stl", to("../evil.stl")), "inside the folder"),
    "a link to itself": (meshed("m.stl", to("m.stl")), "m.stl"),
    "empty": (meshed("m.stl", written(b"")), "is empty"),
    "of 20 GB": (meshed("m.stl", sparse), "bytes long"),
    "no STL": (meshed("m.stl", written(b"hello" * 99)), "announces"),
    "STL cut off": (meshed("m.stl", written(b"solid\nfacet normal")), "cut off"),
    "no OBJ": (meshed("m.obj", written(b"\0" * 9)), "no OBJ"),
    "no COLLADA": (meshed("m.dae", written(b"hello")), "refused as XML"),
    "other XML": (meshed("m.dae", written(b"<html/>")), "begins with <html>"),
    "COLLADA cut off": (meshed("m.dae", written(COLLADA)), "refused as XML"),
    "COLLADA in depth": (meshed("m.dae", written(COLLADA + b"<a>" * 99_999)), "nested deeper"),
    "COLLADA with a document type": (
        meshed("m.dae", written(b'<!DOCTYPE a SYSTEM "file:///etc/passwd">' + COLLADA)),
        "refused as XML",
    ),
}


@pytest.mark.parametrize("name", MESHES)
def test_hostile_meshes(name: str, scene: Path) -> None:
    fill, words = MESHES[name]
    command = COMMANDS[len(name) % 2]
    assert words in hostile(scene, command, fill)


def put(text: str) -> Callable[[Path], object]:
    return lambda robots: (robots / "r.urdf").write_text(text)


def at_urdf(make: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda robots: make(robots / "r.urdf")


NAMELESS = with_mesh("").replace(' filename=""', "")
LONG = SOUND.replace('name="', f'name="{"n" * 1_000_000}', 1)
NO_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a mesh without a name": (put(NAMELESS), "plain file name"),
    "not there": (lambda robots: None, "no such file"),
    "a folder": (at_urdf(Path.mkdir), "is a folder"),
    "a pipe": (at_urdf(os.mkfifo), "pipe or device"),
    "endless zeros": (at_urdf(to("/dev/zero")), "device"),
    "a link to itself": (at_urdf(to("r.urdf")), "r.urdf"),
    "of 20 GB": (at_urdf(sparse), "bytes long"),
    "a name of a million letters": (put(LONG), "1,000,010 characters"),
    "an attribute of 100 MB": (put(LONG.replace("n", "n" * 100)), "bytes long"),
}


@pytest.mark.parametrize("name", NO_FILES)
def test_what_is_no_description(name: str, scene: Path) -> None:
    fill, words = NO_FILES[name]
    command = COMMANDS[len(name) % 2]
    assert words in hostile(scene, command, fill)


ONCE_TRACEBACKS = ("humanoid", "biped2d_pybullet", "diff_ring")


def test_published_descriptions_of_other_robots(scene: Path) -> None:
    """None of them has two driven wheels by our names: each is refused, none in a traceback."""
    found = [path for path in sorted(PUBLISHED.rglob("*.urdf")) if path.parts[-2].isalpha()]
    some = [*found[::3], *(path for path in found if path.stem in ONCE_TRACEBACKS)]
    assert len(some) > 20 and len({path.stem for path in some} & {*ONCE_TRACEBACKS}) == 3
    for number, path in enumerate(some):
        assert isinstance(refused(COMMANDS[number % 2], path, scene), InputRefused)


@pytest.mark.slow
def test_all_published_descriptions(scene: Path) -> None:
    found = sorted(PUBLISHED.rglob("*.urdf"))
    assert len(found) > 20
    for path in found:
        for command in COMMANDS:
            assert isinstance(refused(command, path, scene), InputRefused)


PARTS = st.sampled_from(
    ["..", ".", "", "meshes", "box.stl", "evil.sh", "here", "out", "~", "%2e%2e", "file:", "\\.."]
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(parts=st.lists(PARTS, min_size=1, max_size=6), last=st.sampled_from(["", ".stl"]))
@example(parts=["meshes", "box.stl"], last="")
@example(parts=["here", "..", "..", "evil"], last=".stl")
def test_a_mesh_of_any_name_is_copied_into_the_folder_or_refused(
    parts: list[str], last: str, scene: Path
) -> None:
    robots = scene / "cwd" / "robots"
    (robots / "meshes").mkdir(exist_ok=True)
    if not (robots / "meshes" / "box.stl").exists():
        trimesh.creation.box().export(robots / "meshes" / "box.stl")
        (robots / "here").symlink_to("meshes")
        (robots / "out").symlink_to(scene)
    name = "/".join(parts) + last
    (robots / "r.urdf").write_text(with_mesh(name))
    before = contents(scene)
    with TemporaryDirectory() as folder:
        staging = Path(folder) / "run"
        try:
            with_own_files(staging, RobotConfig(urdf_file=str(robots / "r.urdf")))
        except InputRefused:
            assert not staging.exists()
        else:
            box = (robots / "meshes" / "box.stl").read_bytes()
            assert (staging / "files" / name).read_bytes() == box
            assert build_robot(RobotConfig(urdf_file=str(staging / "files" / "r.urdf")))
    assert contents(scene) == before


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    at=st.integers(0, len(SOUND) - 1),
    length=st.integers(0, 40),
    new=st.text(string.printable + "\u202e\x85é", max_size=12),
)
def test_a_description_with_other_letters_somewhere(
    at: int, length: int, new: str, scene: Path
) -> None:
    urdf = scene / "cwd" / "robots" / "r.urdf"
    urdf.write_text(SOUND[:at] + new + SOUND[at + length :])
    try:
        build_robot(RobotConfig(urdf_file=str(urdf)))
    except InputRefused as reason:
        assert str(refused("simulate", urdf, scene / "cwd")) == str(reason)
