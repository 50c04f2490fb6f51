"""Exceptions of file libraries become one clear input error."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slamsim.guard.errors import InputRefused, SlamsimError, limit_of
from slamsim.guard.numbers import BadNumbers


def damaged(
    path: Path, reason: str, where: str = "", error: Exception | None = None
) -> InputRefused:
    """The error for a recording that is cut or damaged, which says what to do about it.

    error: what led to it; one that exceeds a limit is no damage.
    """
    limit = "" if error is None else limit_of(error)
    way_out = (
        "" if limit else f"; `slamsim recover {shlex.quote(str(path))}` gets back what is whole"
    )
    return InputRefused(path, f"{reason}{way_out}", where, limit=limit)


@contextmanager
def as_input_errors(path: Path, where: str) -> Iterator[None]:
    """Inside, whatever is raised about the file is raised as InputRefused.

    Damaged and hostile files make the readers raise nearly anything: OverflowError, KeyError,
    struct.error, AssertionError, RecursionError, MemoryError, and errors of their own. What we
    raise ourselves, and a disk that cannot be read, pass through.
    """
    try:
        yield
    except BadNumbers as error:
        raise InputRefused(path, str(error), where) from error
    except SlamsimError:
        raise
    except Exception as error:
        detail = " ".join(str(error).split())[:200]
        kind = type(error).__name__
        reason = f"damaged, or no recording ({kind}: {detail})" if detail else f"damaged ({kind})"
        raise InputRefused(path, reason, where, limit=limit_of(error)) from error
