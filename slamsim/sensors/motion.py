"""The true motion between physics steps: what every sensor samples; one ray per beam of a lidar.

Between two steps positions, velocities and wheel angles run straight and orientations along
the shortest arc at a constant rate. An instant belongs to the interval that *ends* at or after
it, so that an answer never depends on where a drive was cut into windows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, slerp_xyzw
from slamsim.core.jit import kernel
from slamsim.core.types import Drive, Float32Array, FloatArray, IntArray, OutsideTimeRange
from slamsim.guard.numbers import BadNumbers

MAX_SAMPLE_TURN_RAD = 0.004
"""Keeps interpolated directions within 1e-6 rad (``PoseSamples``): 10 um at 10 m."""

MOST_STEP_NS = 60_000_000_000
"""Steps farther apart are no record of a motion, and would be sampled for ever."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSamples:
    """Instants between which a mounted frame may be interpolated element by element.

    stamps_ns: (m,). origin_m: (m, 3) of the frame in the map. x_axis, y_axis: (m, 3) its first
    two axes in the map. Between neighbours the frame turns by at most MAX_SAMPLE_TURN_RAD: a
    blended and normalised direction cuts the corner by turn^2 / 16 at most, here 1e-6 rad.
    """

    stamps_ns: IntArray
    origin_m: FloatArray
    x_axis: FloatArray
    y_axis: FloatArray


PoseOverride = Callable[[PoseSamples], PoseSamples]
"""From how a sensor is carried along to how it looks; only what is broken changes anything."""


def as_mounted(samples: PoseSamples) -> PoseSamples:
    """Of a healthy sensor: its poses as they are."""
    return samples


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The part of a drive that sensing needs at the moment."""

    drive: Drive

    def __post_init__(self) -> None:
        if len(self.drive) < 2:
            raise BadNumbers(f"a drive begins with at least two steps, not {len(self.drive)}")

    @property
    def covered_ns(self) -> int:
        """The last instant that is known."""
        return int(self.drive.stamps_ns[-1])

    def positions_at(self, stamps_ns: IntArray) -> FloatArray:
        """(k, 3) of the base in the map."""
        return self._straight(self.drive.positions_m, stamps_ns)

    def quats_xyzw_at(self, stamps_ns: IntArray) -> FloatArray:
        """(k, 4) orientation of the base in the map."""
        left, fraction = self._bracket(stamps_ns)
        quats = self.drive.quats_xyzw
        return slerp_xyzw(quats[left], quats[left + 1], fraction)

    def velocities_at(self, stamps_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3) linear, m/s, and (k, 3) angular, rad/s, of the base in map axes."""
        return (
            self._straight(self.drive.linear_velocity_m_s, stamps_ns),
            self._straight(self.drive.angular_velocity_rad_s, stamps_ns),
        )

    def wheel_angles_at(self, stamps_ns: IntArray) -> FloatArray:
        """(k, 2) cumulative angle of the left and the right wheel, rad."""
        return self._straight(self.drive.wheel_angles_rad, stamps_ns)

    def pose_samples(self, T_base_sensor: FloatArray, from_ns: int, to_ns: int) -> PoseSamples:
        """The poses of a mounted frame from one instant to another, both covered.

        T_base_sensor: (4, 4).
        """
        self._bracket(np.array([from_ns, to_ns]))
        stamps = self._sampled_stamps(from_ns, to_ns)
        rotation = matrix_from_xyzw(self.quats_xyzw_at(stamps))
        return PoseSamples(
            stamps,
            self.positions_at(stamps) + _rotate(rotation, T_base_sensor[:3, 3]),
            _rotate(rotation, T_base_sensor[:3, 0]),
            _rotate(rotation, T_base_sensor[:3, 1]),
        )

    def _sampled_stamps(self, from_ns: int, to_ns: int) -> IntArray:
        """Physics steps around a span, with more in between where the robot turns fast."""
        every = self.drive.stamps_ns
        first = max(int(np.searchsorted(every, from_ns, side="left")) - 1, 0)
        last = int(np.searchsorted(every, to_ns, side="left"))
        stamps, quats = every[first : last + 1], self.drive.quats_xyzw[first : last + 1]
        cos_half = np.abs(np.sum(quats[:-1] * quats[1:], axis=-1))
        turn_rad = 2.0 * np.arccos(np.minimum(cos_half, 1.0))
        pieces = np.maximum(np.ceil(turn_rad / MAX_SAMPLE_TURN_RAD).astype(np.int64), 1)
        if pieces.max(initial=1) == 1:
            return stamps
        start, span = np.repeat(stamps[:-1], pieces), np.repeat(np.diff(stamps), pieces)
        piece = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        finer = start + span * piece // np.repeat(pieces, pieces)
        return np.unique(np.append(finer, stamps[-1]))

    def _straight(self, values: FloatArray, stamps_ns: IntArray) -> FloatArray:
        left, fraction = self._bracket(stamps_ns)
        step = values[left + 1] - values[left]
        return np.asarray(values[left] + fraction[:, None] * step)

    def _bracket(self, stamps_ns: IntArray) -> tuple[IntArray, FloatArray]:
        every = self.drive.stamps_ns
        if stamps_ns.size and (stamps_ns.min() < every[0] or stamps_ns.max() > every[-1]):
            raise OutsideTimeRange(
                f"the motion covers {every[0]}..{every[-1]} ns, "
                f"asked for {stamps_ns.min()}..{stamps_ns.max()} ns"
            )
        left = np.maximum(np.searchsorted(every, stamps_ns, side="left") - 1, 0)
        left = np.minimum(left, every.size - 2)
        span = (every[left + 1] - every[left]).astype(np.float64)
        return left, (stamps_ns - every[left]) / span


