"""How a lidar moved, by its scans alone.

Nothing else in the recording is believed: no gyroscope, no wheels, no transform. Scans are
matched within short windows, and what the lidar declares of its beams is estimated along.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.geometry import adjoint, between, inverse
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import RawScans
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_bundle import (
    LEAST_LEFT,
    MADE_UP_TIMES,
    Shape,
    ShapePull,
    WindowFit,
    fit_windows,
)
from slamsim.slam.laser.scan_equations import POSE, SHAPES
from slamsim.slam.laser.scan_scale import rough_angle_scale, rough_sweep_s
from slamsim.slam.laser.scan_sweep import local_motion, velocity_weights
from slamsim.slam.laser.scan_track import LaserTrack, track_window
from slamsim.slam.laser.scan_windows import period_s
from slamsim.slam.matching.surfaces import X, Y

MAX_PASSES = 6
MIN_SCANS = 5
MOST_LOST = 8
"""So many windows are tried before scans that nowhere follow each other are given up."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Multiples of this, less their whole part, lie evenly however many of them there are."""
UNMODELLED_SWEEP, UNMODELLED_ANGLE, UNMODELLED_M = 0.002, 4e-5, 5e-4
ANGLE_BY_ROUNDING_PER_M, OFFSET_BY_ROUNDING = 0.06, 0.2
"""By what the shape of simulated scans comes out wrong beyond its noise: motion in a sweep is no
polynomial, edges and slanted walls answer a little late, ranges are rounded. Sweep and angle as
shares."""


@dataclass(frozen=True, slots=True, eq=False)
class BundledWindow:
    """Scans of a few seconds in one frame.

    scans: (n,) their indices in the recording. middle_ns: (n,) when each scan's middle beam fired,
    as the scan declares. T_window_laser: (n, 3) the laser at that instant, in the frame of the
    first scan. covariance: (3n, 3n) of small steps of each laser in its own frame, the first scan
    being exact. inlier_share: (n,) share of the surfaces of each scan that fit.
    """

    scans: IntArray
    middle_ns: IntArray
    T_window_laser: FloatArray
    covariance: FloatArray
    inlier_share: FloatArray

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """(n - 1, 3) motion from each scan to the next, and its information (n - 1, 3, 3) as a
        small step of the later laser in its own frame."""
        T_first_second = between(self.T_window_laser[:-1], self.T_window_laser[1:])
        return T_first_second, _step_information(T_first_second, self.covariance)


@dataclass(frozen=True, slots=True)
class ShapeEstimate:
    """A number of the beams that overlapping scans tell, and what the lidar declares.

    sigma: infinite where nothing tells it.
    """

    value: float
    sigma: float
    declared: float


@dataclass(frozen=True, slots=True, eq=False)
class ShapeBias:
    """By how much sweep, angle scale and range offset come out wrong (3,), and how unsure that is
    (3,). The angle scale: beyond the rough one."""

    numbers: FloatArray
    sigmas: FloatArray


UNBIASED = ShapeBias(np.zeros(SHAPES), np.zeros(SHAPES))


@dataclass(frozen=True, slots=True, eq=False)
class ScanMotions:
    """What the scans of one lidar say of its motion and of themselves.

    metres_per_unit: by what ranges were multiplied to make a room of them; 1 unless they are in
    no metres. Windows are in the recorded unit. radians_per_unit: likewise for angles.
    sweep_s, span_rad: from the first beam of the first scan to the last, as they were found.
    angle_step: true over declared, 1 where it is right; windows are as the true one has them.
    rough_angle_scale: the part of it that was found before all was refined. range_offset_m: by how
    much ranges are too long.
    contradicted: (3,) whether the scans contradict what is declared of sweep, angle step and
    offset; windows are as they then are. path_by_offset_per_m: by which share a path grows for each
    metre that ranges are taken to be longer than they should. range_noise_m: as seen in the
    median window, nan without one. weak: why there is little or nothing.
    """

    topic: str
    windows: tuple[BundledWindow, ...]
    metres_per_unit: float
    radians_per_unit: float
    span_rad: float
    sweep_s: ShapeEstimate
    angle_step: ShapeEstimate
    rough_angle_scale: float
    range_offset_m: ShapeEstimate
    contradicted: BoolArray
    path_by_offset_per_m: float
    range_noise_m: float
    weak: str = ""

    @property
    def shape(self) -> FloatArray:
        """(3,) sweep, angle step and range offset as found."""
        return np.array([self.sweep_s.value, self.angle_step.value, self.range_offset_m.value])

    @property
    def first(self) -> IntArray:
        """(m,) index of the earlier scan of each step from one scan of a window to the next."""
        return _joined([window.scans[:-1] for window in self.windows]).astype(np.int64)

    @property
    def second(self) -> IntArray:
        """(m,) index of the later scan."""
        return _joined([window.scans[1:] for window in self.windows]).astype(np.int64)

    @property
    def T_first_second(self) -> FloatArray:  # noqa: N802
        """(m, 3) motion between the middle beams of both."""
        steps = [window.steps()[0] for window in self.windows]
        return np.concatenate(steps) if steps else np.zeros((0, 3))

    @property
    def information(self) -> FloatArray:
        """(m, 3, 3) of a small step of the later laser in its own frame."""
        steps = [window.steps()[1] for window in self.windows]
        return np.concatenate(steps) if steps else np.zeros((0, 3, 3))

    @property
    def window(self) -> IntArray:
        """(m,) the window of each step."""
        sizes = [len(window.scans) - 1 for window in self.windows]
        return np.repeat(np.arange(len(sizes)), sizes)


