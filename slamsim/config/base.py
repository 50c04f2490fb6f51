"""Base class of all configuration models."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Config(BaseModel):
    """Strict, complete with defaults, frozen, and deaf to nothing: unknown keys are refused.

    Every number carries its unit in its name and its bounds in its ``Field``; below every field
    stands what it is, which ``slamsim config`` prints as a comment.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
    )
