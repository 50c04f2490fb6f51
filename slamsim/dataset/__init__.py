"""Synthetic SLAM data sets by the thousand: recipe, sequences, engines, catalogue, reader."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamsim.dataset.store.reader import Dataset


def open(address: str | Path) -> Dataset:  # noqa: A001 - of a module that is named when called
    """The finished data set in a folder or behind a URL, to be used as a list of its sequences.

    Raises NotFound where there is none, InputRefused if its manifest is damaged.
    """
    from slamsim.dataset.store.reader import open_dataset

    return open_dataset(address)
