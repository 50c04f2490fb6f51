"""Published poses as a planar path, tolerant of faults."""

from __future__ import annotations

import numpy as np

from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import is_sound


def planar_track(
    stamps_ns: IntArray, positions_m: FloatArray, quats_xyzw: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Sorted distinct stamps (m,), and (m, 3) x, y in metres, continuous yaw, of what is sound.

    stamps_ns: (n,). positions_m: (n, 3). quats_xyzw: (n, 4).
    """
    finite = is_sound(positions_m) & is_sound(quats_xyzw)
    stamps, first = np.unique(stamps_ns[finite], return_index=True)
    yaw = np.unwrap(yaw_from_xyzw(quats_xyzw[finite][first]))
    return stamps, np.column_stack([positions_m[finite][first][:, :2], yaw])


def track_at(stamps_ns: IntArray, poses: FloatArray, query_ns: IntArray) -> FloatArray:
    """(m, 3) of such a track between its stamps (n,); beyond the ends it stays where it was."""
    at_s, query_s = (stamps_ns - stamps_ns[0]) * 1e-9, (query_ns - stamps_ns[0]) * 1e-9
    return np.column_stack([np.interp(query_s, at_s, column) for column in poses.T])
