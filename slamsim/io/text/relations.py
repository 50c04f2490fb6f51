"""Relation files: hand-verified relative poses of real logs (Kümmerle et al. 2009)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.numbers import is_sound
from slamsim.guard.unpacking import open_lines
from slamsim.io.text.tum import stamp_ns_from_decimal


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Where the base stood at one instant as seen from where it stood at another.

    from_ns, to_ns: (n,) stamps of laser lines. T_from_to: (n, 4, 4), the pose at to_ns in the
    frame of the pose at from_ns. planar: (n, 3) its (x_m, y_m, yaw_rad).
    """

    from_ns: IntArray
    to_ns: IntArray
    T_from_to: FloatArray

    def __len__(self) -> int:
        return int(self.from_ns.size)

    @property
    def planar(self) -> FloatArray:
        yaw = np.arctan2(self.T_from_to[:, 1, 0], self.T_from_to[:, 0, 0])
        return np.column_stack([self.T_from_to[:, 0, 3], self.T_from_to[:, 1, 3], yaw])


def read_relations(path: Path) -> Relations:
    """Lines of ``t1 t2 x y z roll pitch yaw`` in s, m, rad; empty lines and ``#`` are passed over.

    Raises InputRefused, naming the line, for anything else and for a file without relations.
    """
    from_ns, to_ns, transforms = [], [], []
    for number, line in open_lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            if len(words) != 8:
                raise ValueError(f"{len(words)} words")
            from_ns.append(stamp_ns_from_decimal(words[0]))
            to_ns.append(stamp_ns_from_decimal(words[1]))
            x, y, z, roll, pitch, yaw = _finite(words[2:])
        except ValueError as error:
            raise InputRefused(
                path, f"a relation is 't1 t2 x y z roll pitch yaw' ({error})", f"line {number}"
            ) from None
        transforms.append(se3_from_parts(matrix_from_rpy(roll, pitch, yaw), np.array([x, y, z])))
    if not transforms:
        raise InputRefused(path, "there is no relation in it")
    return Relations(np.array(from_ns), np.array(to_ns), np.array(transforms))


def _finite(words: list[str]) -> list[float]:
    values = [float(word) for word in words]
    if not is_sound(np.array(values)).all():
        raise ValueError("a number that is not finite, or too large")
    return values
