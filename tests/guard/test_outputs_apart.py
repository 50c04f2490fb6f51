"""No command writes where it reads, and none replaces what is not its own; whole commands."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from foreign_files import snapshot
from recording_data import recording
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.config.bundled import bundled_folder
from slamsim.guard.errors import NotFound, OutputRefused, SlamsimError
from slamsim.guard.output import partial_folder
from slamsim.guard.replaceable import require_apart
from slamsim.io.bag2.writer import write_recording


def typed(*words: str | Path) -> tuple[int, str]:
    """(exit code, what is told)."""
    result = CliRunner().invoke(app, [*map(str, words)])
    if isinstance(result.exception, SlamsimError):
        return result.exception.exit_code, str(result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, a recording, and files that commands take, under several names each."""
    root = tmp_path_factory.mktemp("made")
    with partial_folder(root / "outputs" / "run") as run:
        write_recording(recording(2.0), run / "log")
        for name in ("world.yaml", "config.yaml"):
            shutil.copy(bundled_folder("worlds") / "tiny.yaml", run / name)
        (run / "config.yaml").write_text("seed: 3\n")
        shutil.copy(bundled_folder("configs/faults") / "laser_yaw.yaml", run / "fault.yaml")
        (run / "report.html").write_text("<html>")
        (run / "x.relations").write_text("")
    write_recording(recording(2.0), root / "data" / "rec")
    shutil.copy(bundled_folder("configs/datasets") / "tiny.yaml", root / "data" / "recipe.yaml")
    shutil.copy(bundled_folder("configs/measurements") / "turtlebot2_study.yaml", root / "m.yaml")
    return root


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path / "here", symlinks=True)
    here = tmp_path / "here"
    (here / "link").symlink_to("outputs")
    (here / "data" / "rec.mcap").write_bytes(b"a recording")
    os.link(here / "data" / "rec.mcap", here / "hard.html")
    os.link(next((here / "data" / "rec").glob("*.mcap")), here / "within.html")
    monkeypatch.chdir(here)
    return here


APART = (
    "map outputs/run --overwrite",
    "map outputs/run/log --overwrite",
    "map outputs/run --out outputs/run",
    "map outputs/run --out outputs/run --overwrite",
    "map outputs/run --out ./link/../outputs/run/ --overwrite",
    "map link/run/log --out outputs/run --overwrite",
    "map outputs/run --out link/run --overwrite",
    "map outputs/run --out outputs --overwrite",
    "map outputs/run --out outputs/run/new/deep",
    "map data/rec --out .",
    "map data/rec --relations outputs/run/x.relations --out outputs/run --overwrite",
    "map data/rec --continue outputs/run --out outputs/run --overwrite",
    "map data/rec --config outputs/run/config.yaml --out outputs/run --overwrite",
    "map outputs/run/world.yaml --out outputs/run --overwrite",
    "world outputs/run/world.yaml --out outputs/run --overwrite",
    "simulate outputs/run/world.yaml --out outputs/run --overwrite",
    "localise outputs/run --in outputs/run --out outputs/run --overwrite",
    "localise data/rec --in outputs/run --out outputs/run/here",
    "fix data/rec data/rec",
    "fix data/rec data/rec/ --overwrite",
    "fix data/rec data",
    "fix data/rec data/rec/fixed",
    "fault data/rec data/rec --fault laser_yaw:2",
    "fault data/rec data/rec/x --overwrite --fault laser_yaw:2",
    "recover data/rec --out data/rec",
    "recover data/rec --out data/rec/new",
    "recover outputs/run --out outputs/run/new",
    "simulate tiny --config outputs/run/config.yaml --out outputs/run --overwrite",
    "simulate tiny --fault outputs/run/fault.yaml --out outputs/run --overwrite",
    "check data/rec.mcap --html data/rec.mcap --overwrite",
    "check data/rec.mcap --html hard.html --overwrite",
    "check data/rec --html within.html --overwrite",
    "check data/rec --html data/rec/metadata.yaml --overwrite",
    "check data/rec --html data/rec/page.html",
    "view outputs/run --screenshot outputs/run/report.html --overwrite",
    "identify m.yaml --robot-file m.yaml --overwrite",
    "identify m.yaml --out new --robot-file new/robot.yaml",
    "dataset preview data/recipe.yaml --out data/recipe.yaml --overwrite",
    "dataset make data/recipe.yaml -n 1 --out data",
    "scenario ramp --config outputs/run/config.yaml --out outputs/run --overwrite",
)


@pytest.mark.parametrize("words", APART)
def test_an_output_that_meets_an_input_is_refused_and_nothing_is_touched(
    words: str, here: Path
) -> None:
    before, changed_ns = snapshot(here), here.stat().st_mtime_ns
    code, told = typed(*words.split())
    assert (code, "\n" in told) == (2, False), told
    assert "the output " in told and "choose another name" in told
    assert (snapshot(here), here.stat().st_mtime_ns) == (before, changed_ns)


