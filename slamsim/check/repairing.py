"""Repairs that make a recording better, and no others.

Each is tried, and the recording checked again: it stays if scans that are placed by what is
recorded alone lie on each other more closely (``map_quality/beam_ends.py``), or if a fault is gone
and they do so no less. Otherwise it is taken back. A recording can so only get better, and what is
repaired twice, or back and forth, comes to an end.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from slamsim.check.findings import CheckReport, Verdict
from slamsim.check.map_quality.beam_ends import TOLERANCE_M, BeamEnds, Change, beam_ends, change
from slamsim.check.questions.streams.gaps import GAPS
from slamsim.check.wording import signed_words
from slamsim.guard.errors import SlamsimError
from slamsim.recording import Recording
from slamsim.recording.repairs.apply import (
    VARIANTS,
    apply_repair,
    chosen,
    next_repairs,
    repeats,
    target_of,
    variants,
    without_rivals,
)
from slamsim.recording.repairs.base import Repair

DROPS_MESSAGES = ("drop_repeated_scans", "drop_broken_readings", "drop_broken_poses")
"""Operations that leave out messages of streams whose gaps are counted."""

Check = Callable[[Recording], CheckReport]

_ROUNDS = 5
"""What one fault hides, such as a turned mounting behind wrong stamps, shows once it is fixed."""

_SHRINKS = 0.5
"""What is repaired again must change by so much less than before: else it goes back and forth."""


@dataclass(frozen=True, slots=True)
class TakenBack:
    """A repair that was tried and is not part of the result, and why."""

    repair: Repair
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """The best recording that was found, and the check of it. applied: in their order. taken_back:
    what the last check still proposes. before, after: how well scans lie on each other."""

    recording: Recording
    report: CheckReport
    applied: tuple[Repair, ...]
    taken_back: tuple[TakenBack, ...]
    before: BeamEnds
    after: BeamEnds


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A recording as it is judged; applied: what led to it."""

    recording: Recording
    report: CheckReport
    ends: BeamEnds
    applied: tuple[Repair, ...] = ()


@dataclass(slots=True)
class _Course:
    """check: asks all questions. first: as it was read. here: the best so far. refused: by what
    they are applied to, in the state that ``here`` is."""

    check: Check
    first: Recording
    here: _State
    refused: dict[tuple[str, ...], TakenBack] = field(default_factory=dict)

    def attempt(self, repairs: Sequence[Repair]) -> bool:
        """Go on from the recording with all of them; False, and why, if that is no better."""
        try:
            there = self._applied(repairs)
            reason = _objection(self.here, there)
        except SlamsimError as error:  # one repair may take away what another acts on
            reason = str(error)
        if not reason:
            self.here, self.refused = there, {}
            return True
        if len(repairs) == 1:
            self.refused[target_of(repairs[0])] = TakenBack(repairs[0], reason)
        return False

    def _applied(self, repairs: Sequence[Repair]) -> _State:
        recording, ends, made = _best(self.first, self.here.applied, repairs)
        return _State(recording, self.check(recording), ends, tuple(made))

    def next(self, names: str) -> list[Repair]:
        """What is to be tried: proposed, chosen, not refused, and no return."""
        proposed = []
        for repair in chosen(self.here.report.repairs, names):
            key = target_of(repair)
            made = self.here.applied
            if key not in self.refused and any(repeats(repair, one, _SHRINKS) for one in made):
                reason = "it was applied before, and would be again by as much"
                self.refused[key] = TakenBack(repair, reason)
            if key not in self.refused:
                proposed.append(repair)
        return without_rivals(self.here.recording, next_repairs(proposed))


def restored(recording: Recording, names: str, check: Check) -> Restored:
    """Repair, check again, and keep what is better, until nothing more is.

    names: ``all``, ``none``, or the operations to apply. Raises SlamsimError for other names.
    """
    first = _State(recording, check(recording), beam_ends(recording))
    course = _Course(check, recording, first)
    for _ in range(_ROUNDS):
        repairs = course.next(names)
        if not repairs:
            break
        if not course.attempt(repairs) and len(repairs) > 1:
            for repair in repairs:
                course.attempt([repair])
    best, back = course.here, course.refused
    if (moved := change(first.ends, best.ends)).worse:  # by steps none of which was plainly worse
        reason = f"together they make the scans fit worse, {_in_words(moved, first.ends)}"
        back = {target_of(one): TakenBack(one, reason) for one in best.applied}
        best = first
    left = [target_of(repair) for repair in chosen(best.report.repairs, names)]
    return Restored(
        *(best.recording, best.report, best.applied),
        tuple(one for key, one in back.items() if key in left),
        *(first.ends, best.ends),
    )