def window_motions(
    scans: RawScans,
    windows: list[IntArray],
    bias: ShapeBias = UNBIASED,
    angle_scale: float | None = None,
) -> ScanMotions:
    """The motion of a lidar by its scans alone.

    windows: each (k,) indices of scans in a row, a few seconds of them (``choose_windows``). bias:
    of the shape, which is taken off. angle_scale: the ``rough_angle_scale`` that is known from
    elsewhere; None looks for it.
    """
    reader = BeamReader(scans, 1.0 if angle_scale is None else angle_scale)

    tracks = _tracked(scans, reader, windows)

    first = _as_declared(tracks, reader)

    def look(some: list[IntArray], scale: float) -> list[WindowFit]:
        other = BeamReader(scans, scale)
        return _as_declared(_tracked(scans, other, some), other)

    if angle_scale is None:
        angle_scale = rough_angle_scale(tracks, first, abs(reader.span_rad), look)

    if angle_scale != reader.angle_scale:
        reader = BeamReader(scans, angle_scale)
        tracks = _tracked(scans, reader, windows)
        first = _as_declared(tracks, reader)

    shape, fits, pulls = _fit(tracks, reader, first, bias)

    return _motions(scans, reader, (tracks, fits), (shape, bias), pulls)


def _tracked(scans: RawScans, reader: BeamReader, windows: list[IntArray]) -> list[LaserTrack]:
    """Windows in which some scans follow each other, in the order of the file.

    Those looked at first lie all over the recording: where none of them does, none will.
    """
    stamps = (scans.stamps_ns, period_s(scans.stamps_ns))
    places = np.argsort(np.arange(len(windows)) * GOLDEN % 1.0, kind="stable").tolist()
    tracks: dict[int, LaserTrack] = {}
    for looked_at, place in enumerate(places):
        if looked_at == MOST_LOST and not tracks:
            break
        track = track_window(reader, windows[place], stamps)
        if len(track.scans) >= MIN_SCANS:
            tracks[place] = track
    return [tracks[place] for place in sorted(tracks)]


def _as_declared(tracks: list[LaserTrack], reader: BeamReader) -> list[WindowFit]:
    """All windows bundled with the shape of the scans as it is declared."""
    return fit_windows(tracks, Shape(reader.declared_sweep_s, 1.0, 0.0))


def _fit(
    tracks: list[LaserTrack], reader: BeamReader, fits: list[WindowFit], bias: ShapeBias
) -> tuple[Shape, list[WindowFit], ShapePull]:
    """All windows with the shape of the scans that fits best; fits: as it is declared.

    Numbers become unknowns one after the other, what is contradicted most first: seen with an
    offset of 3 cm, angles that are right look 0.3 % wrong, 3.4 sigmas.
    """
    declared = Shape(reader.declared_sweep_s, 1.0, 0.0)
    expected = Shape(*(declared.numbers + bias.numbers).tolist())
    shape = replace(declared, sweep_s=rough_sweep_s(tracks, fits, declared.sweep_s))
    free = shape.numbers != declared.numbers
    if free.any():
        fits = fit_windows(tracks, shape)
    pull = ShapePull.of(fits)
    for _ in range(MAX_PASSES):
        unmodelled = np.hypot(_unmodelled(shape, reader, pull, (tracks, fits)), bias.sigmas)
        doubts = np.where(free, 0.0, pull.doubts(shape, expected, unmodelled))
        free |= (doubts > 1.0) & (doubts == doubts.max())
        step = pull.step(free)
        if pull.still(step):
            break
        shape = shape.moved(step)
        fits = fit_windows(tracks, shape, fits)
        pull = ShapePull.of(fits)
    return shape, fits, pull


def _motions(
    scans: RawScans,
    reader: BeamReader,
    windows: tuple[list[LaserTrack], list[WindowFit]],
    found: tuple[Shape, ShapeBias],
    pull: ShapePull,
) -> ScanMotions:
    shape, bias = found
    given_up = shape.numbers != np.array([reader.declared_sweep_s, 1.0, 0.0])
    best = shape.moved(np.where(given_up, pull.step(given_up), pull.step()))
    unmodelled = np.hypot(_unmodelled(best, reader, pull, windows), bias.sigmas)
    sigmas = np.hypot(pull.sigmas(), unmodelled)
    sweep_s, angle_scale, range_offset_m = (best.numbers - bias.numbers).tolist()
    unit = reader.metres_per_unit
    return ScanMotions(
        topic=scans.topic,
        windows=tuple(
            _window(reader, track, fit, unit) for track, fit in zip(*windows, strict=True)
        ),
        metres_per_unit=unit,
        radians_per_unit=reader.radians_per_unit,
        span_rad=angle_scale * reader.span_rad,
        sweep_s=ShapeEstimate(sweep_s, sigmas[0], reader.declared_sweep_s),
        angle_step=ShapeEstimate(
            angle_scale * reader.angle_scale, sigmas[1] * reader.angle_scale, 1.0
        ),
        rough_angle_scale=reader.angle_scale,
        range_offset_m=ShapeEstimate(range_offset_m, sigmas[2], 0.0),
        contradicted=given_up | np.array([False, reader.angle_scale != 1.0, False]),
        path_by_offset_per_m=_path_by_offset(windows[1]),
        range_noise_m=float(np.median([one.noise_m for one in windows[0]] or [np.nan])),
        weak="" if windows[0] else "scans do not fit one another",
    )