def test_a_run_that_is_read_is_told_where_to_write_instead(here: Path) -> None:
    (here / "outputs" / "run_2").mkdir()
    code, told = typed("map", "outputs/run", "--overwrite")
    assert code == 2 and told.endswith("such as --out outputs/run_3")
    (here / "outputs" / "log").symlink_to("run/log")
    code, told = typed("map", "outputs", "--overwrite")
    assert code == 2 and told.endswith("choose another name for it")


SEALED = ("report.html", "log/metadata.yaml", "SHA256SUMS", ".slamsim")


@pytest.mark.parametrize("name", SEALED)
@pytest.mark.parametrize("command", ["check data/rec --html", "dataset preview tiny --out"])
def test_no_file_replaces_what_is_sealed(command: str, name: str, here: Path) -> None:
    before = snapshot(here)
    code, told = typed(*command.split(), f"outputs/run/{name}", "--overwrite")
    assert code == (2 if command.startswith("check") else 1)
    assert "belongs to what slamsim sealed" in told
    assert snapshot(here) == before


def test_a_file_is_replaced_only_when_that_is_said(here: Path) -> None:
    page = here / "page.html"
    page.write_text("mine")
    code, told = typed("check", "data/rec", "--quick", "--html", page)
    assert code == 2 and "is there already" in told
    assert page.read_text() == "mine"
    typed("check", "data/rec", "--quick", "--html", page, "--overwrite")
    assert "<html" in page.read_text()
    for name in ("outputs", "link", "/dev/null"):
        code, told = typed("check", "data/rec", "--quick", "--html", name, "--overwrite")
        assert code == 2 and "is not a file" in told


def test_neighbours_of_an_output_are_nothing_to_it(here: Path) -> None:
    """``poetry.lock`` beside ``--out poetry``, and ``mv lab lab.old`` before ``--out lab``."""
    assert typed("world", "tiny", "--out", "lab", "-q")[0] == 0
    shutil.copytree(here / "lab", here / "lab.old")
    shutil.copytree(here / "lab", here / "lab.partial")
    (here / "lab.lock").write_text("mine")
    (here / ".lab.partial").write_text("mine")
    before = snapshot(here, without=("lab",))
    assert typed("world", "tiny", "--out", "lab", "-q", "--overwrite")[0] == 0
    assert typed("world", "tiny", "--out", "lab", "-q")[0] == 1
    assert snapshot(here, without=("lab",)) == before


def test_notes_in_the_folder_of_a_run_are_not_overwritten(here: Path) -> None:
    for number in range(5):
        (here / "outputs" / "run" / f"notes{number}.txt").write_text("mine")
    before = snapshot(here)
    code, told = typed("world", "tiny", "--out", "outputs/run", "--overwrite")
    assert code == 1 and "'notes0.txt', 'notes1.txt', 'notes2.txt' and 2 more in it" in told
    assert snapshot(here) == before


def test_folders_of_a_user_are_no_data_set(here: Path) -> None:
    for name in ("set/.partial/mine", "set/logs/00000.log"):
        (here / name).parent.mkdir(parents=True)
        (here / name).write_text("mine")
    before = snapshot(here)
    code, told = typed("dataset", "make", "tiny", "-n", "1", "--out", "set")
    assert code == 1 and "holds files that are no data set" in told
    assert snapshot(here) == before


def test_a_data_set_may_be_made_again_by_the_recipe_that_it_holds(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamsim.run.dataset.making.run_make", lambda *_, **__: None)
    (here / "data" / "dataset.yaml").write_text("")
    assert typed("dataset", "make", "data/recipe.yaml", "--out", "data")[0] == 0
    (here / "data" / "recipe.yaml").rename(here / "data" / "mine.yaml")
    assert typed("dataset", "make", "data/mine.yaml", "--out", "data")[0] == 2


def test_what_is_apart_passes(here: Path) -> None:
    rec, file = here / "data" / "rec", here / "data" / "rec.mcap"
    for out in ("data/rec_2", "data/re", "rec", "outputs/run_2", "data/rec.mcap.html", "new/deep"):
        require_apart([Path(out)], [rec, file, None])
    require_apart([here / "data" / "new", None], [file])
    require_apart([Path("page.html"), Path("run")], [rec])
    with pytest.raises(NotFound, match="no such file"):
        require_apart([Path("new")], [Path("absent")])


def test_a_url_is_no_folder(here: Path) -> None:
    before = snapshot(here)
    for url in ("s3://bucket/run", "memory://run", "file:///tmp/run"):
        code, told = typed("world", "tiny", "--out", url)
        assert code == 2 and "is a URL" in told
    assert snapshot(here) == before


def test_another_spelling_on_a_system_that_ignores_case(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As such a system answers: one file, whatever the case of its name."""
    stat = Path.stat
    monkeypatch.setattr(
        Path,
        "stat",
        lambda self, **how: stat(
            Path(str(self).replace("DATA", "data").replace("Rec", "rec")), **how
        ),
    )
    for out in ("DATA/Rec", "data/Rec/new", "DATA"):
        with pytest.raises(OutputRefused):
            require_apart([Path(out)], [here / "data" / "rec"])
