"""Runs what may crash, hang or eat memory in a forked child, and says what came of each try."""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import resource
import select
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from slamsim.guard.errors import DiskFull, InputRefused, SlamsimError

HANG_S = 10.0
_STARVED = 4.0
"""A busy machine: without an answer a child may take so many times as long as its own seconds."""
MOST_BYTES = 700 << 20
"""What one try may take beyond what the process holds before, 0.3 GiB once all is imported: with
it less than 1 GiB."""
CLOSING_S = 2.0
_LONGEST_MESSAGE = 3000

Outcome = Literal[
    "right", "other", "refused", "odd", "silent", "signal", "hang", "memory", "open files"
]
GOOD: tuple[Outcome, ...] = ("right", "other", "refused")
"""other: a sane value that is not that of the whole input, where nothing could tell."""


@dataclass(frozen=True, slots=True)
class Try:
    """judge: says of what ``run`` gave whether it is right, other or silent; None: right."""

    name: str
    run: Callable[[], object]
    judge: Callable[[object], Outcome] | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """detail: the refusal, or where and how it failed. seconds: of the processor.

    peak_bytes: beyond what was held before.
    """

    name: str
    outcome: Outcome
    detail: str = ""
    seconds: float = 0.0
    peak_bytes: int = 0

    @property
    def good(self) -> bool:
        return self.outcome in GOOD


def judged(tries: Sequence[Try], hang_s: float = HANG_S) -> Iterator[Verdict]:
    """A verdict on each, in order. One child runs them all; where it dies another goes on."""
    done = 0
    while done < len(tries):
        for verdict in _by_one_child(tries[done:], hang_s):
            done += 1
            yield verdict


def attempt(tried: Try) -> Verdict:
    """Here and now, without protection: for the child, and to look at one try closely."""
    held, files = _start_peak(), _open_files()
    begun_s = time.process_time()
    outcome, detail = _outcome(tried)
    seconds = time.process_time() - begun_s
    peak = max(_status_bytes("VmHWM") - held, 0)
    if outcome in GOOD and peak > MOST_BYTES:
        outcome, detail = "memory", f"{peak >> 20} MiB; {detail}"
    if outcome in GOOD and _stay_open(files):
        outcome = "open files"
    return Verdict(tried.name, outcome, detail, round(seconds, 4), peak)


def _stay_open(files: int) -> bool:
    """Whether more files than so many are open. Threads of Arrow close theirs after the call that
    reads has ended, which takes a moment where their code has yet to come from the disk."""
    until_s = time.monotonic() + CLOSING_S
    if _open_files() > files:
        gc.collect()
    while _open_files() > files:
        if time.monotonic() > until_s:
            return True
        time.sleep(0.01)
    return False


def _outcome(tried: Try) -> tuple[Outcome, str]:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        try:
            value = tried.run()
            outcome = "right" if tried.judge is None else tried.judge(value)
            detail = ""
        except SlamsimError as refusal:
            outcome, detail = _refused(refusal)
        except Exception as error:
            outcome, detail = "odd", _place(error)
    numeric = [w for w in seen if issubclass(w.category, RuntimeWarning)]
    if numeric and outcome in GOOD:
        at = f"{Path(numeric[0].filename).name}:{numeric[0].lineno}"
        return "odd", f"warned of {numeric[0].message} at {at}"
    return outcome, detail


def _refused(refusal: SlamsimError) -> tuple[Outcome, str]:
    """A refusal is one clear sentence about the file, and was no lack of memory or space."""
    message, kind = str(refusal), type(refusal).__name__
    cause: BaseException | None = refusal
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "memory", f"refused for lack of memory: {message[:300]}"
        cause = cause.__cause__ or cause.__context__
    if isinstance(refusal, DiskFull):
        return "odd", f"{kind}: {message[:300]}"
    parts = [message, *getattr(refusal, "also", ())]
    if not message.strip() or sum(map(len, parts)) > _LONGEST_MESSAGE:
        return "odd", f"a message of {len(message)} characters: {message[:200]}"
    if not all(line.isprintable() for line in message.split("\n")):
        return "odd", f"a message with control characters: {message[:300]!r}"
    if isinstance(refusal, InputRefused) and not refusal.reason.strip():
        return "odd", f"a refusal without a reason: {message[:300]}"
    return "refused", f"{kind}: {message[:300]}"


def _place(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "slamsim" in frame.filename] or frames
    where = ", ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in ours[-3:])
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]} ({where})"


def _by_one_child(tries: Sequence[Try], hang_s: float) -> Iterator[Verdict]:
    """Verdicts until all are done or the child died, the last then being on what killed it."""
    sys.stdout.flush()
    sys.stderr.flush()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _live(tries, writer)
    os.close(writer)
    done, rest = 0, b""
    try:
        while done < len(tries):
            if not _heard(reader, child, hang_s):
                yield Verdict(tries[done].name, "hang", f"nothing for {hang_s:g} s", hang_s)
                return
            block = os.read(reader, 1 << 16)
            if not block:
                yield Verdict(tries[done].name, "signal", _death(child))
                return
            *lines, rest = (rest + block).split(b"\n")
            for line in lines:
                done += 1
                yield Verdict(**json.loads(line))
    finally:
        os.close(reader)
        _end(child)


def _heard(reader: int, child: int, hang_s: float) -> bool:
    """Whether the child says something before it has worked for so long, or was silent for long."""
    begun_s, worked_s = time.monotonic(), _worked_s(child)
    while not select.select([reader], [], [], 0.1 * hang_s)[0]:
        waited_s = time.monotonic() - begun_s
        if _worked_s(child) - worked_s > hang_s or waited_s > _STARVED * hang_s:
            return False
    return True


def _worked_s(child: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{child}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _live(tries: Sequence[Try], writer: int) -> None:
    """The child's whole life."""
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        nothing = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nothing, descriptor)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        most = _status_bytes("VmData") + (2 << 30)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        gc.collect()  # files that the parent left to it would be closed, and counted, at any time
        for tried in tries:
            line = json.dumps(asdict(attempt(tried))).encode() + b"\n"
            while line:
                line = line[os.write(writer, line) :]
        os._exit(0)
    finally:
        os._exit(1)


_ended: dict[int, int] = {}


def _death(child: int) -> str:
    """What the child died of, in words."""
    status = os.waitpid(child, 0)[1]
    _ended[child] = status
    if os.WIFSIGNALED(status):
        return f"died of {signal.Signals(os.WTERMSIG(status)).name}"
    return f"ended itself with code {os.WEXITSTATUS(status)}"


def _end(child: int) -> None:
    if _ended.pop(child, None) is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _start_peak() -> int:
    """Sets the peak back to what is held now, which it gives (bytes)."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _status_bytes("VmRSS")


def _status_bytes(field: str) -> int:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) << 10
    raise ValueError(field)


def _open_files() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208, it is counted, not listed
