"""Stages that fail without taking what stood before them along."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from slamsim.core.result import FailedStage
from slamsim.guard.errors import SlamsimError, reason_of
from slamsim.guard.numbers import NoSolution

_log = logging.getLogger(__name__)


class Failures:
    """Collects what failed, so that everything else can go on and be told at the end."""

    def __init__(self, before: Iterable[FailedStage] = ()) -> None:
        self._stages = {failed.stage: failed for failed in before}

    def __iter__(self) -> Iterator[FailedStage]:
        return iter(self._stages.values())

    def add(self, failed: FailedStage) -> None:
        """One more; of each stage the first is kept, and how often it failed."""
        before = self._stages.get(failed.stage)
        if before is not None:
            failed = replace(before, times=before.times + 1)
        self._stages[failed.stage] = failed

    @contextmanager
    def caught(self, stage: str, keyframe: int) -> Iterator[None]:
        """Within, any error ends the stage alone, except one about files or disks.

        keyframe: number of the newest one, told where the error names none.
        """
        try:
            yield
        except Exception as error:
            of_files = isinstance(error, SlamsimError) and error.exit_code != SlamsimError.exit_code
            if of_files or isinstance(error, OSError):
                raise
            _log.debug("%s failed", stage, exc_info=True)
            at = error.keyframe if isinstance(error, NoSolution) else None
            self.add(FailedStage(stage, keyframe if at is None else at, reason_of(error)))
