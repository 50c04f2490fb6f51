"""A live drive on disk: the folder that ``simulate`` writes, and the commands of the drive."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.loading import load_model
from slamsim.config.run import RunConfig
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import own_file
from slamsim.guard.output import discard, partial_folder, write_atomic
from slamsim.guard.unpacking import open_lines
from slamsim.io import LOG
from slamsim.io.ros.encoding import stream_messages
from slamsim.io.text.tum import write_tum
from slamsim.live.robot import LiveRobot, Window
from slamsim.recording import RawOdometry, RawStream
from slamsim.sim.drive.follow import Twist
from slamsim.simulation.header import LogHeader
from slamsim.simulation.log_writer import begun_bag
from slamsim.simulation.own_files import write_config, write_world
from slamsim.simulation.recorder import TRUTH
from slamsim.simulation.tails import joined_path
from slamsim.world.model import World

DRIVE, COMMANDS = "drive.yaml", "commands.csv"
_COLUMNS = "tick,v_m_s,w_rad_s"


class RecordedTicks(Config):
    """``drive.yaml``: which part of a drive was recorded, in control ticks since it began."""

    first_tick: int = Field(ge=0)
    """At which the recording began."""
    end_tick: int = Field(ge=1)
    """At which it ended."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.first_tick >= self.end_tick:
            raise ValueError("first_tick must be below end_tick")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDrive:
    """What drives a robot again. commands: each change, (control tick from which on, twist)."""

    first_tick: int
    end_tick: int
    commands: Sequence[tuple[int, Twist]]


def read_drive(folder: Path) -> RecordedDrive:
    """Of a recorded folder. Raises NotFound or InputRefused."""
    ticks = load_model(RecordedTicks, own_file(folder, DRIVE))
    return RecordedDrive(ticks.first_tick, ticks.end_tick, _read_commands(folder))


def _read_commands(folder: Path) -> list[tuple[int, Twist]]:
    path = own_file(folder, COMMANDS)
    found: list[tuple[int, Twist]] = []
    for number, line in open_lines(path):
        if number == 1 and line.strip() == _COLUMNS:
            continue
        words = line.split(",")
        try:
            tick, speed_m_s, rate_rad_s = int(words[0]), float(words[1]), float(words[2])
        except (ValueError, IndexError):
            raise InputRefused(path, f"expected {_COLUMNS}", f"line {number}") from None
        if not (math.isfinite(speed_m_s) and math.isfinite(rate_rad_s)):
            raise InputRefused(path, "expected finite numbers", f"line {number}")
        if tick < 0 or (found and tick <= found[-1][0]):
            raise InputRefused(path, "the ticks must rise from 0 or later", f"line {number}")
        found.append((tick, (speed_m_s, rate_rad_s)))
    return found


class DriveRecording:
    """A recording that is being written, until ``finish``; ``folder`` appears when it is whole."""

    def __init__(
        self,
        folder: Path,
        robot: LiveRobot,
        config: RunConfig,
        world: World,
        header: LogHeader,
        overwrite: bool = False,
    ) -> None:
        self.folder = folder
        self._robot, self._first_tick = robot, robot.ticks
        self._is_whole = False
        self._truth: list[RawOdometry] = []
        self._says_once = robot.ticks > 0
        with ExitStack() as opened:
            self._partial = opened.enter_context(partial_folder(folder, overwrite))
            write_config(self._partial, config)
            write_world(self._partial, config, world)
            opened.callback(self._complete)
            self._bag = opened.enter_context(begun_bag(self._partial / LOG, header))
            self._open = opened.pop_all()

    def write(self, window: Window) -> None:
        """The next window; the recording begins with the first."""
        messages = list(window.messages)
        if self._says_once:
            self._says_once = False
            now_ns = int(window.drive.stamps_ns[0])
            once = self._robot.said_once()
            late = [replace(m, log_ns=np.maximum(m.log_ns, now_ns)) for m in once]
            messages = [*late, *messages]
        self._truth.extend(_truth_among(window.part.beside))
        self._bag.add(messages)
        self._bag.release(window.end_ns)

    def finish(self) -> Path:
        """Its folder, whole and sealed. Raises SlamsimError where the disk does not suffice."""
        rest = self._robot.rest()
        self._truth.extend(_truth_among(rest))
        self._bag.add([stream_messages(stream) for stream in rest])
        self._is_whole = True
        self._open.close()
        return self.folder

    def discard(self) -> None:
        """Leave nothing behind."""
        discard(self._open)

    def _complete(self) -> None:
        """What is known once the bag is closed."""
        if not self._is_whole:
            return
        if self._truth:
            write_tum(self._partial / "ground_truth.tum", joined_path(self._truth))
        ticks = f"first_tick: {self._first_tick}\nend_tick: {self._robot.ticks}\n"
        write_atomic(self._partial / DRIVE, ticks.encode())
        rows = [f"{tick},{v_m_s!r},{w!r}" for tick, (v_m_s, w) in self._robot.commands]
        write_atomic(self._partial / COMMANDS, "\n".join([_COLUMNS, *rows, ""]).encode())


def _truth_among(streams: Iterable[RawStream]) -> Iterator[RawOdometry]:
    """Kept as it is written: to read it again at the end takes 9 s for a drive of an hour."""
    return (one for one in streams if isinstance(one, RawOdometry) and one.topic == TRUTH)
