"""Checks of numbers: finite, within a useful magnitude, ordered, of the right shape.

The constructors of the values that cross a stage ask here, so that no stage has to: what is not
finite can neither enter one nor leave it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import SlamsimError, shown

MOST = 1e9
"""No metre, radian, second or any rate of them is larger: squares then stay exact to a part in a
million of what a map resolves, and nothing that is built of them can overflow."""

MOST_NS = 2**62
"""No stamp is farther from zero, 146 years: the difference of any two fits into 64 bits."""

FINITE = float(np.finfo(np.float64).max)
"""The bound of numbers that may have any size, such as information."""

FARTHEST_MOUNT_M = 1000.0
"""No vehicle is longer; what is, is an error of units or of frames."""
UNIT_WITHIN = 1e-2
"""A quaternion whose length is not nearer to one is no rotation."""

MOST_COUNT = 2**53
"""Larger integers are not exact in floating point."""

MOST_TURN = 1e3
"""Radians: no lidar declares an angle beyond it, in whatever unit."""

LEAST_SIZE_M = 1e-6
"""Wheels, tracks and cells are no smaller: they are divided by."""

Shape = tuple[int | None, ...]


class BadNumbers(SlamsimError, ValueError):
    """Numbers that no stage can work with: not finite, too large, out of order, misshapen."""


class NoSolution(SlamsimError, np.linalg.LinAlgError):
    """Equations that hold nothing, or contradict themselves: a matrix without an inverse.

    keyframe: number of the one at which that was seen, if it is known.
    """

    def __init__(self, message: str, keyframe: int | None = None) -> None:
        super().__init__(message)
        self.keyframe = keyframe


@contextmanager
def solving(what: str) -> Iterator[None]:
    """Inside, equations without a solution raise NoSolution, whichever library solves them."""
    try:
        yield
    except (np.linalg.LinAlgError, FloatingPointError, ZeroDivisionError) as error:
        raise NoSolution(f"{what} has no solution: {error}") from error
    except RuntimeError as error:  # scipy's word for it
        if "singular" not in str(error):
            raise
        raise NoSolution(f"{what} has no solution: {error}") from error


def as_json(what: str, values: Mapping[str, object]) -> bytes:
    """As a file holds it. Raises BadNumbers for one that is not finite, which JSON cannot hold."""
    try:
        return (json.dumps(values, indent=2, allow_nan=False) + "\n").encode()
    except ValueError as error:
        raise BadNumbers(f"{what} holds a number that is not finite: {error}") from error


def is_sound(values: NDArray[Any], most: float = MOST) -> NDArray[np.bool_]:
    """(n,) which rows of (n, ...) hold nothing but numbers of at most that size."""
    sound = np.abs(values) <= most
    return np.asarray(sound.all(axis=tuple(range(1, sound.ndim))), dtype=np.bool_)


def require_array(what: str, values: object, shape: Shape, kinds: str = "f") -> None:
    """Raise BadNumbers unless values are an array of such numbers, None standing for any size."""
    if not isinstance(values, np.ndarray) or values.dtype.kind not in kinds:
        raise BadNumbers(f"{what}: {_words(kinds)} are needed, not {_type_of(values)}")
    if values.shape != shape and not _fits(values.shape, shape):
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        raise BadNumbers(f"{what}: an array of ({wanted}) is needed, not of {values.shape}")


def require_finite(what: str, values: object, shape: Shape, most: float = MOST) -> None:
    """Raise BadNumbers unless values are an array of such a shape without an unsound number."""
    require_array(what, values, shape)
    assert isinstance(values, np.ndarray)
    # No number is larger than the root of the sum of all squares, which costs the least to know.
    if float(np.vdot(values, values)) <= min(most * most, FINITE):
        return
    if not np.abs(values).max() <= most:
        bad = np.flatnonzero(~is_sound(values, most))
        first = shown(values[bad[0]].tolist())
        raise BadNumbers(
            f"{what}: {bad.size} of {len(values)} are not finite, or larger than {most:.0e}; "
            f"the first is number {bad[0]}: {first}"
        )


def require_stamps(what: str, stamps_ns: object, rising: bool = True) -> None:
    """Raise BadNumbers unless stamps are (n,) integers in range, each later than the one before."""
    require_array(what, stamps_ns, (None,), "i")
    assert isinstance(stamps_ns, np.ndarray)
    if not stamps_ns.size:
        return
    if rising and not (stamps_ns[1:] > stamps_ns[:-1]).all():
        late = int(np.argmin(stamps_ns[1:] > stamps_ns[:-1])) + 1
        raise BadNumbers(
            f"{what}: each stamp must be later than the one before it; number {late} is "
            f"{stamps_ns[late]} ns after {stamps_ns[late - 1]} ns"
        )
    ends = (stamps_ns[0], stamps_ns[-1]) if rising else (stamps_ns.min(), stamps_ns.max())
    if int(ends[0]) < -MOST_NS or int(ends[1]) > MOST_NS:
        raise BadNumbers(f"{what}: stamps must lie within {MOST_NS} ns of zero, 146 years")


def require_counts(what: str, values: object, shape: Shape) -> None:
    """Raise BadNumbers unless values are an array of integers that are exact as a double too."""
    require_array(what, values, shape, "i")
    assert isinstance(values, np.ndarray)
    if values.size and max(-int(values.min()), int(values.max())) > MOST_COUNT:
        raise BadNumbers(f"{what}: a count is beyond {MOST_COUNT}, as none can be")


def require_indices(what: str, indices: NDArray[Any], count: int) -> None:
    """Raise BadNumbers unless each of the integers is the number of one of so many.

    indices: of any shape.
    """
    if indices.size and not 0 <= int(indices.min()) <= int(indices.max()) < count:
        raise BadNumbers(f"{what} names number {indices.max()}, or {indices.min()}, of {count}")


def require_number(what: str, value: object, low: float = -MOST, high: float = MOST) -> None:
    """Raise BadNumbers unless value is one real number within bounds, both included."""
    number = isinstance(value, (int, float, np.integer, np.floating))
    if not number or isinstance(value, bool) or not low <= value <= high:  # type: ignore[operator]
        raise BadNumbers(f"{what} must be a number from {low:g} to {high:g}, not {shown(value)}")


def require_angle(what: str, value: object) -> None:
    """Raise BadNumbers unless value is an angle in radians, or in whatever unit it was given."""
    require_number(what, value, -MOST_TURN, MOST_TURN)


def require_size(what: str, value: object) -> None:
    """Raise BadNumbers unless value is a length in metres that can be divided by."""
    require_number(what, value, LEAST_SIZE_M)


def require_sizes(what: str, values: Iterable[object]) -> None:
    """Raise BadNumbers unless each value is a length in metres that can be divided by."""
    for value in values:
        require_size(what, value)


def require_directions(what: str, directions: object) -> None:
    """Raise BadNumbers unless (n, k) are unit vectors, to a hundredth."""
    require_array(what, directions, (None, None))
    assert isinstance(directions, np.ndarray)
    squares = np.einsum("ni,ni->n", directions, directions)
    if squares.size and not float(np.abs(squares - 1.0).max()) <= 2.0 * UNIT_WITHIN:
        raise BadNumbers(f"{what}: number {np.abs(squares - 1.0).argmax()} is not a unit vector")


def require_whole(what: str, value: object, low: int = -MOST_NS, high: int = MOST_NS) -> None:
    """Raise BadNumbers unless value is one integer within bounds, both included."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not low <= value <= high:  # type: ignore[operator]
        raise BadNumbers(f"{what} must be a whole number from {low} to {high}, not {shown(value)}")


