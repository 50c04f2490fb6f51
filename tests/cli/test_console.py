"""How a command is stopped, and what reaches a terminal."""

from __future__ import annotations

import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from limited_child import hear_interrupts
from rich.progress import Progress
from rich.text import Text
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.console.reporter import RateColumn, Reporter
from slamsim.process.exit_codes import fail

SWALLOWED = """
import os, signal, sys, time
from slamsim.process.exit_codes import run_command

class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0)

def command():
    for _ in range(2000):
        Finalised() if _ == 0 else time.sleep(0.005)
    print("went on")

sys.exit(run_command(command))
"""


SUPPRESSED = """
import os, signal, sys, time
from slamsim.process.exit_codes import run_command

def command():
    try:
        try:
            os.kill(os.getpid(), signal.{name})
            time.sleep(0.005)
        except BaseException:
            pass
        time.sleep(10.0)
        print("went on")
    finally:
        time.sleep(0.2)
        print("cleaned up")

sys.exit(run_command(command))
"""
STOPPED = "slamsim: stopped; nothing was left half-written\n"


def stopped(script: str, name: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script.replace("{name}", name)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=hear_interrupts,
    )


@pytest.mark.parametrize(
    ("name", "code"), [("SIGTERM", 143), ("SIGINT", 130), ("SIGHUP", 129), ("SIGQUIT", 131)]
)
def test_a_signal_that_python_cannot_pass_on_stops_the_command_all_the_same(
    name: str, code: int
) -> None:
    done = stopped(SWALLOWED, name)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr == STOPPED


@pytest.mark.parametrize(
    ("name", "code"), [("SIGTERM", 143), ("SIGINT", 130), ("SIGHUP", 129), ("SIGQUIT", 131)]
)
def test_a_signal_that_a_library_swallows_stops_the_command_and_lets_it_clean_up(
    name: str, code: int
) -> None:
    done = stopped(SUPPRESSED, name)
    assert done.returncode == code
    assert done.stdout == "cleaned up\n"
    assert done.stderr == STOPPED


HOSTILE = "\x1b]0;mine\x07\x1b[31m \x9b2J \x08\x08 \u202e [bold]x[/nope] :warning: \r"
STYLES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")
"""What rich writes itself: colours, and the cursor of its bars."""


def everything_said(reporter: Reporter, words: str) -> None:
    reporter.say(words)
    reporter.warn(words)
    reporter.table(words, {words: words})
    reporter.rows(Text(words), [(((words, "bold"), (words, "")), ((words, ""),))])
    logging.getLogger("slamsim.test").warning("%s", words)
    with reporter.stage(words, words) as progress:
        progress(1.0, 2.0)
    fail(words, 1)


def obeyed(said: str) -> list[str]:
    """The characters that a terminal would not show but obey."""
    return [c for c in said if not c.isprintable() and c != "\n"]


def first_reporter() -> Reporter:
    """Of a process: pytest has handlers of its own, beside which none is configured."""
    logging.getLogger().handlers.clear()
    return Reporter()


@pytest.fixture
def unconfigured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])


@pytest.mark.long
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(words=st.text(max_size=80))
@example(words=HOSTILE)
@pytest.mark.usefixtures("unconfigured")
def test_no_name_of_a_file_reaches_a_terminal_as_a_command(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    everything_said(first_reporter(), words)
    said = capsys.readouterr()
    assert obeyed(said.err) == [] and obeyed(said.out) == []


@pytest.mark.usefixtures("unconfigured")
def test_nor_where_the_terminal_is_one_with_colours(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    everything_said(first_reporter(), HOSTILE)
    said = capsys.readouterr().err
    assert "\x1b[" in said and "\\x1b]0;mine" in said and "[bold]x[/nope] :warning:" in said
    assert obeyed(STYLES.sub("", said).replace("\r", "")) == []
    assert "\x1b[31m" not in said


@pytest.mark.usefixtures("unconfigured")
def test_a_world_of_a_hostile_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text('{name: "\\e]0;mine\\a[/nope]", maze: {rows: 2, columns: 2}}\n')
    for words in (["world", "w.yaml"], ["config", "w.yaml"], ["world", "w.yaml", "--json"]):
        done = CliRunner().invoke(app, words, catch_exceptions=False)
        assert done.exit_code == 0
        assert obeyed(done.output) == [] and "mine" in done.output


@pytest.mark.usefixtures("unconfigured")
def test_the_programs_own_logging_is_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """What others log, and a set-up of its own, beside which slamsim's messages are not shown."""
    root = logging.getLogger()
    level = root.level
    first_reporter()
    Reporter(quiet=True)
    assert root.handlers == [] and root.level == level
    logging.getLogger("slamsim.test").warning("not to be seen")
    Reporter()
    logging.getLogger("slamsim.test").warning("seen once")
    root.addHandler(logging.NullHandler())
    Reporter()
    logging.getLogger("slamsim.test").warning("theirs to show")
    said = capsys.readouterr().err
    assert said.count("seen once") == 1 and "theirs" not in said and "not to be" not in said


@pytest.mark.usefixtures("unconfigured")
def test_the_same_warning_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    first_reporter()
    for words in ("one", "two", "one"):
        logging.getLogger("slamsim.test").warning("the key %s", words)
    assert capsys.readouterr().err.count("the key one") == 1


def test_the_rate_of_a_finished_stage_is_that_of_all_of_it() -> None:
    now_s = [0.0]
    bars = Progress(get_time=lambda: now_s[0], auto_refresh=False)
    number = bars.add_task("slam", total=4000.0, unit="scans/s")
    for now_s[0], done in ((1.0, 10.0), (600.0, 3000.0), (601.0, 4000.0)):
        bars.update(number, completed=done)
    assert RateColumn().render(bars.tasks[0]).plain == "6.66 scans/s"
    bars.update(number, counted=1200.0)  # it ended before all was done
    assert RateColumn().render(bars.tasks[0]).plain == "2 scans/s"
    bars.update(number, counted=0.0)
    assert RateColumn().render(bars.tasks[0]).plain == ""
