"""Settings of the faults to inject; the faults themselves are in ``configs/faults``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from pydantic import BeforeValidator, Field, ValidationError

from slamsim.config.base import Config
from slamsim.guard.errors import OverrideRefused, shown


class FaultChoice(Config):
    """One fault; ``name`` or ``name:size`` as a text says the same."""

    name: str = Field(min_length=1, max_length=1000)
    """Name of a bundled fault, or path of a file that describes one."""
    size: float | None = None
    """How large, in the unit of the fault's own size; null is clearly harmful."""


def as_choice(given: object) -> object:
    """The text ``name:size`` taken apart; anything else as it is.

    A text after a colon that is no number belongs to the name.
    """
    if not isinstance(given, str):
        return given
    name, colon, size = given.rpartition(":")
    try:
        return {"name": name, "size": float(size)} if colon else {"name": given}
    except ValueError:
        return {"name": given}


def typed_choices(texts: Iterable[str]) -> tuple[FaultChoice, ...]:
    """What stands behind ``--fault``, each ``name`` or ``name:size``. Raises OverrideRefused."""
    return tuple(map(_typed, texts))


def _typed(text: str) -> FaultChoice:
    try:
        return FaultChoice.model_validate(as_choice(text))
    except ValidationError as error:
        reason = f"{error.errors()[0]['msg'].lower()}; write name or name:size"
        raise OverrideRefused(f"--fault {shown(text)}", reason) from None


FaultChoices = Annotated[
    tuple[Annotated[FaultChoice, BeforeValidator(as_choice)], ...], Field(strict=False)
]
