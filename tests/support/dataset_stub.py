"""Sequences that cost nothing: a few bytes each, and told to misbehave by what lies in a folder.

Workers load this module: it imports nothing that takes long.
"""

from __future__ import annotations

import hashlib
import os
import random
import signal
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.dataset.recipe.sequence import SPLITS, FileFact, SequenceFacts, SequenceSpec
from slamsim.guard.errors import SlamsimError

SIZE_BYTES = 3000
_CONFIG = RunConfig()


def draw(index: int) -> SequenceSpec:
    split = SPLITS[index % 3]
    return SequenceSpec(
        index=index,
        name=f"{split}/{index:06d}",
        split=split,
        world_index=index // 3,
        config=_CONFIG.model_copy(update={"seed": index}),
        formats=("parquet",),
        drawn={"size": index * 0.5},
    )


@dataclass(frozen=True)
class Stub:
    """Makes two files. ``<orders>/<index>``: what to do instead, one word for each try.

    The words: break, refuse, crash, kill, hang, eat, leave, fill, lose. seconds: for each.
    """

    orders: Path
    seconds: float = 0.0

    def __call__(self, spec: SequenceSpec, folder: Path) -> SequenceFacts:
        (folder / "log").mkdir()
        half = folder / "log" / "data.bin"
        half.write_bytes(b"half-written")
        self._obey(spec.index, folder)
        time.sleep(self.seconds)
        stream = random.Random(spec.config.seed)
        files = {"log/data.bin": stream.randbytes(SIZE_BYTES), "config.yaml": b"seed: 1\n"}
        for name, data in files.items():
            (folder / name).write_bytes(data)
        return SequenceFacts(
            {"duration_s": 60.0, "path_length_m": round(stream.random(), 3)},
            tuple(
                FileFact(name, len(data), hashlib.sha256(data).hexdigest())
                for name, data in files.items()
            ),
        )

    def _obey(self, index: int, folder: Path) -> None:
        order = self.orders / str(index)
        words = order.read_text().split() if order.is_file() else []
        if words:
            order.write_text(" ".join(words[1:]))
            _MISDEEDS.get(words[0], partial(_lose, folder))()


def _break() -> None:
    raise KeyError("told to")


def _refuse() -> None:
    raise SlamsimError("the robot is stuck")


def _crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _hang() -> None:
    time.sleep(1000.0)


def _eat() -> None:
    bytearray(10**12)


def _leave() -> None:
    os._exit(0)


def _lose(folder: Path) -> None:
    (folder / "log" / "lost").read_bytes()


def _fill() -> None:
    raise OSError(28, "No space left on device")


_MISDEEDS = {
    "break": _break,
    "refuse": _refuse,
    "crash": _crash,
    "kill": _kill,
    "hang": _hang,
    "eat": _eat,
    "leave": _leave,
    "fill": _fill,
}
