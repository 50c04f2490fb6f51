"""Recovers the intact messages of a truncated or damaged recording, in any format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from slamsim.core.progress import Progress, silent
from slamsim.guard.errors import InputRefused
from slamsim.io.salvage.bag1 import recover_bag1
from slamsim.io.salvage.bag2 import recover_bag2
from slamsim.io.salvage.carmen import recover_carmen
from slamsim.io.salvage.report import Recovered
from slamsim.io.salvage.source import Damaged, Kind
from slamsim.io.salvage.tables import recover_tables

_RECOVER: Mapping[Kind, Callable[[Damaged, Path, Progress], Recovered]] = {
    "ROS 2": recover_bag2,
    "ROS 1": recover_bag1,
    "CARMEN": recover_carmen,
    "Parquet": recover_tables,
}


def recover(source: Damaged, folder: Path, progress: Progress = silent) -> Recovered:
    """Write into a new or empty folder what is whole in a recording, which is only read.

    progress counts bytes of it. Call it inside ``partial_folder``. Raises InputRefused if there is
    not one whole message.
    """
    result = _RECOVER[source.kind](source, folder, progress)
    if result.messages == 0:
        reasons = "; ".join(dict.fromkeys(loss.reason for loss in result.losses[:3]))
        why = f" ({reasons})" if reasons else ""
        raise InputRefused(source.path, f"there is not one whole message in it{why}")
    return result
