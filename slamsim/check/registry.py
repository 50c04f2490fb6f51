"""All questions, found in the modules below ``questions/``: a new one is a new module there.

Or in a distribution that names its module in the entry-point group ``slamsim.check.questions``.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType, ModuleType

from slamsim.check.question import FaultKind, Question, QuestionGroup
from slamsim.guard.plugins import left_out, modules_in, with_distributions

_log = logging.getLogger(__name__)
_PACKAGE = "slamsim.check.questions"

CHECKER_ERROR = FaultKind("checker_error", "slamsim itself failed on a question")
"""Reported of questions that raise: our fault, not the recording's."""

SINGLE_QUESTIONS = 90
"""Questions with an ``ask`` of their own stand behind the groups of the quick part."""


@dataclass(frozen=True, slots=True, eq=False)
class Registry:
    """groups: in the order of the report. questions: by id. faults: by name."""

    groups: tuple[QuestionGroup, ...]
    questions: Mapping[str, Question]
    faults: Mapping[str, FaultKind]


@cache
def registry() -> Registry:
    """The questions of this installation; the first call imports what answers them.

    Raises ValueError for an id that two questions share, a fault that is declared twice and a
    question that nothing asks. Modules of distributions of which that holds, or that cannot be
    imported, are left out, and the log warns of it.
    """
    ours = tuple(_modules(_PACKAGE))
    modules = with_distributions(_PACKAGE, ours, _with_questions_of)
    if missing := left_out(_PACKAGE):
        _log.warning("questions are not asked: %s", missing)
    return _registry_of(modules)


def _with_questions_of(
    modules: tuple[ModuleType, ...], module: ModuleType
) -> tuple[ModuleType, ...]:
    more = (*modules, module, *_modules_below(module))
    _registry_of(more)
    return more


def fault_meaning(name: str) -> str:
    """What is wrong, as a clause. Raises KeyError for a name that no question can report."""
    return registry().faults[name].meaning


def _registry_of(modules: Iterable[ModuleType]) -> Registry:
    declared = {id(value): value for module in modules for value in vars(module).values()}
    groups = [one for one in declared.values() if isinstance(one, QuestionGroup)]
    singles = [
        QuestionGroup(one.id, SINGLE_QUESTIONS, (one,), one.ask, one.thorough)
        for one in declared.values()
        if isinstance(one, Question) and one.ask is not None
    ]
    groups = sorted([*groups, *singles], key=lambda one: (one.thorough, one.order, one.part))
    asked = {id(question) for group in groups for question in group.questions}
    for one in declared.values():
        if isinstance(one, Question) and id(one) not in asked:
            raise ValueError(f"nothing asks the question {one.id!r}: it has no ask, nor a group")
    questions: dict[str, Question] = {}
    faults = {CHECKER_ERROR.name: CHECKER_ERROR}
    for question in (question for group in groups for question in group.questions):
        if questions.setdefault(question.id, question) is not question:
            raise ValueError(f"two questions have the id {question.id!r}")
        for fault in question.faults:
            if faults.setdefault(fault.name, fault) is not fault:
                raise ValueError(f"the fault {fault.name!r} is declared twice")
    return Registry(tuple(groups), MappingProxyType(questions), MappingProxyType(faults))


def _modules(package: str) -> Iterator[ModuleType]:
    """All modules of a package and of the packages in it."""
    for module in modules_in(package):
        yield module
        yield from _modules_below(module)


def _modules_below(module: ModuleType) -> Iterator[ModuleType]:
    if hasattr(module, "__path__"):
        yield from _modules(module.__name__)