def _unmodelled(
    shape: Shape,
    reader: BeamReader,
    pull: ShapePull,
    windows: tuple[list[LaserTrack], list[WindowFit]],
) -> FloatArray:
    """(3,) standard deviation of the numbers of a shape beyond what noise makes, and of the sweep
    what noise of the velocities adds, as lines add to poses, and by how much it is too short."""
    sigma_s, share = float(pull.sigmas()[0]), made_up_sweep(*windows)
    left = 1.0 - MADE_UP_TIMES * share
    by_velocities = np.sqrt(1.0 / max(left, LEAST_LEFT) - 1.0) * sigma_s if left < 1.0 else 0.0
    return np.array(
        [
            np.hypot(np.hypot(UNMODELLED_SWEEP, share) * shape.sweep_s, by_velocities),
            UNMODELLED_ANGLE + ANGLE_BY_ROUNDING_PER_M * reader.rounding_m,
            UNMODELLED_M + OFFSET_BY_ROUNDING * reader.rounding_m,
        ]
    )


def made_up_sweep(tracks: list[LaserTrack], fits: list[WindowFit]) -> float:
    """Share of what tells the sweep that is noise of the velocities: it makes sweeps too short, as
    it does any slope over what is not exactly known (attenuation, Fuller 1987)."""
    told = made_up = 0.0
    for track, fit in zip(tracks, fits, strict=True):
        lever_m = float(np.median(np.hypot(*np.concatenate(track.pieces)[:, [X, Y]].T)))
        shifts = np.array([1.0, 1.0, lever_m**2])
        velocity = local_motion(fit.poses, track.elapsed_s)[:, 0]
        weights, of = velocity_weights(track.elapsed_s), (len(fit.poses), POSE) * 2
        noise = np.einsum("ij,jaka,ik->ia", weights, fit.covariance().reshape(of), weights)
        share = float((noise @ shifts).sum() / max((velocity**2 @ shifts).sum(), 1e-12))
        told += fit.information[0, 0]
        made_up += fit.information[0, 0] * min(share, 1.0)
    return made_up / told if told > 0.0 else 0.0


def _window(reader: BeamReader, track: LaserTrack, fit: WindowFit, unit: float) -> BundledWindow:
    scale = np.tile([1.0 / unit, 1.0 / unit, 1.0], len(track.scans))
    return BundledWindow(
        scans=track.scans,
        middle_ns=reader.middle_ns(track.scans),
        T_window_laser=fit.poses * scale[:3],
        covariance=fit.covariance() * scale[:, None] * scale,
        inlier_share=fit.inlier_share,
    )


def _path_by_offset(fits: list[WindowFit]) -> float:
    """What a shorter range makes of the way from scan to scan: its share per metre, each step
    weighed as it is known. Where a single wall is all that is seen, an offset moves the laser along
    it by any length, and that is no path."""
    grown = squared = 0.0
    for fit in fits:
        T_first_second = between(fit.poses[:-1], fit.poses[1:])
        information = _step_information(T_first_second, fit.covariance())
        backward = inverse(T_first_second)
        followed = np.concatenate([np.zeros((1, 3)), fit.by_shape[:, 2].reshape(-1, 3)])
        change = followed[1:] - np.einsum("nij,nj->ni", adjoint(backward), followed[:-1])
        way = -backward * [1.0, 1.0, 0.0]
        known = np.einsum("ni,nij->nj", way, information)
        grown += float((known * change).sum())
        squared += float((known * way).sum())
    return grown / squared if squared > 0.0 else 0.0


def _step_information(T_first_second: FloatArray, covariance: FloatArray) -> FloatArray:
    """A step of the first laser moves the second by the adjoint of the inverse motion."""
    information = np.zeros((len(T_first_second), 3, 3))
    for k, carried in enumerate(adjoint(inverse(T_first_second))):
        jacobian = np.hstack([-carried, np.eye(3)])
        block = slice(3 * k, 3 * k + 6)
        information[k] = np.linalg.inv(jacobian @ covariance[block, block] @ jacobian.T)
    # Of a step that one direction hardly tells the rounding of the inverse is no longer small.
    return np.asarray(0.5 * (information + np.swapaxes(information, 1, 2)))


def _joined(parts: list[IntArray]) -> IntArray:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
