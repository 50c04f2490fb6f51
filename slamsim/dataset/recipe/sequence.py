"""Specification of one sequence, and the facts known after it is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from slamsim.config.run import RunConfig

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

LogFormat = Literal["mcap", "parquet", "tum", "kitti", "carmen"]
ImageFormat = Literal["tum_rgbd", "euroc"]
"""Of cameras alone."""
FormatName = LogFormat | ImageFormat
Cell = str | int | float | bool | None
"""A value of a row of the manifest."""


@dataclass(frozen=True, slots=True)
class SequenceSpec:
    """One sequence to be made: a pure function of recipe and index.

    name: where it stands in the data set, such as ``train/000012``. world_index: sequences of one
    world share it, and never a split with another. config: resolved in full, faults and seeds of
    world and run included. drawn: what the recipe drew, by key path, as the manifest tells it.
    """

    index: int
    name: str
    split: Split
    world_index: int
    config: RunConfig
    formats: tuple[FormatName, ...]
    drawn: Mapping[str, Cell]


@dataclass(frozen=True, slots=True)
class FileFact:
    """A file of a sequence; path: relative to the folder of the sequence, with ``/``."""

    path: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class SequenceFacts:
    """A sequence that was made: its quality numbers (unit-bearing keys) and its files.

    Nothing in it depends on when, where or how fast it was made.
    """

    quality: Mapping[str, Cell]
    files: tuple[FileFact, ...]
