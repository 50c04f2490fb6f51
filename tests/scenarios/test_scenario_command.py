"""``slamsim scenario`` from the command line to the folder it leaves."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path

import pytest
from fault_processes import running
from scenario_stub import HOSTILE, SCENARIO, StubConfig
from typed import typed
from waiting import wait_for

from slamsim.config.dump import dump_commented_yaml
from slamsim.config.scenarios.loading import load_scenarios, parts_of
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused
from slamsim.run.scenario import rows_as_csv, run_and_report, write_results
from slamsim.scenarios.registry import ENTRIES, Entry, find_entries
from slamsim.scenarios.run import Chosen, run_scenarios

FEW = ["--set", "steps={first_s: 0.01, last_s: 0.02, by_s: 0.01}", "--set", "other_solvers={}"]
ALL_TYPES = {entry.key: entry.config_type() for entry in ENTRIES}


def types_of(name: str) -> dict[str, type]:
    return {entry.key: entry.config_type() for entry in find_entries(name)}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_the_file_of_a_scenario_says_its_defaults(entry: Entry) -> None:
    types = {entry.key: entry.config_type()}

    assert parts_of(types, load_scenarios(types)) == {entry.key: entry.config_type()()}


def test_all_take_keys_under_their_names_and_the_saved_file_gives_the_same(tmp_path: Path) -> None:
    overrides = ["integrator.duration_s=2", "slam.robot=sturdy", "umbmark.robot.name=mine"]
    whole = load_scenarios(ALL_TYPES, None, overrides, seed=5)
    saved = tmp_path / "config.yaml"
    saved.write_text(dump_commented_yaml(whole))

    again = load_scenarios(ALL_TYPES, str(saved))
    parts = parts_of(ALL_TYPES, again)

    assert again.model_dump() == whole.model_dump()
    assert again.seed == 5
    assert parts["integrator"].model_dump()["duration_s"] == 2.0
    assert parts["slam"].model_dump()["robot"]["name"] == "sturdy"
    assert parts["umbmark"].model_dump()["robot"]["name"] == "mine"


def test_a_file_changes_what_it_names_and_a_robot_in_it_is_that_robot(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("seed: 3\nrobot: {motor: {kind: ideal}}\ndelay_s: 0.2\n")

    dumped = load_scenarios(types_of("slam"), str(mine)).model_dump()

    assert dumped["seed"] == 3
    assert (dumped["delay_s"], dumped["drive"]["route"]["max_duration_s"]) == (0.2, 60.0)
    assert (dumped["robot"]["motor"]["kind"], dumped["robot"]["name"]) == ("ideal", "turtlebot2")


@pytest.mark.parametrize(
    ("name", "override", "told"),
    [
        ("integrator", "duration=2", "did you mean 'duration_s'?"),
        ("integrator", "steps.first_s=0", "not 0"),
        ("integrator", "steps.last_s=1", "not 1"),
        ("stacking", "steps.first_s=0", "not 0"),
        ("ramp", "slopes_deg=[5, 90]", "not 90"),
        ("mu-split", "right_frictions=[-0.1]", "not -0.1"),
        ("umbmark", "robot=nobody", "nobody"),
        ("all", "integrator.duration=2", "did you mean 'duration_s'?"),
    ],
)
def test_a_wrong_parameter_is_refused_with_what_would_be_right(
    name: str, override: str, told: str
) -> None:
    with pytest.raises((OverrideRefused, NotFound)) as refused:
        load_scenarios(types_of(name), None, [override])

    assert told in str(refused.value)


def test_a_wrong_key_in_a_file_is_told_with_its_line(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("# mine\nstacking:\n  max_box: 3\n")

    with pytest.raises(InputRefused, match=r"line 3.*unknown key 'max_box'.*did you mean"):
        load_scenarios(ALL_TYPES, str(mine))


@pytest.mark.parametrize(("wrong", "meant"), [("stakcing", "stacking"), ("mu_spilt", "mu-split")])
def test_an_unknown_name_gets_the_nearest(wrong: str, meant: str) -> None:
    with pytest.raises(NotFound, match=f"did you mean '{meant}'"):
        find_entries(wrong)
    assert find_entries("mu_split") == find_entries("mu-split")


@pytest.mark.usefixtures("tried_by_one_worker")
def test_the_command_leaves_a_whole_folder_and_tells_its_numbers(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["integrator", "--out", str(out), "--json", "--seed", "4", "--jobs", "1", *FEW]
    done = typed("scenario", *words, cwd=tmp_path)

    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    report = json.loads((out / "report.json").read_text())
    found = report["scenarios"]["integrator"]
    rows, tables, charts = (found.pop(name) for name in ("rows", "sheets", "charts"))
    assert report == {key: value for key, value in told.items() if key != "folder"}
    assert report["seed"] == 4
    assert tables[0]["rows"]
    assert charts[0]["series"][0]["who"] == "slamsim"
    assert report["trials_failed"] == 0
    with (out / "integrator.csv").open() as file:
        assert [row["trial"] for row in csv.DictReader(file)] == [row["trial"] for row in rows]
    names = {path.name for path in out.iterdir()}
    assert {"report.html", "config.yaml", "integrator.rrd", "integrator_1.png"} <= names
    assert "seed: 4" in (out / "config.yaml").read_text()
    assert (out / "integrator.rrd").read_bytes().startswith(b"RRF")


@pytest.mark.long
def test_ctrl_c_ends_it_with_all_its_workers_and_leaves_nothing(tmp_path: Path) -> None:
    with running("scenario", "stacking", "--out", "out", "--quiet", cwd=tmp_path) as run:
        wait_for(lambda: list(tmp_path.glob(".out.slamsim-*/new")))
        wait_for(lambda: len(run.kin()) > 2)  # besides the command and who watches over it
        os.killpg(run.process.pid, signal.SIGINT)
        code, told, _ = run.ended()
        assert run.orphans() == []

    assert code == 130
    assert "stopped" in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("tried_by_one_worker")
def test_the_page_escapes_all_it_is_given_and_needs_nothing_else(tmp_path: Path) -> None:
    config = StubConfig(ways={"1": "raises"})
    results = run_scenarios(
        [Chosen("stub", SCENARIO, config), Chosen("other", SCENARIO, StubConfig())], 0, jobs=1
    )
    write_results(tmp_path, results, config, 0)
    page = (tmp_path / "report.html").read_text()

    assert HOSTILE not in page
    assert "<script" not in page
    assert page.count("Squares &lt;script&gt;alert(&#x27;&amp;&#x27;)&lt;/script&gt;") > 4
    assert "number 1: ValueError: no such square" in page
    assert "default-src &#x27;none&#x27;" in page or "default-src 'none'" in page
    assert not any(f'{name}="http' in page for name in ("src", "href"))
    assert page.count('aria-label="does not hold"') == page.count('aria-label="cannot tell"') == 4
    ids = [part.split('"')[0] for part in page.split(' id="')[1:]]
    assert len(ids) == len(set(ids))
    assert (tmp_path / "stub_1.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "stub.rrd").is_file()


def test_csv_has_a_column_for_every_key_and_quotes_what_needs_it() -> None:
    text = rows_as_csv([{"a": 1, "b": 'x,"y'}, {"a": None, "c": 0.1}])

    assert text == 'a,b,c\n1,"x,""y",\n,,0.1\n'


@pytest.mark.usefixtures("tried_by_one_worker")
def test_a_urdf_without_wheels_is_a_failed_trial_with_its_reason(tmp_path: Path) -> None:
    urdf = tmp_path / "bare.urdf"
    urdf.write_text('<robot name="bare"><link name="base_footprint"/></robot>')
    words = [f"robot.urdf_file={urdf}", "beside=[]", "runs=2"]
    types = types_of("basic-drive")
    parts = parts_of(types, load_scenarios(types, None, words))
    entry = find_entries("basic-drive")[0]

    (result,) = run_scenarios([Chosen(entry.key, entry.scenario(), parts[entry.key])], 0, jobs=1)

    assert result.rows == ()
    assert all("wheel" in reason for _, reason in result.failures)
    assert result.findings.summary == "No trial came to an end."


def test_a_robot_that_cannot_be_built_is_refused_before_anything_runs(tmp_path: Path) -> None:
    urdf, out = tmp_path / "bare.urdf", tmp_path / "out"
    urdf.write_text('<robot name="bare"><link name="base_footprint"/></robot>')
    types = types_of("umbmark")
    whole = load_scenarios(types, None, [f"robot.urdf_file={urdf}"])

    with pytest.raises(InputRefused, match="there is no joint wheel_left_joint"):
        run_and_report(find_entries("umbmark"), whole, out, Reporter(quiet=True))
    assert not out.exists()
