"""The true motion between physics steps: what every sensor samples.

Between two steps positions, velocities and wheel angles run straight and orientations along
the shortest arc at a constant rate. An instant belongs to the interval that *ends* at or after
it, so that an answer never depends on where a drive was cut into windows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, slerp_xyzw
from slamsim.core.types import Drive, FloatArray, IntArray, OutsideTimeRange
from slamsim.guard.numbers import BadNumbers

MAX_SAMPLE_TURN_RAD = 0.004

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
        """The poses of a mounted frame from one instant to another, both covered."""
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
        cos_half = np.abs(_dot(quats[:-1], quats[1:]))
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


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.sum(a * b, axis=-1))


def _rotate(rotations: FloatArray, vector: FloatArray) -> FloatArray:
    """(k, 3) of (k, 3, 3) times (3,), term by term: a matrix product may round by batch size."""
    return np.asarray(
        rotations[:, :, 0] * vector[0]
        + rotations[:, :, 1] * vector[1]
        + rotations[:, :, 2] * vector[2]
    )
