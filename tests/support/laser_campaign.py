"""How much worse a log is mapped when its laser is not as declared: one row for each error.

    PYTHONPATH=. python tests/support/laser_campaign.py LOG [--relations R] [--pairs 5] [--seed 1]
        [--only angle+,x-]

Errors of drivers, alone or in random pairs, beside the log as it is. Against relations the path of
the laser is scored, for where the axle lies, only the wheels tell; against the truth of a simulated
log that of the base too, and the laser's once more with the scale left free, for wheels that are
all larger explain ranges that are.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from itertools import combinations
from pathlib import Path

import numpy as np
from laser_errors import LaserErrors

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import compose, se2_from_se3
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray, Log, PlanarTrajectory
from slamsim.evaluate.relations import score_relations
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.io.open import read_log, read_truth
from slamsim.io.text.relations import read_relations
from slamsim.slam.session import run_slam

SICK_SWEEP_S = 0.0266
"""Two turns of the mirror of an LMS, for a log that declares no sweep."""

HEALTHY = LaserErrors()


def errors_of_drivers(sweep_s: float) -> dict[str, LaserErrors]:
    """What is to cost less than half of the healthy error again; sweep_s: as declared."""
    turn_rad = float(np.deg2rad(2.0))
    return {
        **{f"angle{s:+d}%": LaserErrors(angle_step=0.01 * s) for s in (1, -1)},
        **{f"offset{s:+d}cm": LaserErrors(range_offset_m=0.01 * s) for s in (5, -5)},
        **{f"scale{s:+d}%": LaserErrors(range_scale=0.01 * s) for s in (1, -1)},
        **{f"yaw{2 * s:+d}deg": LaserErrors(yaw_rad=turn_rad * s) for s in (1, -1)},
        **{f"x{s:+d}cm": LaserErrors(x_m=0.01 * s) for s in (10, -10)},
        "sweep": LaserErrors(sweep_s=2.0 * sweep_s or SICK_SWEEP_S),
        **({"no sweep": LaserErrors(sweep_s=0.0)} if sweep_s else {}),
    }


def in_pairs(single: dict[str, LaserErrors], count: int, seed: int) -> dict[str, LaserErrors]:
    """So many random pairs of errors of different kinds."""
    found = {f"{a} {b}": _both(single[a], single[b]) for a, b in combinations(single, 2)}
    kinds = [name for name, both in found.items() if len(_changed(both)) == 2]
    order = np.random.default_rng(seed).permutation(len(kinds))[:count]
    return {kinds[number]: found[kinds[number]] for number in order.tolist()}


def _changed(errors: LaserErrors) -> dict[str, float]:
    healthy = asdict(HEALTHY)
    return {name: value for name, value in asdict(errors).items() if value != healthy[name]}


def _both(one: LaserErrors, other: LaserErrors) -> LaserErrors:
    return LaserErrors(**(_changed(one) | _changed(other)))


def laser_path(slam: SlamResult) -> PlanarTrajectory:
    """T_map_laser, the laser sitting where it was found to."""
    assert slam.log is not None
    poses, mount = slam.trajectory.poses, se2_from_se3(slam.log.T_base_laser)
    placed = compose(poses, np.broadcast_to(mount, poses.shape))
    return PlanarTrajectory(slam.trajectory.stamps_ns, placed)


def scaled_rmse_m(estimate: FloatArray, truth: FloatArray) -> float:
    """RMSE of positions (n, 2) after the similarity that makes it least."""
    z, w = (xy[:, 0] + 1j * xy[:, 1] for xy in (estimate, truth))
    z, w = z - z.mean(), w - w.mean()
    return float(np.sqrt(np.mean(np.abs(z * (np.vdot(z, w) / np.vdot(z, z)) - w) ** 2)))


def scores_m(slam: SlamResult, log: Log, source: Path, relations: Path | None) -> dict[str, float]:
    """Errors in metres, the one to be compared first."""
    laser = laser_path(slam)
    if relations is not None:
        true = read_relations(relations)
        score = score_relations(laser, true.from_ns, true.to_ns, true.planar).all
        return {"laser": score.translation_mean_m}
    truth = read_truth(source)
    assert truth is not None
    base, mount = truth.planar(), se2_from_se3(log.T_base_laser)
    placed = compose(base.poses, np.tile(mount, (len(base), 1)))
    off = compare(laser, PlanarTrajectory(base.stamps_ns, placed))
    return {
        "laser": statistics(off.translation_m).rmse,
        "base": statistics(compare(slam.trajectory, base).translation_m).rmse,
        "scaled": scaled_rmse_m(off.estimate.poses[:, :2], off.truth.poses[:, :2]),
    }


def rows(given: argparse.Namespace) -> Iterator[str]:
    """The table, line by line."""
    log = read_log(given.log)
    wanted = errors_of_drivers(next(iter(log.scans)).geometry.duration_ns * 1e-9)
    if given.pairs:
        wanted = in_pairs(wanted, given.pairs, given.seed)
    if given.only:
        starts = tuple(given.only.split(","))
        wanted = {name: errors for name, errors in wanted.items() if name.startswith(starts)}
    healthy_m = 0.0
    for name, errors in {"healthy": HEALTHY, **wanted}.items():
        begun_s = time.process_time()
        slam = run_slam(errors.of(log), SlamConfig())
        found_m = scores_m(slam, log, given.log, given.relations)
        healthy_m = healthy_m or found_m["laser"]
        told = " ".join(f"{kind} {1e3 * size:.3f} mm" for kind, size in found_m.items())
        kinds = ", ".join(sorted({event.kind for event in slam.events})) or "no event"
        ratio, cpu_s = found_m["laser"] / healthy_m, time.process_time() - begun_s
        yield f"{name:<24} {ratio:5.2f} x  {told}  {kinds}  {cpu_s:.0f} s"


def main() -> None:
    """As the head of this file says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--relations", type=Path, default=None)
    parser.add_argument("--pairs", type=int, default=0, help="random pairs instead of single ones")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="beginnings of names, with commas")
    for row in rows(parser.parse_args()):
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
