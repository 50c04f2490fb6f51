"""Sequences that cost nothing: a few bytes each, and told to misbehave by what lies in a folder."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.dataset.identity import Identity
from slamsim.dataset.production import Order
from slamsim.dataset.sequence import SPLITS, FileFact, SequenceFacts, SequenceSpec
from slamsim.randomness import random_stream
from slamsim.safe.errors import SlamsimError

SIZE_BYTES = 3000


def draw(index: int, count: int = 1000) -> SequenceSpec:
    assert index < count
    split = SPLITS[index % 3]
    return SequenceSpec(
        index=index,
        name=f"{split}/{index:06d}",
        split=split,
        world_index=index // 3,
        config=RunConfig(seed=index),
        formats=("parquet",),
        drawn={"size": index * 0.5},
    )


@dataclass(frozen=True)
class Stub:
    """Makes two files. ``<orders>/<index>``: what to do instead, one word for each try.

    The words: raise, refuse, crash, kill, hang, memory, leave. seconds: how long each takes.
    """

    orders: Path
    seconds: float = 0.0

    def __call__(self, spec: SequenceSpec, folder: Path) -> SequenceFacts:
        (folder / "log").mkdir()
        (folder / "log" / "half").write_bytes(b"x")
        self._obey(spec.index)
        time.sleep(self.seconds)
        (folder / "log" / "half").unlink()
        stream = random_stream(spec.config.seed, "stub")
        files = {"log/data.bin": stream.bytes(SIZE_BYTES), "config.yaml": b"seed: 1\n"}
        for name, data in files.items():
            (folder / name).write_bytes(data)
        return SequenceFacts(
            {"duration_s": 60.0, "path_length_m": float(np.round(stream.random(), 3))},
            tuple(
                FileFact(name, len(data), hashlib.sha256(data).hexdigest())
                for name, data in files.items()
            ),
        )

    def _obey(self, index: int) -> None:
        order = self.orders / str(index)
        if not order.is_file():
            return
        words = order.read_text().split()
        order.write_text(" ".join(words[1:]))
        if words:
            getattr(self, f"_{words[0]}")()

    def _raise(self) -> None:
        raise KeyError("told to")

    def _refuse(self) -> None:
        raise SlamsimError("the robot is stuck")

    def _crash(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)

    def _kill(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def _hang(self) -> None:
        time.sleep(1000.0)

    def _memory(self) -> None:
        np.ones(10**10)

    def _leave(self) -> None:
        os._exit(0)


def order(stub: Stub, count: int, *, shard_sequences: int = 4, limit_s: float = 30.0) -> Order:
    return Order(
        count=count,
        shard_sequences=shard_sequences,
        draw=partial(draw, count=count),
        produce=stub,
        limit_s=limit_s,
        command=lambda index: f"make --only {index}",
    )


def identity(count: int, **recipe: object) -> Identity:
    return Identity("stub", count, {"seed": 1, **recipe})


def tree(folder: Path) -> dict[str, bytes]:
    """All files but the logs."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.relative_to(folder).parts[0] != "logs"
    }
