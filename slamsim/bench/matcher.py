"""``slamsim bench matcher``: basin of convergence and covariance of a single match.

Scans of a log are matched with a local map that was laid at reference poses: the true ones of a
simulated log, those that SLAM found for a real one. Where the prediction is put wrong on purpose,
the share of matches that come back to the reference is the basin of convergence. Where it is
right, the matches' errors are compared with what they claim (NEES) and with the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.logs import simulation_of
from slamsim.config.loading import load_world_config
from slamsim.config.slam import FrontEndConfig, SlamConfig
from slamsim.core.geometry import between, compose
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Cloud, FloatArray, IntArray, Log, PlanarTrajectory
from slamsim.evaluate.bound import ScanBound, trajectory_bound
from slamsim.evaluate.trajectory import covered_by
from slamsim.io.open import read_log, read_truth
from slamsim.simulation.own_files import WORLD
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.frontend.motion import predict_motion
from slamsim.slam.matching import Match, Matcher, make_matcher
from slamsim.slam.session import run_slam
from slamsim.world.build import build_world

DISTANCES_M = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)
TURNS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
"""Edges of the classes that offsets are counted in."""

HOME_M, HOME_RAD = 0.05, float(np.deg2rad(1.0))
"""A match this near to the reference has come home."""


def random_offsets(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) offsets, each class as likely as another, to all sides."""
    away_m = _within_a_class(rng, DISTANCES_M, count)
    turn = np.deg2rad(_within_a_class(rng, TURNS_DEG, count)) * rng.choice([-1.0, 1.0], count)
    side = rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([away_m * np.cos(side), away_m * np.sin(side), turn])


Share = dict[str, float | None]
"""One class: ``to_m`` and ``to_deg``, ``tried``, and the ``share`` that came home."""


class Basin:
    """Counts of tries and of those that came home, per class of distance and turn."""

    def __init__(self) -> None:
        self._tried = np.zeros((len(DISTANCES_M) - 1, len(TURNS_DEG) - 1), dtype=np.int64)
        self._home = np.zeros_like(self._tried)

    def add(self, off: FloatArray, error: FloatArray | None) -> None:
        """off: (3,) of the prediction. error: (3,) of the match, None where there was none."""
        at = _class_of(DISTANCES_M, float(np.hypot(off[0], off[1])))
        turned = _class_of(TURNS_DEG, float(np.rad2deg(abs(off[2]))))
        self._tried[at, turned] += 1
        if error is not None:
            home = np.hypot(error[0], error[1]) <= HOME_M and abs(error[2]) <= HOME_RAD
            self._home[at, turned] += bool(home)

    def shares(self) -> list[Share]:
        """One entry per class, distance by distance; share: None where nothing was tried."""
        tried, home = self._tried.tolist(), self._home.tolist()
        return [
            {
                "to_m": DISTANCES_M[i + 1],
                "to_deg": TURNS_DEG[j + 1],
                "tried": tried[i][j],
                "share": home[i][j] / tried[i][j] if tried[i][j] else None,
            }
            for i in range(len(DISTANCES_M) - 1)
            for j in range(len(TURNS_DEG) - 1)
        ]


def basin_rows(plain: Sequence[Share], searched: Sequence[Share]) -> dict[str, str]:
    """A row per distance: the shares of both, in per cent, turn by turn."""
    turns = len(TURNS_DEG) - 1
    rows = {"turned up to": "".join(f"{f'{deg:g} deg':>10}" for deg in TURNS_DEG[1:])}
    for first in range(0, len(plain), turns):
        pairs = zip(plain[first : first + turns], searched[first : first + turns], strict=True)
        cells = [f"{_percent(a['share'])}/{_percent(b['share'])}" for a, b in pairs]
        rows[f"up to {plain[first]['to_m']:g} m"] = "".join(f"{cell:>10}" for cell in cells)
    return rows


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.0f}"


