"""Questions: declared in one place, found by being there, answered by one rule."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_data import recording
from typer.testing import CliRunner

from slamsim.bench.check.outcome import require_known_names
from slamsim.check import questions
from slamsim.check.findings import Measurement, decide
from slamsim.check.question import FaultKind, Question, judge
from slamsim.check.registry import CHECKER_ERROR, registry
from slamsim.cli.main import app
from slamsim.io.bag2.writer import write_recording
from slamsim.recording.repairs.apply import OPERATIONS
from slamsim.recording.repairs.base import Repair
from slamsim.sensors import faults
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import kinds, load_fault

CONTRIBUTING = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text()
LATE = FaultKind("stamps_late", "messages are received long after their stamp")
QUESTION = Question(
    "time.receipt",
    "messages are received soon",
    (LATE,),
    limit=2.0,
    unit="ms",
    repairs=("reorder",),
)

sizes = st.builds(
    Measurement,
    st.floats(-50.0, 50.0),
    st.floats(0.0, 10.0),
    st.just("ms"),
)


def test_every_question_declares_what_it_asks_and_what_a_fault_does() -> None:
    asked = registry().questions.values()
    assert len(asked) > 60
    for question in asked:
        assert question.meaning and question.consequence, question.id
        assert set(question.repairs) <= OPERATIONS.keys(), question.id
        assert not (question.repairs and not question.faults), question.id
        assert question.faults or question.excitation_wanted, question.id
    found = {fault.name for question in asked for fault in question.faults}
    assert found | {CHECKER_ERROR.name} == registry().faults.keys()
    groups = [question.id for group in registry().groups for question in group.questions]
    assert sorted(groups) == sorted(registry().questions)


@given(size=sizes, limit=st.floats(0.1, 20.0))
def test_the_interval_of_a_size_decides(size: Measurement, limit: float) -> None:
    verdict = decide(size, limit)
    nearest, farthest = sorted(map(abs, size.interval))
    if verdict == "fault":
        assert size.interval[0] > limit or size.interval[1] < -limit
        assert abs(size.value) > 4.5 * size.sigma
    elif verdict == "ok":
        assert farthest <= limit
    else:
        assert farthest > limit and (nearest <= limit or abs(size.value) <= 4.5 * size.sigma)
    assert decide(replace(size, value=-size.value), limit) == verdict
    assert decide(replace(size, value=size.value + 1e4), limit, healthy=1e4) in (
        verdict,
        decide(replace(size, value=size.value * (1.0 + 1e-9)), limit),
        decide(replace(size, value=size.value * (1.0 - 1e-9)), limit),
    )


def test_what_limits_allow_for_does_not_count_again_in_the_sigma() -> None:
    """Wheels 3 ms late, 0.4 of the sigma from tyres that give, for which the limit is so wide."""
    late = Measurement(2.4, 0.5, "ms", allowed=0.3)
    assert decide(late, 1.5) == "fault"
    assert decide(replace(late, allowed=0.0), 1.5) == "inconclusive"
    assert late.interval == replace(late, allowed=0.0).interval


def test_what_only_a_fault_calls_for_is_left_out_of_other_answers() -> None:
    repair = Repair("reorder", "/scan")
    for size, verdict in ((5.0, "fault"), (1.0, "ok")):
        found = judge(
            QUESTION,
            "/scan",
            {"ok": "soon", "fault": "late"},
            Measurement(size, 0.0, "ms"),
            advice="Sort.",
            repairs=(repair,),
        )
        is_fault = verdict == "fault"
        assert found.verdict == verdict and found.limit == 2.0
        assert found.words == ("late" if is_fault else "soon")
        assert (found.fault, found.advice, found.repairs) == (
            ("stamps_late", "Sort.", (repair,)) if is_fault else (None, "", ())
        )


def test_a_question_finds_and_repairs_what_it_declares_alone() -> None:
    other = FaultKind("other", "something else")
    with pytest.raises(ValueError, match="declares no fault 'other'"):
        judge(QUESTION, "/scan", "late", verdict="fault", fault=other)
    with pytest.raises(ValueError, match="declares no repair drop_beams"):
        judge(QUESTION, "/scan", "late", verdict="fault", repairs=(Repair("drop_beams", "/scan"),))
    with pytest.raises(ValueError, match="no verdict without a size"):
        judge(QUESTION, "/scan", "late")


def _block(heading: str, language: str) -> str:
    """The first block of a language under a heading of CONTRIBUTING.md."""
    under = CONTRIBUTING.split(f"### {heading}\n")[1]
    return under.split(f"```{language}\n", 1)[1].split("```", 1)[0]


@pytest.fixture
def fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fault]:
    """The worked examples of CONTRIBUTING.md: the question in the place where questions are looked
    for, and the fault that it finds."""
    for package, heading in ((questions, "Add a question"), (faults, "Add a fault")):
        folder = tmp_path / heading.split()[-1]
        folder.mkdir()
        (folder / "worked_example.py").write_text(_block(heading, "python"))
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    described = tmp_path / "gyro_drift.yaml"
    expected = _block("Add a question", "yaml")
    described.write_text(re.sub(r"expects:.*\n", expected, _block("Add a fault", "yaml")))
    registry.cache_clear()
    kinds.cache_clear()
    yield load_fault(str(described))
    registry.cache_clear()
    kinds.cache_clear()
    for name in (questions.__name__, faults.__name__):
        sys.modules.pop(f"{name}.worked_example", None)


def test_a_new_question_with_its_fault_is_one_module(fault: Fault, tmp_path: Path) -> None:
    """From the module to exit code, table, page, JSON and list."""
    require_known_names([fault])
    warming = fault.inject(recording(), np.random.default_rng(0))
    for name, made in (("good", recording()), ("warm", warming)):
        write_recording(made, tmp_path / name)
    run = CliRunner().invoke

    good = run(app, ["check", str(tmp_path / "good"), "--quick", "--json"])
    found = json.loads(good.stdout)
    assert good.exit_code == 0
    (fine,) = (f for f in found["findings"] if f["check"] == "gyro.drift")
    assert fine["verdict"] == "ok" and fine["subject"] == "/imu"

    page = tmp_path / "page.html"
    warm = run(app, ["check", str(tmp_path / "warm"), "--quick", "--html", str(page)])
    assert warm.exit_code == 1
    assert "gyro_drift" in warm.output
    assert "the gyroscope's bias grows" in page.read_text().replace("&#x27;", "'")

    warm = run(app, ["check", str(tmp_path / "warm"), "--quick", "--json"])
    found = json.loads(warm.stdout)
    assert (warm.exit_code, found["faults"]) == (1, ["gyro_drift"])
    (told,) = (f for f in found["findings"] if f["fault"] == "gyro_drift")
    assert told["value"] == pytest.approx(fault.size, abs=5.0 * told["sigma"])

    listed = json.loads(run(app, ["check", "--list", "--json"]).stdout)["questions"]
    (declared,) = (one for one in listed if one["id"] == "gyro.drift")
    assert declared["faults"].keys() == {"gyro_drift"} and declared["limit"] == told["limit"]
