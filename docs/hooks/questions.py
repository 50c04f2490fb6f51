"""Writes the page of the checker's questions from their declarations, while the site is built.

What a question means, which faults it finds and what they cause is in its ``Question``; how a
fault looks is in the bundled faults that expect it; how it is fixed is in the advice of its
findings and in the repairs that it proposes.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from types import ModuleType
from typing import Any

from slamsim.check.question import Question
from slamsim.check.registry import registry
from slamsim.recording.repairs.apply import OPERATIONS
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import bundled_faults

PLACE = "<!-- questions -->"
SUBJECTS = {
    "camera": "Cameras",
    "clock": "Clocks",
    "description": "Robot description",
    "frames": "Frames and rotations",
    "gyro": "Gyroscope",
    "imu": "Inertial unit",
    "laser": "Laser",
    "odometry": "Odometry",
    "ranges": "Ranges",
    "tf": "Transform tree",
    "time": "Stamps",
    "topic": "Topics",
    "wheels": "Wheels",
}
"""Headings by the first part of the ids."""


def on_page_markdown(markdown: str, **given: Any) -> str:
    """Called by MkDocs for each page; its type of ``given`` is the library's own."""
    return markdown.replace(PLACE, questions_page()) if PLACE in markdown else markdown


@cache
def questions_page() -> str:
    """All questions as Markdown, by subject."""
    parts = []
    every = sorted(registry().questions.values(), key=_subject)
    for subject, questions in groupby(every, key=_subject):
        parts.append(f"## {SUBJECTS.get(subject, subject.capitalize())}\n")
        parts += map(_entry, questions)
    return "\n".join(parts)


def _subject(question: Question) -> str:
    return question.id.split(".")[0]


def _entry(question: Question) -> str:
    lines = [f"### {question.id} {{#{question.id}}}\n", f"{_sentence(question.meaning)}\n"]
    if question.limit is not None:
        lines.append(f"- **Limit**: {question.limit:.3g} {question.unit}".rstrip())
    lines.append(f"- **If not**: {question.consequence}")
    if question.excitation_wanted:
        lines.append(f"- **Needs**: {question.excitation_wanted}")
    for fault in question.faults:
        lines.append(f"- **Fault** `{fault.name}`: {fault.meaning}")
        lines += [f"    - {_example(each)}" for each in _examples().get(fault.name, ())]
    lines += [f"- **To do**: {words}" for words in _advice().get(question.id, ())]
    for name in question.repairs:
        words = " ".join((inspect.getdoc(OPERATIONS[name]) or "").split("\n\n")[0].split())
        lines.append(f"- **`slamsim fix`** can apply `{name}`: {words}")
    return "\n".join(lines) + "\n"


def _sentence(clause: str) -> str:
    return f"{clause[0].upper()}{clause[1:]}."


def _example(fault: Fault) -> str:
    words = f"to see it: `slamsim simulate labyrinth --fault {fault.name}` ({fault.title})"
    linked = fault.source.startswith("https://")
    return f"{words}; [a report of it]({fault.source})" if linked else words


@cache
def _examples() -> Mapping[str, Sequence[Fault]]:
    """Bundled faults by the name under which the checker reports them."""
    found = defaultdict(list)
    for fault in bundled_faults():
        found[fault.expects].append(fault)
    return found


@cache
def _advice() -> Mapping[str, Sequence[str]]:
    """What the findings of each question advise, by its id; numbers of a recording as "…"."""
    found: dict[str, dict[str, None]] = defaultdict(dict)
    for name in sorted(name for name in sys.modules if name.startswith("slamsim.check.questions.")):
        module = sys.modules[name]
        for question, words in _advised(module):
            found[question.id][words] = None
    return {id_: tuple(words) for id_, words in found.items()}


def _advised(module: ModuleType) -> Iterator[tuple[Question, str]]:
    """Of each ``judge(QUESTION, ..., advice="...")`` in a module."""
    if module.__file__ is None or not (text := Path(module.__file__).read_text()):
        return  # a package without a text of its own
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "judge"):
            continue
        question = vars(module).get(getattr(node.args[0], "id", ""))
        words = "".join(_text(word.value) for word in node.keywords if word.arg == "advice")
        if isinstance(question, Question) and words:
            yield question, words


def _text(node: ast.expr) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_text, node.values))
    if isinstance(node, ast.FormattedValue):
        return "…"
    return str(node.value) if isinstance(node, ast.Constant) else ""
