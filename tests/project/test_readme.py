"""What the README shows works as it stands."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parents[2] / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_the_python_examples_run(number: int, small_set: Path, tmp_path: Path) -> None:
    example = blocks("python")[number]
    (tmp_path / "my_data").symlink_to(small_set)
    done = subprocess.run(
        [sys.executable, "-c", example],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "poses" in done.stdout


@pytest.mark.parametrize(
    "line", [line for block in blocks("bash") for line in block.splitlines() if "slamsim" in line]
)
def test_every_command_shown_is_one(line: str) -> None:
    """The subcommand exists and knows each option shown."""
    words = shlex.split(line.rsplit("&&", maxsplit=1)[-1], comments=True)
    if "slamsim" not in Path(words[0]).name:
        return
    command = words[1:3] if words[1] == "dataset" else words[1:2]
    done = subprocess.run(
        [sys.executable, "-c", "from slamsim.entry import main; main()", *command, "--help"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={"COLUMNS": "200", "PATH": ""},
    )
    assert all(word in done.stdout for word in words if word.startswith("--"))


@pytest.mark.parametrize("example", blocks("python"))
def test_the_python_examples_are_formatted(example: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "ruff", "format", "--line-length", "100", "--check", "-"],
        input=example,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout
