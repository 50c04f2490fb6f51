"""Every loader fed by atheris, which looks for bytes that take a way through it not seen before.

Each in turn, in a child of its own: the library is optional, ``pip install -e '.[fuzz]'``. What it
learns stays in the corpus, so that the next run begins where this one ended. A find, which is
anything but an answer or SlamsimError, is written down once for each place in the code.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import support_path  # noqa: F401
from fault_fuzz import Target
from long_run_journal import Journal, Row

from slamsim.guard.errors import SlamsimError

INSTRUMENTED = (
    "slamsim.config",
    "slamsim.dataset.make.identity",
    "slamsim.dataset.catalogue.statistics",
    "slamsim.dataset.recipe.model",
    "slamsim.dataset.recipe.distributions",
    "slamsim.dataset.store.lazy_table",
    "slamsim.io",
    "slamsim.guard",
    "slamsim.sim.drive.route_file",
    "slamsim.sim.robot.urdf",
    "slamsim.slam.backend.columns",
    "slamsim.slam.mapping.saved_map",
    "slamsim.world.map_server",
    "rosbags.serde",
    "rosbags.typesys",
)
"""No kernels: their byte code must stay as it is."""
LONGEST_BYTES = 1 << 16
LONGEST_S, MOST_MIB = 30, 1500


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=20.0, help="for each loader")
    parser.add_argument("--loaders", default="", help="only those whose names hold this")
    parser.add_argument("--campaign", type=int, default=1, help="another number, once more")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    if importlib.util.find_spec("atheris") is None:
        return [Row("atheris", "is not installed: pip install -e '.[fuzz]'", "installed", False)]
    from fault_fuzz_targets import TARGETS

    names = [name for name in TARGETS if chosen.loaders in name]
    left = [name for name in names if f"{chosen.campaign}/{name}" not in journal.names]
    with journal.progress("atheris", len(names), len(names) - len(left)) as told:
        for found in fed(left, chosen.out / "atheris", chosen.minutes * 60.0):
            journal.add({**found, "name": f"{chosen.campaign}/{found['name']}"})
            told()
    lines = [journal.lines[f"{chosen.campaign}/{name}"] for name in names]
    rows = [
        Row(name, f"{line['runs']:,} inputs, {line['reached']:,} places in the code")
        for name, line in zip(names, lines, strict=True)
    ]
    finds = [f"{line['name']}: {find}" for line in lines for find in line["finds"]]
    total = sum(line["runs"] for line in lines)
    rows.append(Row("all", f"{total:,} inputs of {len(lines)} loaders"))
    return [*rows, Row("finds", "; ".join(finds) or "0", "0", not finds)]


def fed(names: Sequence[str], place: Path, seconds: float) -> Iterator[dict[str, Any]]:
    """Of each loader its name, runs and reached: how many inputs, how many places in the code;
    finds: what was found, in words."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as scratch:
        child = subprocess.Popen(
            [sys.executable, __file__, str(place), f"{seconds:.0f}", *names],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "TMPDIR": scratch},
        )
        with child:
            assert child.stdout is not None
            for name, line in zip(names, child.stdout, strict=False):
                yield {"name": name, **_summary(place / _slug(name), int(line))}


def _summary(place: Path, code: int) -> dict[str, Any]:
    told = (place / "told").read_text(encoding="utf-8", errors="replace")
    runs = [int(number) for number in re.findall(r"^#(\d+)", told, re.MULTILINE)]
    reached = [int(number) for number in re.findall(r" ft: (\d+)", told)]
    finds = sorted(path.name for path in (place / "finds").iterdir())
    if code:
        finds.append(f"ended by {code}: {told.strip()[-300:]}")
    return {"runs": max(runs, default=0), "reached": max(reached, default=0), "finds": finds}


def _slug(name: str) -> str:
    return re.sub(r"\W+", "-", name)


def _main(place: Path, seconds: str, names: Sequence[str]) -> None:
    """Each in a fork of this process, in which all is imported already."""
    import atheris

    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        from fault_fuzz_targets import TARGETS
    for name in names:
        folder = place / _slug(name)
        for part in ("corpus", "finds"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        process = os.fork()
        if process == 0:
            told = os.open(folder / "told", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(told, 1)
            os.dup2(told, 2)
            _feed(TARGETS[name], folder, seconds)
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        sys.stdout.write(f"{code}\n")
        sys.stdout.flush()


def _feed(target: Target, folder: Path, seconds: str) -> None:
    """Never comes back."""
    import atheris

    corpus, finds, words = (folder / part for part in ("corpus", "finds", "words"))
    for data in target.seeds():
        (corpus / hashlib.sha1(data).hexdigest()).write_bytes(data)
    words.write_text("".join(f"{_quoted(token)}\n" for token in target.tokens))

    def one(data: bytes) -> None:
        try:
            target.run(data)
        except SlamsimError:
            return
        except Exception as error:
            place = finds / f"{_place(error)}.bin"
            if not place.exists() or place.stat().st_size > len(data):
                place.write_bytes(data)

    atheris.Setup(
        [
            sys.argv[0],
            str(corpus),
            f"-max_total_time={seconds}",
            f"-max_len={LONGEST_BYTES}",
            f"-timeout={LONGEST_S}",
            f"-report_slow_units={LONGEST_S}",
            f"-rss_limit_mb={MOST_MIB}",
            f"-artifact_prefix={finds}/",
            "-seed=1",
            *([f"-dict={words}"] if target.tokens else []),
        ],
        one,
    )
    atheris.Fuzz()


def _quoted(token: str) -> str:
    return '"' + token.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _place(error: Exception) -> str:
    """Type of the error and the innermost line of ours that it passed."""
    frames: Iterable[traceback.FrameSummary] = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/slamsim/" in frame.filename] or list(frames)
    return f"{type(error).__name__}-{Path(ours[-1].filename).stem}-{ours[-1].lineno}"


if __name__ == "__main__":
    _main(Path(sys.argv[1]), sys.argv[2], sys.argv[3:])