def joined(before: Motion | None, window: Drive) -> Motion:
    """The motion with one more window; raises BadNumbers if it does not follow on."""
    stamps_ns = window.stamps_ns
    if before is not None:
        stamps_ns = np.concatenate([[before.covered_ns], stamps_ns])
    if np.diff(stamps_ns).max(initial=0) > MOST_STEP_NS:
        raise BadNumbers(f"a drive has a step at least every {MOST_STEP_NS * 1e-9:g} s")
    whole = window if before is None else _concatenated(before.drive, window)
    return Motion(whole)


def kept_since(motion: Motion, needed_ns: int) -> Motion:
    """Only what look-ups at needed_ns and later use, and never less than two steps."""
    stamps = motion.drive.stamps_ns
    first = int(np.searchsorted(stamps, needed_ns, side="left")) - 1
    first = min(max(first, 0), stamps.size - 2)
    kept = {f.name: getattr(motion.drive, f.name)[first:] for f in fields(Drive)}
    return Motion(Drive(**kept))


def _concatenated(before: Drive, window: Drive) -> Drive:
    both = {
        f.name: np.concatenate([getattr(before, f.name), getattr(window, f.name)])
        for f in fields(Drive)
    }
    return Drive(**both)


def _rotate(rotations: FloatArray, vector: FloatArray) -> FloatArray:
    """(k, 3) of (k, 3, 3) times (3,), term by term: a matrix product may round by batch size."""
    return np.asarray(
        rotations[:, :, 0] * vector[0]
        + rotations[:, :, 1] * vector[1]
        + rotations[:, :, 2] * vector[2]
    )


def beam_rays(
    samples: PoseSamples, beam_ns: IntArray, directions: FloatArray, origin_m: FloatArray
) -> Float32Array:
    """(n, 6) rays (origin, unit direction) of n beams that fire at beam_ns in the map frame.

    directions: (2, n) cosine and sine of each beam's angle in the laser's x-y plane. All
    instants lie within the samples. Ray origins are relative to origin_m (3,), which keeps them
    exact in single precision.
    """
    rays = np.empty((beam_ns.size, 6), dtype=np.float32)
    origins = samples.origin_m - origin_m
    _fill(rays, samples.stamps_ns, origins, samples.x_axis, samples.y_axis, beam_ns, *directions)
    return rays


@kernel
def _fill(
    rays: Float32Array,
    knot_ns: IntArray,
    knot_origin: FloatArray,
    knot_x: FloatArray,
    knot_y: FloatArray,
    beam_ns: IntArray,
    cosines: FloatArray,
    sines: FloatArray,
) -> None:
    left = 0
    last = knot_ns.size - 2
    for beam in range(beam_ns.size):
        now = beam_ns[beam]
        while left > 0 and knot_ns[left] >= now:
            left -= 1
        while left < last and knot_ns[left + 1] < now:
            left += 1
        later = (now - knot_ns[left]) / (knot_ns[left + 1] - knot_ns[left])
        sooner = 1.0 - later
        squared = 0.0
        for axis in range(3):
            x = sooner * knot_x[left, axis] + later * knot_x[left + 1, axis]
            y = sooner * knot_y[left, axis] + later * knot_y[left + 1, axis]
            direction = cosines[beam] * x + sines[beam] * y
            squared += direction * direction
            rays[beam, 3 + axis] = direction
            origin = sooner * knot_origin[left, axis] + later * knot_origin[left + 1, axis]
            rays[beam, axis] = origin
        scale = 1.0 / np.sqrt(squared)
        for axis in range(3, 6):
            rays[beam, axis] *= scale


@kernel
def cosines_of_incidence(rays: Float32Array, normals: Float32Array) -> Float32Array:
    """(n,) |cosine| between each ray (n, 6) and the normal (n, 3) of what it hits."""
    cosines = np.empty(rays.shape[0], dtype=np.float32)
    for ray in range(rays.shape[0]):
        dot = (
            rays[ray, 3] * normals[ray, 0]
            + rays[ray, 4] * normals[ray, 1]
            + rays[ray, 5] * normals[ray, 2]
        )
        cosines[ray] = abs(dot)
    return cosines
