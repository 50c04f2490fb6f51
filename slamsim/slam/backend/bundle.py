"""Bundle adjustment for a planar lidar: all views and all surfaces solved at once.

Unknowns are the poses of the key frames and the surfaces that two or more of their views share,
as straight lines with an offset and a turn each (Liu & Zhang 2021; Zhou, Wang & Kaess 2021). What
the front end matched is in the views and is not counted again: beside them stand odometry, and
closures too loose for their views to share surfaces.
Robust weights are those of Geman & McClure (1987), since doors open and people walk. How much
surfaces differ from straight lines beyond the noise of ranges is learnt from how views differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.models.blocks import factorise
from slamsim.models.line_bundle import (
    Moments,
    Seen,
    add_surfaces,
    fit_lines,
    moments_of,
    pose_rows,
    pull_to_lines,
    residuals,
    to_map,
)
from slamsim.models.supernodes import add_block, empty_system, make_panels
from slamsim.process.children import return_freed_memory
from slamsim.slam.backend.association import Shared, loose_closures, share_surfaces
from slamsim.slam.backend.marginals import add_edges, edge_covariances
from slamsim.slam.backend.surface_information import SurfaceInformation
from slamsim.slam.frontend.odometry import ELSEWHERE
from slamsim.slam.matching.surfaces import BEAMS, MEAN, SCATTER

ROUNDS = ((0.06, 12.0, 3), (0.03, 4.0, 10))
"""Associations: how far apart across a surface its observations may lie, from how many standard
deviations on they are doubted, and how many steps are taken."""

DOUBTED_BY_CHANCE = 0.86
"""By what the weights that normal noise gets in the last round make variances too large: the mean
weight times the asymptotic variance of the estimator (Huber 1981)."""

OTHER_WEIGHTS = 1.2
"""A system is made anew when the sum of all weights has grown or shrunk by this factor."""

OTHER_PLACE = 0.02
"""And after a step larger than this, metres or radians: levers and directions are others then."""

SMALL_STEP = 2e-5
"""Metres and radians: steps no larger than this end a round."""

MAX_BEND_M, MAX_BEND_RAD = 0.5, 0.35
ODOMETRY_SIGMAS = 7.0
LEAST_KNOWN = np.linalg.inv(ELSEWHERE)
"""Information about a step that odometry is far off from: as if the robot had been carried. By the
robust weight alone, which tends to zero, nothing would hold two parts of a map together."""

ROUGH_VIEWS = 4.0
"""That all surfaces are equally rough counts as much as so many views of each."""

LEAST_REDUNDANCY = 0.2
ROUGHNESS_M = (1e-5, 0.05)
MEDIAN_CHI2 = 2.0 * np.log(2.0)
"""Of two degrees of freedom."""


class NotRefined(SlamsimError):
    """A bundle adjustment whose result is not to be used, and why.

    bent_after: the key frame after which the trajectory would have to be bent farthest, if it is
    that which speaks against the result.
    """

    def __init__(self, message: str, bent_after: int | None = None) -> None:
        super().__init__(message)
        self.bent_after = bent_after


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """poses: (n, 3) T_map_base of the key frames. information: what holds them there."""

    poses: FloatArray
    information: SurfaceInformation


def refine(
    views: Sequence[Float32Array],
    poses: FloatArray,
    odometry: Sequence[GraphEdge],
    noise_m: float,
    edges: Sequence[GraphEdge],
    held: int = 1,
) -> Refined:
    """The most likely poses (n, 3) given what was seen from them, beginning at good ones.

    views: n of (k, PIECE_FIELDS). held: so many of the first poses stay. odometry: edges that join
    the others to the last of these and to one another, of wheels and gyroscope alone. noise_m:
    standard deviation of a range. edges: of the graph, which say what belongs together. Raises
    NotRefined for a result that is not to be used, NoSolution for equations that have none.
    """
    pieces = np.concatenate(views).astype(np.float64)
    moments = moments_of(pieces[:, MEAN], pieces[:, SCATTER], pieces[:, BEAMS], noise_m)
    bundle = None
    begun_at, closures = poses, loose_closures(edges, held)
    for gate_m, doubted_sigmas, steps in ROUNDS:
        shared = share_surfaces(views, poses, gate_m, edges)
        bundle = _Bundle(moments, shared, (odometry, closures), doubted_sigmas, held, begun_at)
        poses = bundle.relax(poses, steps)
    assert bundle is not None
    bundle.check(begun_at, poses)
    return Refined(poses, bundle.information(poses))


class _Bundle:
    """One association of views and surfaces, and the system that it makes."""

    def __init__(
        self,
        moments: Moments,
        shared: Shared,
        measured: tuple[Sequence[GraphEdge], Sequence[GraphEdge]],
        doubted_sigmas: float,
        held: int,
        begun_at: FloatArray,
    ) -> None:
        """measured: the odometry, and closures that no shared surfaces stand for. begun_at: (n, 3)
        of the views in the graph, where matches tell which wheels slipped."""
        edges, count = [*measured[0], *measured[1]], len(measured[0])
        self._count, self._held, self._doubted_sigmas = count, held, doubted_sigmas
        if len(shared.starts) < 2:
            raise NotRefined("no surface was seen from two key frames")
        self._points = moments.points_m[shared.pieces]
        self._variance = moments.variance[shared.pieces]
        self._shared, self._surfaces = shared, shared.surfaces
        # Poses that are held fixed share the last number: there is no unknown behind it.
        self._number = np.append(np.full(held, count), np.arange(count))
        self._sources = np.array([edge.source for edge in edges])
        self._targets = np.array([edge.target for edge in edges])
        self._measured = np.array([edge.T_source_target for edge in edges])
        weights = np.array([edge.weight for edge in edges])[:, None, None]
        covariances = edge_covariances(edges)
        self._driven = covariances[:count, [0, 1], [0, 1]].sum(axis=1) <= MAX_BEND_M**2
        believed = np.asarray(weights * np.linalg.inv(covariances), np.float64)
        self._known = _known(believed, self._edge_errors(begun_at), count)
        self._ends = self._number[np.stack([self._sources, self._targets], axis=1)]
        self._pairs = shared.pairs()
        pairs = np.concatenate([self._number[self._pairs], self._ends])
        self._panels = make_panels(pairs, count)
        self._weights = 0.5 / self._variance
        self._scaled = 2.0 * self._variance

    def relax(self, poses: FloatArray, steps: int) -> FloatArray:
        """Steps of Gauss and Newton; the system is kept while the weights stay alike."""
        self._weigh(poses)
        factor, weight, largest = None, 0.0, np.inf
        for _ in range(steps):
            now = float(self._weights.sum())
            alike = weight / OTHER_WEIGHTS < now < weight * OTHER_WEIGHTS
            if factor is None or not alike or largest > OTHER_PLACE:
                factor, keyframes = None, np.arange(self._held, len(poses))
                factor, weight = factorise(self._panels, self._system(poses), keyframes), now
            step = factor.solve(self._pull(poses))
            if not np.isfinite(step).all():
                raise NotRefined("a step of the refinement is not finite")
            poses = compose(poses, np.concatenate([np.zeros((self._held, 3)), step]))
            self._weigh(poses)
            largest = float(np.abs(step).max())
            if largest <= SMALL_STEP:
                break
        return poses

    def information(self, poses: FloatArray) -> SurfaceInformation:
        """What was seen and what was driven, each for itself."""
        steps = np.asarray(np.linalg.inv(self._known), np.float64)
        seen = self._surface_system(poses)
        seen /= DOUBTED_BY_CHANCE
        pairs = np.maximum(self._pairs - (self._held - 1), 0)
        pairs, poses = pairs[pairs[:, 0] < pairs[:, 1]], poses[self._held - 1 :]
        ends = np.stack([self._sources, self._targets], axis=1)[self._count :]
        drift, loose = np.split(steps, [self._count])
        closures = np.maximum(ends - (self._held - 1), 0), loose
        of_surfaces = self._panels, seen, pairs
        return SurfaceInformation.of(of_surfaces, drift, closures, poses, np.zeros_like(poses))

    def check(self, before: FloatArray, after: FloatArray) -> None:
        """Raise NotRefined unless the poses became more likely without being torn about.

        Where nothing tells how the robot came to a key frame, parts may move against each other.
        """
        was, now = self._cost(before), self._cost(after)
        if not now <= was:
            raise NotRefined(
                f"the refinement made the map less likely: cost {was:.6g} to {now:.6g}"
            )
        bent = between(between(before[:-1], before[1:]), between(after[:-1], after[1:]))
        bent[: self._held - 1] = 0.0
        bent[self._held - 1 :][~self._driven] = 0.0
        bent_m, bent_rad = np.hypot(bent[:, 0], bent[:, 1]), np.abs(bent[:, 2])
        excess = np.maximum(bent_m / MAX_BEND_M, bent_rad / MAX_BEND_RAD)
        if not np.all(excess <= 1.0):
            raise NotRefined(
                f"the refinement moved neighbouring key frames by {bent_m.max():.2f} m "
                f"and {np.rad2deg(bent_rad.max()):.1f} deg against each other",
                bent_after=int(np.argmax(excess)),
            )

    def _weigh(self, poses: FloatArray) -> None:
        """How rough surfaces are, and what each observation is worth."""
        squares = self._squares(poses)
        unknowns = 2.0 * len(self._shared.starts) + 3.0 * (self._count + 1)
        redundancy = max(1.0 - unknowns / (2.0 * len(squares)), LEAST_REDUNDANCY)
        roughness_m = _roughness(squares, self._variance, redundancy)
        self._scaled = 2.0 * (self._variance + roughness_m**2)
        self._scaled = self._scaled * self._rougher(squares / self._scaled)[self._surfaces]
        self._weights = _robust(squares / self._scaled, self._doubted_sigmas) / self._scaled

    def _squares(self, poses: FloatArray) -> FloatArray:
        """(k,) summed squares of both points of each observation."""
        points = to_map(self._points, self._shared.views, poses)
        lines = fit_lines(points, self._weights, self._shared.starts)
        return np.asarray(np.square(residuals(points, self._shared.starts, lines)).sum(axis=1))

    def _rougher(self, chi2: FloatArray) -> FloatArray:
        """(m,) how much more variance each surface shows than all do: round, moved, or clutter."""
        capped = np.minimum(chi2, self._doubted_sigmas**2)
        shown = 2.0 * ROUGH_VIEWS + np.bincount(self._surfaces, capped)
        free = 2.0 * ROUGH_VIEWS + 2.0 * np.diff(self._shared.starts) - 2.0
        return np.maximum(shown / free, 1.0)

    def _system(self, poses: FloatArray) -> FloatArray:
        """The information of everything about the poses, surfaces eliminated.

        Damped (Levenberg 1944), or parts of the map that hardly anything joins would be thrown
        about: no step leads farther than a robot that was carried may be.
        """
        system = self._surface_system(poses)
        add_edges(self._panels, system, self._ends, self._carry(poses), self._known)
        for unknown in range(self._count):
            add_block(self._panels, system, unknown, unknown, LEAST_KNOWN)
        return system

    def _surface_system(self, poses: FloatArray) -> FloatArray:
        """The same without the odometry."""
        return_freed_memory()  # else the system, 0.1 GB of a long drive, comes on top of it
        system = empty_system(self._panels)
        add_surfaces(self._seen(poses), self._panels, system)
        return system

    def _seen(self, poses: FloatArray) -> Seen:
        views, starts = self._shared.views, self._shared.starts
        points = to_map(self._points, views, poses)
        lines = fit_lines(points, self._weights, starts)
        # Held poses count as the last of them, whose number has no unknown behind it.
        rows = pose_rows(points, starts, lines, views, poses)
        return Seen(points, self._weights, starts, lines, rows, self._number[views][:, None])

    def _carry(self, poses: FloatArray) -> FloatArray:
        """(m, 3, 3) takes a small step of the source of each edge to its target."""
        return adjoint(between(poses[self._targets], poses[self._sources]))

    def _pull(self, poses: FloatArray) -> FloatArray:
        """(n - 1, 3) the right-hand side: where everything wants the poses to go."""
        pull = np.einsum("mij,mj->mi", self._known, self._edge_errors(poses))
        right = np.zeros((self._count + 1, 3))
        np.add.at(right, self._ends[:, 0], np.einsum("mji,mj->mi", self._carry(poses), pull))
        np.add.at(right, self._ends[:, 1], -pull)
        pull_to_lines(self._seen(poses), right)
        return right[:-1]

    def _edge_errors(self, poses: FloatArray) -> FloatArray:
        """(m, 3) what the poses add to the edges, as steps of their targets."""
        there = between(poses[self._sources], poses[self._targets])
        return np.asarray(between(self._measured, there))

    def _cost(self, poses: FloatArray) -> float:
        """Robust cost at given poses, as variances are by now.

        Of a weighted square w c with the weight of Geman & McClure, the cost is sqrt(w) c.
        """
        chi2 = self._squares(poses) / self._scaled
        seen = chi2 * np.sqrt(_robust(chi2, self._doubted_sigmas))
        error = self._edge_errors(poses)
        return float(seen.sum() + np.einsum("mi,mij,mj->", error, self._known, error))


def _known(believed: FloatArray, errors: FloatArray, driven: int) -> FloatArray:
    """(m, 3, 3) information of edges, given what is believed of them, less where they are off by
    many sigmas at the poses of the graph, since wheels slip, but never none of the first
    ``driven``, the odometry. errors: (m, 3).

    It stays as it is from there on: weighed anew at each step, the odometry of a long loop would
    give way in one place, where scans see little, and take up there all that the loop is off by
    (fr-clinic: 0.75 m between two key frames, where it is wrong by some centimetres).
    """
    chi2 = np.einsum("mi,mij,mj->m", errors, believed, errors)
    known = believed * _robust(chi2, ODOMETRY_SIGMAS)[:, None, None]
    known[:driven] += LEAST_KNOWN
    return np.asarray(known)


def _robust(chi2: FloatArray, sigmas: float) -> FloatArray:
    return np.asarray(1.0 / np.square(1.0 + chi2 / sigmas**2))


def _roughness(squares: FloatArray, variance: FloatArray, redundancy: float) -> float:
    """What to add to all standard deviations for the median residual to be what it should."""
    low, high = np.log(ROUGHNESS_M)
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        chi2 = squares / (2.0 * (variance + np.exp(2.0 * middle)))
        if float(np.median(chi2)) > MEDIAN_CHI2 * redundancy:
            low = middle
        else:
            high = middle
    return float(np.exp(middle))
