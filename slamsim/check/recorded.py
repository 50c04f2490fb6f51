"""Plots of a stream as it was recorded, for faults that no other plot shows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice, pairwise

import numpy as np

from slamsim.check.findings import Curve, Plot
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    Recording,
)

_BINS = 600
"""Stretches of time of which a plot keeps the least and the largest value."""
_MOST_SCANS = 1200
_ABOUT_ACCELERATION = ("imu.spikes", "imu.gravity", "imu.axis", "imu.stuck")
_Draw = Callable[..., "_Drawn"]
_Drawn = tuple[str, tuple[tuple[str, FloatArray], ...]]


def recorded_plot(recording: Recording, subject: str, check: str = "") -> Plot | None:
    """What was recorded on a topic, or in a frame; None of what no stream holds. check: which
    question is asked of it."""
    stream = next((one for one in recording.streams if subject == one.topic), None)
    if stream is None:
        stream = next((one for one in recording.streams if subject in one.frame_ids), None)
    if stream is None or len(stream) < 2:
        return None
    drawn = (each for kind, each in _DRAWN.items() if isinstance(stream, kind))
    draw: _Draw | None = next(drawn, None)
    if draw is None:
        return None
    rows = _rows_of(stream)
    if isinstance(stream, RawImu) and check.startswith(_ABOUT_ACCELERATION):
        unit, values = _accelerations(stream, rows)
    else:
        unit, values = draw(stream, rows)
    since_s = 1e-9 * (stream.stamps_ns[rows] - stream.stamps_ns.min()).astype(np.float64)
    curves = []
    for label, of_rows in values:
        kept = _extremes(of_rows)
        curves.append(Curve(label, since_s[kept], of_rows[kept]))
    title = f"{stream.topic} as recorded"
    return Plot(title, "stamp (s after the first)", unit, tuple(curves))


def _rows_of(stream: RawStream) -> IntArray:
    """Scans are read one by one, from a file perhaps: some of them are enough."""
    every = max(len(stream) // _MOST_SCANS, 1) if isinstance(stream, RawScans) else 1
    return np.arange(0, len(stream), every)


def _extremes(values: FloatArray) -> IntArray:
    """Which values to draw: the least and the largest of each stretch, where there are many."""
    if values.size <= 2 * _BINS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, _BINS + 1).astype(int)
    finite = np.where(np.isfinite(values), values, np.nan)
    kept = []
    for begin, end in pairwise(edges.tolist()):
        piece = finite[begin:end]
        if np.isfinite(piece).any():
            kept += [begin + int(np.nanargmin(piece)), begin + int(np.nanargmax(piece))]
    return np.array(sorted(set(kept)), dtype=np.int64)


def _scans(stream: RawScans, rows: IntArray) -> _Drawn:
    nearest, middle = np.full(rows.size, np.nan), np.full(rows.size, np.nan)
    for i, row in enumerate(rows.tolist()):
        ranges_m = np.asarray(stream.ranges_m[row], dtype=np.float64)
        ranges_m = ranges_m[np.isfinite(ranges_m)]
        if ranges_m.size:
            nearest[i], middle[i] = ranges_m.min(), np.median(ranges_m)
    return "range (as recorded)", (("median of the beams", middle), ("nearest", nearest))


def _imu(stream: RawImu, rows: IntArray) -> _Drawn:
    rates = stream.angular_velocity_rad_s[rows]
    return "turn rate (as recorded)", tuple(
        (f"about {axis}", rates[:, i]) for i, axis in enumerate("xyz")
    )


def _accelerations(stream: RawImu, rows: IntArray) -> _Drawn:
    felt = stream.linear_acceleration_m_s2[rows]
    return "acceleration (as recorded)", tuple(
        (f"along {axis}", felt[:, i]) for i, axis in enumerate("xyz")
    )


def _odometry(stream: RawOdometry, rows: IntArray) -> _Drawn:
    yaw = np.unwrap(np.nan_to_num(yaw_from_xyzw(stream.quats_xyzw[rows])))
    x, y = stream.positions_m[rows, 0], stream.positions_m[rows, 1]
    return "pose (m, rad)", (("x", x), ("y", y), ("heading", yaw))


def _ticks(stream: RawTicks, rows: IntArray) -> _Drawn:
    counts = stream.ticks[rows].astype(np.float64)
    return "counts", (("left", counts[:, 0]), ("right", counts[:, 1]))


def _joints(stream: RawJoints, rows: IntArray) -> _Drawn:
    named = islice(enumerate(stream.names), 4)
    return "angle (rad)", tuple((name, stream.positions_rad[rows, i]) for i, name in named)


_DRAWN: dict[type[RawStream], _Draw] = {
    RawScans: _scans,
    RawImu: _imu,
    RawOdometry: _odometry,
    RawTicks: _ticks,
    RawJoints: _joints,
}
