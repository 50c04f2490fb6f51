"""Simulated logs, one per seed, made once and kept for the next run; work in processes of its own,
to measure peak memory and isolate crashes."""

from __future__ import annotations

import json
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import NoReturn, ParamSpec, Self, TypeVar, cast

from pydantic import ValidationError

from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.output import write_atomic
from slamsim.guard.yaml import load_yaml
from slamsim.process.children import end_with_parent
from slamsim.simulation.own_files import CONFIG

SIMULATED = ("seed", "world", "robot", "drive", "sensors", "faults")
"""The parts of a configuration that decide what is in a log."""


def simulated_log(config: RunConfig, folder: Path, children: Children) -> Path:
    """The run folder of this simulation under ``folder``, simulated unless it is there already.

    Raises InputRefused for one that was simulated with other settings, and what the simulation
    raises.
    """
    log = folder / f"{config.world.name}_{config.seed}"
    if log.exists():
        _require_same(config, log)
    else:
        children.run(_simulate, config, log)
    return log


@contextmanager
def kept_or_temporary(kept: Path | None) -> Iterator[Path]:
    """The folder for logs that was named, else one that is gone afterwards."""
    if kept is not None:
        yield kept
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def _simulate(config: RunConfig, folder: Path) -> None:
    from slamsim.run.recording import simulate_world  # not for other work of children

    simulate_world(config, folder, Reporter(quiet=True))


def simulation_of(log: Path) -> RunConfig:
    """The configuration that a simulated log was made with; only the simulation's part counts,
    so that a log outlives changes to SLAM's settings.

    Raises InputRefused where there is none, or one that is understood no more.
    """
    if not (log / CONFIG).is_file():
        raise InputRefused(log, f"holds no {CONFIG}; is it the folder of a simulated run?")
    data = load_yaml(log / CONFIG).data
    kept = {key: data[key] for key in SIMULATED if key in data} if isinstance(data, dict) else data
    try:
        return RunConfig.model_validate(kept)
    except ValidationError as error:
        fault = error.errors()[0]
        at = ".".join(map(str, fault["loc"]))
        raise InputRefused(log / CONFIG, f"{at}: {fault['msg']}; simulate it anew") from None


def _require_same(config: RunConfig, log: Path) -> None:
    parts = set(SIMULATED)
    made = simulation_of(log).model_dump(include=parts)
    other = _first_difference(config.model_dump(include=parts), made)
    if other is not None:
        raise InputRefused(log, f"was simulated with another {other}; use another folder for logs")


def _first_difference(wanted: object, made: object, at: str = "") -> str | None:
    """The key path of the first value that differs, None if none does."""
    if isinstance(wanted, Mapping) and isinstance(made, Mapping):
        for key in wanted:
            found = _first_difference(wanted[key], made.get(key), f"{at}.{key}" if at else key)
            if found is not None:
                return found
        return None
    return None if wanted == made else at


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

GRACE_S = 5.0
"""So long a child that is told to end may take to remove what it has half written."""

_STANDARD_OUTPUT = 1


class Children:
    """Starts processes, one for each piece of work; none outlives the ``with`` block."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._running: set[BaseProcess] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        running = tuple(self._running)
        for child in running:
            child.terminate()
        for child in running:
            child.join(GRACE_S)
            child.kill()

    def run(
        self,
        work: Callable[Arguments, Result],
        *arguments: Arguments.args,
        **keywords: Arguments.kwargs,
    ) -> Result:
        """What the work returns; may be called from several threads at a time.

        work: a function of a module. Raises SlamsimError with what the work raised, or with the
        code that its process ended with.
        """
        answers, out = self._context.Pipe(duplex=False)
        child = self._context.Process(
            target=_serve, args=(os.getpid(), out, work, arguments, keywords), daemon=True
        )
        child.start()
        self._running.add(child)
        out.close()
        try:
            done, answer = answers.recv()
        except EOFError:
            child.join()
            raise SlamsimError(f"its process ended with code {child.exitcode}") from None
        finally:
            child.join()
            self._running.discard(child)
        if not done:
            raise SlamsimError(str(answer))
        return cast(Result, answer)


@contextmanager
def each_done(
    jobs: Sequence[Callable[[Children], Result]], workers: int
) -> Iterator[Iterator[Result]]:
    """What the jobs return, as each is done, so many at a time, each in processes of its own.

    What a job raises is raised where its result is asked for; then, and when the block ends, jobs
    that wait are given up.
    """
    with ThreadPoolExecutor(workers) as threads, Children() as children:
        futures = [threads.submit(job, children) for job in jobs]
        try:
            yield (future.result() for future in as_completed(futures))
        finally:
            threads.shutdown(wait=False, cancel_futures=True)


def require_none_failed(failed: object) -> None:
    """Raise SlamsimError if some of a campaign could not be measured, once all else is told."""
    if failed:
        raise SlamsimError(f"{failed} failed, the rest is told above")


def keep_lines(folder: Path | None, name: str, rows: Iterable[Mapping[str, object]]) -> None:
    """All rows so far, a line of JSON each, in a file of the folder, if there is one."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        lines = (json.dumps(row) + "\n" for row in rows)
        write_atomic(folder / name, "".join(lines).encode())


def _serve(
    parent: int,
    out: Connection,
    work: Callable[..., object],
    arguments: tuple[object, ...],
    keywords: dict[str, object],
) -> None:
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the parent, which ends its children
    signal.signal(signal.SIGTERM, _end)
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STANDARD_OUTPUT)  # some libraries print
    try:
        out.send((True, work(*arguments, **keywords)))
    except SlamsimError as error:
        out.send((False, str(error)))
    except Exception as error:
        out.send((False, f"{type(error).__name__}: {error}"))


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)
