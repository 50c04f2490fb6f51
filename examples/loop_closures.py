"""Learns on a produced data set whether two scans show one place, and asks it of real logs.

    slamsim dataset make examples/loop_closures.yaml -n 40 --out loops
    python examples/loop_closures.py loops --log fr079.clf.bz2 --relations fr079.relations

A logistic regression over a dozen features of two scans that were laid over each other
(scan_pairs.py). It is judged by the area under the ROC curve on worlds that it has never seen and
on real recordings whose truth are hand-verified relations, beside two features used alone: how
many points fit, as a matcher scores it, and the difference of the ranges.
"""

from __future__ import annotations

import argparse
import sys
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scan_pairs
from scan_pairs import View, overlap, pair_features, view_of

import slamsim.dataset
from slamsim.core.geometry import between, compose, inverse
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, FloatArray, Log, Scan
from slamsim.dataset.store.reader import Sequence as DatasetSequence
from slamsim.io.open import read_log
from slamsim.io.text.relations import Relations, read_relations

SEEN_AGAIN = 0.3
"""A pair shows one place if each scan has so much of the other; not if neither has NOT_SEEN."""
NOT_SEEN = 0.1
LATER_S = 30.0
FAR_M, LOOSE_M = 10.0, 0.5
PENALTY = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """features: (n, f). same: (n,) whether the two scans show one place."""

    features: FloatArray
    same: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Logistic regression over features less their means, in units of their deviations."""

    means: FloatArray
    deviations: FloatArray
    weights: FloatArray

    def scores(self, features: FloatArray) -> FloatArray:
        """(n,) the larger, the more likely one place; above 0 more likely than not."""
        return np.asarray(_with_one((features - self.means) / self.deviations) @ self.weights)


def fit(examples: Examples) -> Model:
    """By Newton's method, with a small penalty on the weights."""
    means, deviations = examples.features.mean(axis=0), examples.features.std(axis=0) + 1e-9
    inputs = _with_one((examples.features - means) / deviations)
    weights = np.zeros(inputs.shape[1])
    penalty = PENALTY * len(inputs) * np.diag([*np.ones(inputs.shape[1] - 1), 0.0])
    for _ in range(25):
        chances = 1.0 / (1.0 + np.exp(-inputs @ weights))
        slope = inputs.T @ (chances - examples.same) + penalty @ weights
        bend = (inputs * (chances * (1.0 - chances))[:, None]).T @ inputs + penalty
        weights -= np.linalg.solve(bend + 1e-9 * np.eye(len(bend)), slope)
    return Model(means, deviations, weights)


def roc_auc(scores: FloatArray, same: BoolArray) -> float:
    """The chance that a pair of one place scores above one of two places; ties count half."""
    positive, negative = scores[same], np.sort(scores[~same])
    below = np.searchsorted(negative, positive, side="left")
    up_to = np.searchsorted(negative, positive, side="right")
    return float((below + up_to).sum() / (2.0 * positive.size * negative.size))


def of_sequences(sequences: Iterable[DatasetSequence], most: int) -> Examples:
    """Of each sequence at most so many pairs of either kind."""
    pairs = list[tuple[View, View, bool]]()
    for sequence in sequences:
        scans = sequence.scans
        layout, row = scans.layout(0), int(str(sequence.row["index"]))
        ranges_m = np.asarray(scans.ranges_m, dtype=np.float64)
        bearings = layout.angle_min_rad + layout.angle_step_rad * np.arange(
            ranges_m.shape[1], dtype=np.float64
        )
        random = random_stream(row, "pairs")
        for a, b, same in _chosen(sequence, most, random):
            views = view_of(ranges_m[a], bearings), view_of(ranges_m[b], bearings)
            if views[0] is not None and views[1] is not None:
                pairs.append((views[0], views[1], same))
    return _examples(pairs)


def _chosen(
    sequence: DatasetSequence, most: int, random: np.random.Generator
) -> list[tuple[int, int, bool]]:
    """Scans that close a loop, and as many that have nothing in common."""
    truth = sequence.truth.pairs
    every = np.column_stack([truth["scan_a"], truth["scan_b"]])
    closing = every[truth["closes_loop"]]
    known = set(map(tuple, every.tolist()))
    keys = np.unique(every)
    others = [(a, b) for a in keys for b in keys if a < b and (a, b) not in known]
    apart = np.array(others).reshape(-1, 2)
    number = min(most, len(closing), len(apart))
    return [
        (int(a), int(b), same)
        for pairs, same in ((closing, True), (apart, False))
        for a, b in random.permutation(pairs)[:number]
    ]


