"""The long runs: ``python tests/robustness/long_run.py KIND [options]``.

Every kind writes one JSON line per case into its file below ``outputs/long_run`` and goes on
where it was stopped. It ends with a table of what came out and what should; exit code 1 if a
target is missed.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

import support_path  # noqa: F401
from long_run_journal import Journal, shown

from slamsim.console.reporter import Reporter

KINDS: dict[str, str] = {
    "disk": "fault_nth",
    "mutations": "fault_mutations",
    "kills": "fault_kills",
    "stops": "fault_stops",
    "sealed": "fault_sealed",
    "atheris": "fault_atheris",
    "corpus": "fault_corpus",
    "promise": "promise",
    "graphs": "fault_graphs",
}
"""Each names a module with ``options(parser)`` and ``run(chosen, journal) -> list[Row]``."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    for kind, name in KINDS.items():
        module = importlib.import_module(name)
        of_kind = kinds.add_parser(kind, help=(module.__doc__ or "").split("\n")[0])
        of_kind.add_argument("--out", type=Path, default=Path("outputs/long_run"))
        of_kind.set_defaults(run=module.run)
        module.options(of_kind)
    chosen = parser.parse_args()
    reporter = Reporter()
    rows = chosen.run(chosen, Journal(chosen.out / f"{chosen.kind}.jsonl", reporter))
    reporter.table(chosen.kind, shown(rows))
    return int(any(row.met is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