def _within_a_class(rng: np.random.Generator, edges: Sequence[float], count: int) -> FloatArray:
    number: IntArray = rng.integers(0, len(edges) - 1, count)
    low, high = np.array(edges)[number], np.array(edges)[number + 1]
    return np.asarray(rng.uniform(low, high))


def _class_of(edges: Sequence[float], value: float) -> int:
    return int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))


SCANS = 60
"""So many scans of a log, evenly spread, are tried."""

OFFSETS_PER_SCAN = 30
LEAST_PATH_M = 2.0
"""A scan is tried when the map knows at least so much of the way."""

LOOSE = np.diag(np.square([0.1, 0.1, 0.05]))
"""Prior of the matches whose errors are looked at: next to what a scan tells, nothing."""

SMALL_OFF = np.array([0.02, 0.02, 0.01])
"""Standard deviations of a prediction by odometry from one scan to the next: x and y in m, yaw in
rad."""


@dataclass(frozen=True, slots=True)
class MatcherFigures:
    """plain, searched: shares of matches that came home, as ``Basin.shares`` gives them. single:
    errors and consistency of matches from good predictions."""

    log: str
    reference: str
    plain: list[Share]
    searched: list[Share]
    single: Figures


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """One scan before it enters the map: the matcher may be copied and asked anything."""

    cloud: Cloud
    T_map_base: FloatArray
    matcher: Matcher


def measure_matcher(path: Path, config: SlamConfig, progress: Progress = silent) -> MatcherFigures:
    """Basin of convergence, errors and consistency of single matches on a recording.

    path: a run's folder or any recording. Raises what reading it and SLAM raise.
    """
    log = read_log(path)
    truth = read_truth(path)
    if truth is None:
        result = run_slam(log, config)
        reference, log = result.trajectory, result.log or log
    else:
        reference = truth.planar()
    rng = np.random.default_rng(0)
    plain, searched = Basin(), Basin()
    errors: list[FloatArray] = []
    claimed: list[FloatArray] = []
    stamps_ns: list[int] = []
    trials = _trials(log, reference, config.front_end)
    for number, trial in enumerate(trials):
        progress(number + 1, SCANS)
        _try_offsets(trial, rng, plain, searched)
        match = _match_near(trial, rng)
        if match is not None:
            errors.append(between(match.T_map_base, trial.T_map_base))
            claimed.append(match.information)
            stamps_ns.append(trial.cloud.stamp_ns)
    bound = None if truth is None else _scan_bound(path, log, reference, np.array(stamps_ns))
    return MatcherFigures(
        log=str(path),
        reference="slam" if truth is None else "truth",
        plain=plain.shares(),
        searched=searched.shares(),
        single=_single(np.array(errors), np.array(claimed), bound),
    )


