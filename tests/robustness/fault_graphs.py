"""Random pose graphs: uncertainties as GTSAM or long double has them, and no process that dies.

``python fault_graphs.py FIRST END`` solves the graphs with these numbers and prints a JSON line; it
is a program of its own so that a segmentation fault is seen.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import support_path  # noqa: F401
from graph_example import by_gtsam, by_long_double, chained, joined, off, wandering
from long_run_journal import Journal, Row

from slamsim.core.geometry import compose
from slamsim.guard.numbers import NoSolution
from slamsim.slam.backend.marginals import relative_covariances

BATCH = 100
AGREED = 1e-6
SMALL = 80
COMPARED = 6
"""Poses of each graph that GTSAM is asked about: it takes far longer than the whole."""


def deviation(seed: int) -> float | None:
    """How far one graph is off, in standard deviations, None where neither answer is known.

    One in twenty has up to 3,000 poses, the rest up to 80. Where GTSAM finds no solution, or
    another one, long double decides, if the graph is small enough for that.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 3000 if rng.random() < 0.05 else SMALL))
    poses = compose(rng.uniform(-1.0, 1.0, 3) * [2000.0, 2000.0, 3.0], wandering(rng, count))
    loops = rng.integers(0, count, (int(count * rng.uniform(0.0, 1.5) * (rng.random() < 0.8)), 2))
    loops = np.sort(loops[loops[:, 0] != loops[:, 1]], axis=1)
    pairs = [*chained(poses), *map(tuple, loops.tolist())]
    weak = tuple(pair for pair in pairs if rng.random() < 0.02)
    edges = joined(poses, pairs, weak, rng)
    some = sorted({int(k) for k in rng.integers(1, count, COMPARED)})
    found = relative_covariances(poses, edges, 0)
    deviation = None
    with suppress(RuntimeError):  # GTSAM's, of a system that it finds indeterminate
        deviation = off(found[some], by_gtsam(poses, edges, some))
    if count < SMALL and (deviation is None or deviation > AGREED):
        return off(found[1:], by_long_double(poses, edges)[1:])
    return deviation


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=10_000)


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    """As ``long_run.KINDS`` wants it."""
    starts = range(0, chosen.count, BATCH)
    todo = [first for first in starts if f"graphs from {first}" not in journal.names]
    with journal.progress("graphs", len(starts), len(starts) - len(todo)) as told:
        for first in todo:
            journal.add({"name": f"graphs from {first}", **_batch(first, first + BATCH)})
            told()
    cases = [journal.lines[f"graphs from {first}"] for first in starts]
    died = sum(case["died"] for case in cases)
    wrong = [seed for case in cases for seed in case["wrong"]]
    alone = sum(case["alone"] for case in cases)
    return [
        Row("processes that died", str(died), "0", died == 0),
        Row(f"off by more than {AGREED:g} sigma", str(wrong or 0), "0", not wrong),
        Row("largest deviation", f"{max(case['worst'] for case in cases):.2g} sigma"),
        Row("too large, and GTSAM found no solution", str(alone)),
    ]


def _batch(first: int, end: int) -> dict[str, object]:
    command = [sys.executable, str(Path(__file__)), str(first), str(end)]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode != 0:
        return {"died": 1, "wrong": [], "worst": 0.0, "alone": 0, "why": child.stderr[-300:]}
    return {"died": 0, **json.loads(child.stdout)}


def main() -> None:
    first, end = map(int, sys.argv[1:])
    found: dict[int, float | None] = {}
    for seed in range(first, end):
        try:
            found[seed] = deviation(seed)
        except NoSolution:
            found[seed] = np.inf
    known = {seed: value for seed, value in found.items() if value is not None}
    wrong = [seed for seed, value in known.items() if not value <= AGREED]
    worst = max([value for value in known.values() if np.isfinite(value)], default=0.0)
    told = {"wrong": wrong, "worst": worst, "alone": len(found) - len(known)}
    sys.stdout.write(f"{json.dumps(told)}\n")


if __name__ == "__main__":
    main()