Tried = tuple[Recording, BeamEnds, Sequence[Repair]]


def _best(first: Recording, made: Sequence[Repair], repairs: Sequence[Repair]) -> Tried:
    """All of them after those that were made, but for those without which scans fit better."""
    best = _best_variant(first, made, repairs)
    for repair in repairs:
        others = [one for one in best[2] if one != repair]
        if len(made) < len(others) < len(best[2]):
            without = _tried(first, others)
            best = without if change(best[1], without[1]).better else best
    return best


def _best_variant(first: Recording, made: Sequence[Repair], repairs: Sequence[Repair]) -> Tried:
    """With the way of a repair that lets scans fit best.

    Which way all rays were turned and where the laser sits are one: before a mount is moved it is
    asked whether another way, now or when the rays were repaired, does as well.
    """
    usual = _tried(first, [*made, *repairs])
    moves = [repair for repair in repairs if repair.operation == "set_mounting"]
    others = [repair for repair in usual[2] if repair not in moves]
    turning = next((repair for repair in others if repair.operation in VARIANTS), None)
    if turning is None or not (moves or turning in repairs):
        return usual
    place = others.index(turning)
    ways = [
        _tried(first, [*others[:place], variant, *others[place + 1 :]])
        for variant in variants(turning)
    ]
    best = min(ways, key=lambda way: round((way[1].mean_m or 0.0) / TOLERANCE_M))
    nothing_new = list(best[2]) == list(made)
    return usual if nothing_new or change(best[1], usual[1]).better else best


def _tried(first: Recording, repairs: Sequence[Repair]) -> Tried:
    recording = first
    for repair in repairs:
        recording = apply_repair(recording, repair)
    return recording, beam_ends(recording), repairs


def _objection(before: _State, after: _State) -> str:
    """Why a recording is no better than the one before; empty if it is.

    A fault is gone if no question finds it on its subject any more. It is new where the same
    question answered "ok" before; what could not be told before is no news.
    """
    moved = change(before.ends, after.ends)
    new = _answered(after.report, "fault") - _answered(before.report, "fault")
    new &= _answered(before.report, "ok")
    made = {target_of(repair) for repair in after.applied if repair not in before.applied}
    # What is left out is missing: that is told, and better than what was wrong.
    new -= {(GAPS.id, subject) for operation, subject, _ in made if operation in DROPS_MESSAGES}
    if moved.worse:
        return f"it makes the scans fit worse, {_in_words(moved, before.ends)}"
    were, are = _named(before.report), _named(after.report)
    if new and not (moved.better and len(new) <= len(were - are)):
        return (
            f"then {', '.join(sorted(f'{check} of {subject}' for check, subject in new))} is wrong"
        )
    meant = _named(before.report, made) & are
    if moved.better or not meant:
        return ""
    still = ", ".join(sorted({fault for fault, _ in meant}))
    return f"{still} is still there, and the scans fit no better, {_in_words(moved, before.ends)}"


def _named(
    report: CheckReport, repaired: Collection[tuple[str, ...]] | None = None
) -> set[tuple[str, str]]:
    """Names and subjects of the faults; of those alone for which these targets are repaired."""
    return {
        (str(one.fault), one.subject)
        for one in report.faults
        if repaired is None or any(target_of(repair) in repaired for repair in one.repairs)
    }


def _answered(report: CheckReport, verdict: Verdict) -> set[tuple[str, str]]:
    """The questions, with their subjects, that have this answer."""
    return {(one.check, one.subject) for one in report.findings if one.verdict == verdict}


def _in_words(moved: Change, before: BeamEnds) -> str:
    if before.mean_m is None:
        return "and nothing places them"
    with_it = signed_words(1e3 * moved.mean_m, "mm", "more", "less", 1)
    return f"{1e3 * before.mean_m:.1f} mm apart before, {with_it} with it"
