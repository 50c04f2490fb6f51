"""What README and documentation show works as it stands: programs, commands, settings, links."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
import yaml
from short_drives import cut_drives_short

from slamsim.check.registry import registry
from slamsim.cli.main import app
from slamsim.config.loading import load_run_config

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
LANGUAGES = {"bash", "python", "yaml", "text", ""}
"""Of code blocks: ``text`` is output, no language a drawing. Those of CONTRIBUTING.md that are
programs are run by ``test_edits.py`` and ``test_check_questions.py``."""
ELSEWHERE = ("dask_jobqueue", "dask_kubernetes", 'open("rooms")')
"""Blocks that import these need a cluster; rooms are a data set with images, which takes minutes to
make: ``test_dataset_images.py`` does the same with a small one."""

OTHER_PROGRAMS = {
    "$(command -v sudo) apt-get ": "../.ci/run",
    "sudo apt-get install ": "../.ci/run",
    "python3.11 -m venv ": "../.ci/run",
    "python3.12 -m venv ": "../.ci/run",
    ".venv/bin/pip install ": "../.ci/run",
    "python -m slamsim.ros": "ros/test_ros_node.py",
    "python examples/": "project/test_examples.py",
    "ros2 launch ": "ros/test_ros_node.py",
    "ros2 bag record ": None,
    "source ": None,
    "docker ": None,
}
"""How commands of others than slamsim begin, and what runs the like of them; None: it takes ROS 2,
or the right to make containers."""

sys.path.insert(0, str(ROOT / "docs" / "hooks"))


def blocks(language: str, pages: list[Path] = PAGES) -> Iterator[tuple[str, str]]:
    """(where, text) of each code block of a language."""
    for page in pages:
        found = re.finditer(r"^```(\w*)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
        for number, block in enumerate(found):
            if block[1] == language:
                yield f"{page.name}-{number}", block[2]


def programs() -> list[tuple[str, str]]:
    return [one for one in blocks("python") if not one[0].startswith("CONTRIBUTING")]


def commands() -> list[str]:
    """The calls of slamsim in the blocks of all pages."""
    lines = (line for _, text in blocks("bash") for line in text.splitlines())
    calls = (line.rsplit("&&", maxsplit=1)[-1].strip() for line in lines)
    return [call for call in calls if re.match(r"(\S*/)?slamsim ", call)]


def lines_of_others() -> list[str]:
    """What README and site show to be typed beside calls of slamsim."""
    pages = [page for page in PAGES if page.name != "CONTRIBUTING.md"]
    lines = (line for _, text in blocks("bash", pages) for line in text.splitlines())
    return [
        line
        for line in lines
        if line and not line.startswith(("#", "slamsim ", ".venv/bin/slamsim "))
    ]


def test_what_is_typed_beside_slamsim_is_known_to_run() -> None:
    lines, first = lines_of_others(), tuple(OTHER_PROGRAMS)
    assert [line for line in lines if not line.startswith(first)] == []
    assert [one for one in first if not any(line.startswith(one) for line in lines)] == []
    assert all((ROOT / "tests" / test).is_file() for test in OTHER_PROGRAMS.values() if test)
    for where, text in blocks("bash"):
        done = subprocess.run(
            ["bash", "-n"], input=text, text=True, capture_output=True, check=False
        )
        assert done.returncode == 0, f"{where}: {done.stderr}"


def test_every_block_is_of_a_kind_that_is_tried() -> None:
    kinds = {kind for page in PAGES for kind in re.findall(r"^```(\w+)$", page.read_text(), re.M)}
    assert kinds <= LANGUAGES
    assert len(commands()) > 40 and len(programs()) >= 6


@pytest.mark.long
@pytest.mark.usefixtures("drives_here", "undrawn_figures")
@pytest.mark.parametrize(
    "example",
    [
        pytest.param(text, id=where)
        for where, text in programs()
        if not any(name in text for name in ELSEWHERE)
    ],
)
def test_a_program_runs(
    example: str,
    small_set: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    cut_drives_short(monkeypatch)
    (tmp_path / "my_data").symlink_to(small_set)
    exec(compile(example, "the program", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out


@pytest.mark.parametrize("example", [pytest.param(text, id=where) for where, text in programs()])
def test_a_program_is_formatted_and_imports_what_there_is(example: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "ruff", "format", "--line-length", "100", "--check", "-"],
        input=example,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    for node in ast.walk(ast.parse(example)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("slamsim"):
            module = importlib.import_module(str(node.module))
            assert all(hasattr(module, alias.name) for alias in node.names)


@pytest.mark.parametrize("call", commands())
def test_a_command_is_one(call: str) -> None:
    """The parser takes it: the subcommand, its arguments and options, and their values."""
    _, *words = shlex.split(call.partition(" > ")[0], comments=True)
    command = typer.main.get_command(app)
    while words and words[0] in (below := getattr(command, "commands", {})):
        command = below[words.pop(0)]
    assert not getattr(command, "commands", {}), f"no such command: {call}"
    if words != ["--install-completion"]:
        command.make_context(call, words)


def test_settings_shown_are_yaml_and_those_of_slamsim_are_settings(tmp_path: Path) -> None:
    settings = [yaml.safe_load(text) for _, text in blocks("yaml")]
    assert settings and all(settings)
    ours = [one for one in settings if "sensors" in one]
    assert ours
    for one in ours:
        (tmp_path / "shown.yaml").write_text(yaml.safe_dump(one))
        load_run_config("tiny", str(tmp_path / "shown.yaml"))


def anchors(page: Path) -> set[str]:
    """Those of its headings, as GitHub and MkDocs make them, and of the generated questions."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    made = {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}
    return made | set(registry().questions) if page.name == "questions.md" else made


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith("https://"):
            continue
        name, _, anchor = target.partition("#")
        found = page.parent / name if name else page
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), target


def test_every_question_has_its_place_on_the_page_of_questions() -> None:
    from questions import PLACE, on_page_markdown

    page = on_page_markdown((ROOT / "docs" / "questions.md").read_text())
    assert PLACE not in page
    for question in registry().questions.values():
        assert page.count(f"{{#{question.id}}}") == 1
        assert question.consequence in page
        assert all(f"`{fault.name}`: {fault.meaning}" in page for fault in question.faults)