def require_rigid(what: str, T_a_b: object) -> None:
    """Raise BadNumbers unless a 4 x 4 transform turns and shifts and does nothing else."""
    require_finite(what, T_a_b, (4, 4))
    assert isinstance(T_a_b, np.ndarray)
    turn, last = T_a_b[:3, :3], T_a_b[3]
    square = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and float(np.linalg.det(turn)) > 0.0
    if not square or not np.allclose(last, (0.0, 0.0, 0.0, 1.0)):
        raise BadNumbers(f"{what}: the 4 x 4 matrix is not a rigid transform")


def require_mount(what: str, T_base_sensor: object) -> None:
    """Raise BadNumbers unless a sensor can be mounted so: rigidly, and on the robot."""
    require_rigid(what, T_base_sensor)
    assert isinstance(T_base_sensor, np.ndarray)
    if float(np.abs(T_base_sensor[:3, 3]).max()) > FARTHEST_MOUNT_M:
        raise BadNumbers(
            f"{what}: the sensor is mounted more than {FARTHEST_MOUNT_M:g} m from the base"
        )


def require_unit_quaternions(what: str, quats_xyzw: object, count: int) -> None:
    """Raise BadNumbers unless (count, 4) are rotations, to a hundredth."""
    require_finite(what, quats_xyzw, (count, 4))
    assert isinstance(quats_xyzw, np.ndarray)
    off = np.abs(np.einsum("ni,ni->n", quats_xyzw, quats_xyzw) - 1.0)
    if off.size and off.max() > 2.0 * UNIT_WITHIN:
        raise BadNumbers(f"{what}: number {off.argmax()} is not a unit quaternion")


def require_covariances(what: str, covariances: object, shape: Shape, most: float = MOST) -> None:
    """Raise BadNumbers unless (..., 3, 3) are finite, symmetric, and negative in no direction."""
    require_finite(what, covariances, shape, most)
    assert isinstance(covariances, np.ndarray)
    sizes = np.abs(covariances).max(axis=(-1, -2), keepdims=True, initial=1e-300)
    scaled = covariances / sizes
    if not np.allclose(scaled, np.swapaxes(scaled, -1, -2), atol=1e-6):
        raise BadNumbers(f"{what}: a covariance is not symmetric")
    if scaled.size and np.linalg.eigvalsh(scaled).min() < -1e-6:
        raise BadNumbers(f"{what}: a covariance is negative in some direction")


def _fits(shape: Shape, wanted: Shape) -> bool:
    same_axes = len(shape) == len(wanted)
    return same_axes and all(w is None or n == w for n, w in zip(shape, wanted, strict=True))


def _words(kinds: str) -> str:
    named = {
        "f": "floating-point numbers",
        "i": "whole numbers (int64)",
        "u": "whole numbers without a sign",
        "b": "yes or no",
    }
    return " or ".join(named[kind] for kind in kinds)


def _type_of(values: object) -> str:
    if isinstance(values, np.ndarray):
        return f"an array of {values.dtype}"
    return f"a {type(values).__name__}"
