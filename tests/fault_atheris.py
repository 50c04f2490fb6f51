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
from collections.abc import Iterable
from pathlib import Path

from long_run_journal import Journal, Row

INSTRUMENTED = (
    "slamsim.config",
    "slamsim.dataset.identity",
    "slamsim.dataset.manifest",
    "slamsim.dataset.recipe",
    "slamsim.dataset.distributions",
    "slamsim.dataset.table",
    "slamsim.logs",
    "slamsim.safe",
    "slamsim.sim.route_file",
    "slamsim.sim.urdf",
    "slamsim.slam.columns",
    "slamsim.slam.saved_map",
    "slamsim.world.map_server",
    "rosbags.serde",
    "rosbags.typesys",
)
"""No kernels: their byte code must stay as it is."""
LONGEST_BYTES = 1 << 16
LONGEST_S, MOST_MIB = 30, 1500
_KINDS = {70: "signal", 71: "memory", 77: "signal"}


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=20.0, help="for each loader")
    parser.add_argument("--loaders", default="", help="only those whose names hold this")
    parser.add_argument("--campaign", type=int, default=1, help="another number, once more")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    if importlib.util.find_spec("atheris") is None:
        return [Row("atheris", "is not installed: pip install -e '.[fuzz]'", "installed", False)]
    from fault_fuzz_targets import TARGETS

    names = [name for name in TARGETS if chosen.loaders in name]
    done = {name: f"{chosen.campaign}/{name}" for name in names}
    with journal.progress("atheris", len(names)) as told:
        for name in names:
            if done[name] not in journal.names:
                found = fed(name, chosen.out / "atheris", chosen.minutes * 60.0)
                journal.add({"name": done[name], **found})
            told()
    lines = [journal.lines[done[name]] for name in names]
    rows = [
        Row(name, f"{line['runs']:,} inputs, {line['reached']:,} places in the code")
        for name, line in zip(names, lines, strict=True)
    ]
    finds = [f"{line['name']}: {find}" for line in lines for find in line["finds"]]
    total = sum(line["runs"] for line in lines)
    rows.append(Row("all", f"{total:,} inputs of {len(lines)} loaders"))
    return [*rows, Row("finds", "; ".join(finds) or "0", "0", not finds)]


def fed(name: str, place: Path, seconds: float) -> dict[str, object]:
    """runs, reached: how many inputs, how many places. finds: what was found, in words."""
    slug = re.sub(r"\W+", "-", name)
    corpus, finds = (place / slug / part for part in ("corpus", "finds"))
    for folder in (corpus, finds):
        folder.mkdir(parents=True, exist_ok=True)
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as scratch:
        done = subprocess.run(
            [sys.executable, __file__, name, str(corpus), str(finds), f"{seconds:.0f}"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            check=False,
            env={**os.environ, "TMPDIR": scratch},
        )
    told = done.stderr
    runs = [int(number) for number in re.findall(r"^#(\d+)", told, re.MULTILINE)]
    reached = [int(number) for number in re.findall(r" ft: (\d+)", told)]
    words = sorted(path.stem for path in finds.iterdir())
    if done.returncode:
        words.append(f"{_KINDS.get(done.returncode, 'death')}: {told.strip()[-300:]}")
    return {"runs": max(runs, default=0), "reached": max(reached, default=0), "finds": words}


def _main(name: str, corpus: Path, finds: Path, seconds: str) -> None:
    import atheris

    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        from fault_fuzz_targets import TARGETS

        from slamsim.safe.errors import SlamsimError
    target = TARGETS[name]
    for data in target.seeds():
        (corpus / hashlib.sha1(data).hexdigest()).write_bytes(data)
    words = finds.parent / "words"
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
    _main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
