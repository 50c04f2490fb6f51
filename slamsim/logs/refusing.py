"""Any odd exception of a file library becomes one clear refusal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slamsim.safe.errors import InputRefused, SlamsimError, limit_of


@contextmanager
def refusing(path: Path, where: str) -> Iterator[None]:
    """Inside, whatever is raised about the file is raised as InputRefused.

    Damaged and hostile files make the readers raise nearly anything: OverflowError, KeyError,
    struct.error, AssertionError, RecursionError, MemoryError, and errors of their own. What we
    raise ourselves, and a disk that cannot be read, pass through.
    """
    try:
        yield
    except SlamsimError:
        raise
    except Exception as error:
        detail = " ".join(str(error).split())[:200]
        kind = type(error).__name__
        reason = f"damaged, or no recording ({kind}: {detail})" if detail else f"damaged ({kind})"
        raise InputRefused(path, reason, where, limit=limit_of(error)) from error