def _trials(log: Log, reference: PlanarTrajectory, config: FrontEndConfig) -> Iterator[_Trial]:
    """Scans along the log, each with a map of what was seen before it."""
    motion = predict_motion(log)
    matcher = make_matcher(config)
    stamps_ns = np.array([scan.stamp_ns for scan in log.scans], dtype=np.int64)
    every = max(1, len(stamps_ns) // SCANS)
    inside = covered_by(reference.stamps_ns, stamps_ns)
    T_map_key: FloatArray | None = None
    path_m = 0.0
    for number, scan in enumerate(log.scans):
        if not inside[number] or not _covers(motion, *scan.span_ns):
            continue
        T_map_base = reference.at(np.array([scan.stamp_ns]))[0]
        due = number % every == every - 1 and path_m >= LEAST_PATH_M
        moved = np.full(3, np.inf) if T_map_key is None else between(T_map_key, T_map_base)
        entering = _is_keyscan(moved, config)
        if not (due or entering):
            continue
        cloud = deskew(scan, motion, scan.stamp_ns, log.T_base_laser)
        if due:
            yield _Trial(cloud, T_map_base, matcher)
        if entering:
            path_m += 0.0 if T_map_key is None else float(np.hypot(moved[0], moved[1]))
            matcher.insert(cloud, T_map_base)
            T_map_key = T_map_base


def _covers(motion: PlanarTrajectory, first_ns: int, last_ns: int) -> bool:
    low, high = min(first_ns, last_ns), max(first_ns, last_ns)
    return bool(low >= motion.stamps_ns[0] and high <= motion.stamps_ns[-1])


def _is_keyscan(moved: FloatArray, config: FrontEndConfig) -> bool:
    far = np.hypot(moved[0], moved[1]) >= config.local_map.keyscan_distance_m
    return bool(far or abs(moved[2]) >= np.deg2rad(config.local_map.keyscan_turn_deg))


def _try_offsets(trial: _Trial, rng: np.random.Generator, plain: Basin, searched: Basin) -> None:
    """Match from predictions that are off, and that say by how much they may be."""
    for off in random_offsets(rng, OFFSETS_PER_SCAN):
        matcher = deepcopy(trial.matcher)  # a match teaches the matcher what is usual
        guess = compose(trial.T_map_base, off)
        doubt = np.maximum([np.hypot(off[0], off[1]), np.hypot(off[0], off[1]), abs(off[2])], 0.02)
        covariance = np.diag(np.square(doubt))
        near = matcher.match(trial.cloud, guess, covariance)
        found = matcher.search(trial.cloud, guess, covariance)
        best = max((one for one in (near, found) if one), key=lambda one: one.fit, default=None)
        plain.add(off, None if near is None else between(trial.T_map_base, near.T_map_base))
        searched.add(off, None if best is None else between(trial.T_map_base, best.T_map_base))


def _match_near(trial: _Trial, rng: np.random.Generator) -> Match | None:
    """A match from a prediction as good as predictions are."""
    guess = compose(trial.T_map_base, SMALL_OFF * rng.normal(size=3))
    return deepcopy(trial.matcher).match(trial.cloud, guess, LOOSE)


def _single(errors: FloatArray, claimed: FloatArray, bound: ScanBound | None) -> Figures:
    """errors: (k, 3) of single matches in the base frame. claimed: (k, 3, 3) information."""
    if not len(errors):
        return {"matches": 0}
    off_m = np.hypot(errors[:, 0], errors[:, 1])
    held = (np.linalg.eigvalsh(claimed)[:, 0] > 0.0) & np.isfinite(claimed).all(axis=(1, 2))
    nees = np.einsum("ki,kij,kj->k", errors, claimed, errors)[held]
    figures: Figures = {
        "matches": len(errors),
        "rmse_m": float(np.sqrt(np.mean(off_m**2))),
        "median_m": float(np.median(off_m)),
        "rmse_mrad": float(1e3 * np.sqrt(np.mean(errors[:, 2] ** 2))),
        "nees_median": float(np.median(nees)) if nees.size else None,
        "nees_mean": float(nees.mean()) if nees.size else None,
        "nees_expected": 3,
    }
    if bound is not None:
        bound_m = float(np.sqrt(np.mean(bound.position_m**2)))
        bound_rad = float(np.sqrt(np.mean(bound.heading_rad**2)))
        figures["bound_m"], figures["bound_mrad"] = bound_m, 1e3 * bound_rad
        figures["rmse_over_bound"] = float(np.sqrt(np.mean(off_m**2))) / bound_m
    return figures


def _scan_bound(
    path: Path, log: Log, truth: PlanarTrajectory, stamps_ns: IntArray
) -> ScanBound | None:
    """What these scans could tell at best, each alone in a perfectly known world."""
    if not (path / WORLD).is_file() or not stamps_ns.size:
        return None
    config = simulation_of(path)
    world = build_world(load_world_config(str(path / WORLD)), seed=0)
    motion = predict_motion(log)
    bound = trajectory_bound(
        world.solids.section(float(log.T_base_laser[2, 3])),
        truth,
        PlanarTrajectory(stamps_ns, motion.at(stamps_ns)),
        log.T_base_laser,
        config.sensors,
        config.robot.drive_wheels.track_m,
    )
    return None if bound is None else bound.scans