def of_log(log: Log, relations: Relations, most: int) -> Examples:
    """Of a real log; relations say where two scans were taken as seen from each other."""
    stamps = set(relations.from_ns.tolist()) | set(relations.to_ns.tolist())
    views = {scan.stamp_ns: _view(scan) for scan in log.scans if scan.stamp_ns in stamps}
    random = random_stream(0, "pairs of a log")
    T_base_laser = _planar(log.T_base_laser)
    again = [
        (a, b, between(T_base_laser, compose(T_a_b, T_base_laser)))
        for a, b, T_a_b in zip(
            relations.from_ns.tolist(), relations.to_ns.tolist(), relations.planar, strict=True
        )
        if abs(b - a) > LATER_S * 1e9
    ]
    same = [pair for pair in again if _shares(views, pair, scan_pairs.NEAR_M).min() >= SEEN_AGAIN]
    apart = [pair for pair in again if _shares(views, pair, LOOSE_M).max() < NOT_SEEN]
    apart += _far_apart(_placed(relations), views, most, random)
    chosen = [
        (views[pair[0]], views[pair[1]], kind)
        for pairs, kind in ((same, True), (apart, False))
        for pair in (pairs[place] for place in random.permutation(len(pairs))[:most])
    ]
    return _examples([(a, b, kind) for a, b, kind in chosen if a is not None and b is not None])


Pair = tuple[int, int, FloatArray]
"""Two stamps, and the second laser in the frame of the first."""


def _placed(relations: Relations) -> dict[int, FloatArray]:
    """Poses of all scans that hang together by relations with the most frequent one."""
    links: dict[int, list[tuple[int, FloatArray]]] = {}
    for a, b, T_a_b in zip(
        relations.from_ns.tolist(), relations.to_ns.tolist(), relations.planar, strict=True
    ):
        links.setdefault(a, []).append((b, T_a_b))
        links.setdefault(b, []).append((a, inverse(T_a_b)))
    first = max(links, key=lambda stamp: len(links[stamp]))
    placed, waiting = {first: np.zeros(3)}, deque([first])
    while waiting:
        here = waiting.popleft()
        for there, T_here_there in links[here]:
            if there not in placed:
                placed[there] = compose(placed[here], T_here_there)
                waiting.append(there)
    return placed


def _far_apart(
    placed: dict[int, FloatArray],
    views: dict[int, View | None],
    most: int,
    random: np.random.Generator,
) -> list[Pair]:
    """Pairs of one building that are far from each other and see nothing in common."""
    stamps, found = list(placed), list[Pair]()
    for a, b in random.choice(stamps, (20 * most, 2)).tolist():
        T_a_b = between(placed[a], placed[b])
        pair = (a, b, T_a_b)
        far = np.hypot(*T_a_b[:2]) > FAR_M
        if far and _shares(views, pair, LOOSE_M).max() < NOT_SEEN:
            found.append(pair)
        if len(found) == most:
            break
    return found


def _shares(views: dict[int, View | None], pair: Pair, near_m: float) -> FloatArray:
    a, b = views[pair[0]], views[pair[1]]
    if a is None or b is None:
        return np.array([0.0, 1.0])  # neither one place nor two
    return np.array(overlap(b, a, pair[2], near_m))


def _view(scan: Scan) -> View | None:
    return view_of(scan.ranges_m.astype(np.float64), scan.geometry.angles_rad())


def _planar(T: FloatArray) -> FloatArray:
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def _examples(pairs: Sequence[tuple[View, View, bool]]) -> Examples:
    features = np.array([pair_features(a, b) for a, b, _ in pairs])
    return Examples(
        features.reshape(-1, len(scan_pairs.FEATURES)),
        np.array([same for _, _, same in pairs], dtype=np.bool_),
    )


def _with_one(features: FloatArray) -> FloatArray:
    return np.column_stack([features, np.ones(len(features))])


def report(name: str, model: Model, examples: Examples) -> tuple[float, float, float]:
    """One line: the model's area under the curve, and those of the two features alone."""
    same = examples.same
    if same.all() or not same.any():
        raise SystemExit(f"{name}: no pairs of both kinds")
    areas = (
        roc_auc(model.scores(examples.features), same),
        roc_auc(examples.features[:, scan_pairs.SCORE], same),
        roc_auc(-examples.features[:, scan_pairs.RANGES], same),
    )
    right = float(((model.scores(examples.features) > 0.0) == same).mean())
    numbers = "  ".join(f"{area:.3f}" for area in areas)
    sys.stdout.write(f"{name:24} {same.sum():5} {(~same).sum():5}   {numbers}   {right:.3f}\n")
    return areas


def main(arguments: Sequence[str] | None = None) -> None:
    """The whole experiment."""
    parser = argparse.ArgumentParser(description="Learn which pairs of scans show one place.")
    parser.add_argument("dataset", help="folder or URL of a data set with the format parquet")
    parser.add_argument("--log", action="append", default=[], type=Path, help="a real log")
    parser.add_argument("--relations", action="append", default=[], type=Path, help="its truth")
    parser.add_argument("--pairs", default=30, type=int, help="of either kind in a sequence")
    given = parser.parse_args(arguments)
    dataset = slamsim.dataset.open(given.dataset)
    model = fit(of_sequences(dataset.split("train"), given.pairs))
    sys.stdout.write("pairs                     same  apart  model  score  ranges  right\n")
    report("simulated, test split", model, of_sequences(dataset.split("test"), given.pairs))
    for log, relations in zip(given.log, given.relations, strict=True):
        examples = of_log(read_log(log), read_relations(relations), 10 * given.pairs)
        report(f"real, {log.name}", model, examples)
    for name, weight in zip(scan_pairs.FEATURES, model.weights, strict=False):
        sys.stdout.write(f"{weight:+7.2f}  {name}\n")


if __name__ == "__main__":
    main()
