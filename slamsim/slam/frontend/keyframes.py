"""Key frames: the scans that become nodes of the graph, and what is kept of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.back_end import GraphConfig, KeyframeConfig
from slamsim.core.geometry import between, compose, rotation
from slamsim.core.result import EdgeKind, GraphEdge
from slamsim.core.types import Cloud, Float32Array, FloatArray
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.backend.views import ViewMaker
from slamsim.slam.frontend.odometry import ELSEWHERE_M, ELSEWHERE_RAD
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep
from slamsim.slam.frontend.tracking import Tracked
from slamsim.slam.matching.range_noise import RangeNoise

MAX_BEAMS = 180
BLIND = np.diag(np.square([0.3, 0.3, 0.2]))
"""Of a step between key frames of which no odometry says anything: m, m, rad."""
OTHER_DRIVE_M = 50.0
"""Path between two drives: more than any that makes key frames neighbours."""

LEAST_MOTION = np.diag(np.square([5e-5, 5e-5, 2e-5]))
"""Covariance of a motion that odometry says was none."""


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """T_map_base: (3,) as the front end saw it, drift included. T_odom_base: (3,) prediction.

    pieces: (k, PIECE_FIELDS) of the scan in its base frame. view: (m, PIECE_FIELDS) what all scans
    since the key frame before have seen, this one's included. T_base_view: (3,) where the view
    says that this scan was taken, as seen from where its own match puts it. origin_m: (2,) and
    beams_m: (b, 2), where some of its beams began and ended. path_m: travelled so far.
    information: (3, 3) of the match. restart: (3, 3) covariance of a small step of the base,
    relative to the key frame before, where a local map was begun anew, so that no match joins the
    two; else None. noise_m: standard deviation of a range, as learnt by then. odometry: the step
    since the key frame before by wheels and gyroscope; None where they do not cover all of it.
    doubt_ns: stamp of the first scan since the key frame before that was lost or had to be searched
    for, None without one. suspect: whether the robot may have been carried before it; restart then
    tells how sure odometry is if it was not. The first of a later
    drive is: its start may be wrong.
    """

    index: int
    stamp_ns: int
    T_map_base: FloatArray
    T_odom_base: FloatArray
    information: FloatArray
    pieces: FloatArray
    view: Float32Array
    T_base_view: FloatArray
    origin_m: FloatArray
    beams_m: Float32Array
    path_m: float
    restart: FloatArray | None
    noise_m: float
    odometry: OdometryStep | None = None
    doubt_ns: int | None = None
    suspect: bool = False

    @property
    def broken(self) -> bool:
        """Whether nothing but odometry joins it to the key frame before."""
        return self.restart is not None

    @property
    def kidnapped(self) -> bool:
        """Whether not even odometry tells where it is as seen from the key frame before."""
        return self.restart is not None and float(self.restart[0, 0]) >= ELSEWHERE_M**2


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """The last key frame of an earlier drive, and (3, 3) how surely the first of this one stands
    where the front end begins, as seen from there. fixed: the earlier map stays as it is."""

    keyframe: Keyframe
    restart: FloatArray
    fixed: bool = False


def begins_drive(before: Keyframe, after: Keyframe) -> bool:
    """Whether another drive begins with the later of two consecutive key frames."""
    return after.path_m - before.path_m >= OTHER_DRIVE_M


ANYWHERE = np.diag(np.square([ELSEWHERE_M, ELSEWHERE_M, ELSEWHERE_RAD]))
ABOUT_THERE = np.diag(np.square([0.3, 0.3, 0.1]))
"""Of a first pose given by a person, or carried over from another drive: 0.3 m and 0.3 m, 0.1
rad."""


class KeyframeMaker:
    """Decides which scans become key frames, and distils them.

    before: what this drive follows on, if it does.
    """

    def __init__(
        self, config: KeyframeConfig, reach_m: float, before: Before | None = None
    ) -> None:
        self._config, self._reach_m = config, reach_m
        self._first_index = 0 if before is None else before.keyframe.index + 1
        self._restart = None if before is None else before.restart
        self._noise = RangeNoise()
        self._view = ViewMaker()
        self._last: Keyframe | None = None
        self._T_map_before: FloatArray | None = None
        self._path_m = 0.0 if before is None else before.keyframe.path_m + OTHER_DRIVE_M
        self._doubt_ns: int | None = None
        self._held_back: FloatArray | None = np.zeros(3)
        self._odometry: OdometryStep | None = None

    def make(self, tracked: Tracked) -> Keyframe | None:
        """A key frame of this scan, or None if the robot has not moved enough since the last."""
        if self._T_map_before is not None:
            step = tracked.T_map_base[:2] - self._T_map_before[:2]
            self._path_m += float(np.hypot(step[0], step[1]))
        self._T_map_before = tracked.T_map_base
        if self._odometry is not None and tracked.odometry is not None:
            self._odometry = self._odometry.then(tracked.odometry)
        else:
            self._odometry = None
        moved = None if tracked.odometry is None else tracked.odometry.T_first_last
        if moved is not None and self._held_back is not None:
            moved = compose(self._held_back, moved)
        if tracked.held_back:
            self._held_back = moved
            return None
        self._held_back = np.zeros(3)
        if tracked.doubtful and self._doubt_ns is None:
            self._doubt_ns = tracked.stamp_ns
        if tracked.match is None or tracked.doubtful:
            self._view.clear()  # where the scans before stood is no longer known
        if tracked.match is None and not tracked.keyscan:
            return None
        self._view.add(tracked.pieces, tracked.T_map_base, moved, self._noise.sigma_m)
        if not self._due(tracked):
            return None
        self._noise.see(tracked.cloud)
        self._noise.learn(tracked.pieces)
        origin_m, beams_m = _some_beams(tracked.cloud, self._reach_m)
        view, T_map_view = self._view.take()
        first = self._last is None
        self._last = Keyframe(
            index=self._first_index if self._last is None else self._last.index + 1,
            stamp_ns=tracked.stamp_ns,
            T_map_base=tracked.T_map_base,
            T_odom_base=tracked.T_odom_base,
            information=tracked.information,
            pieces=tracked.pieces,
            view=view,
            T_base_view=between(tracked.T_map_base, T_map_view),
            origin_m=origin_m,
            beams_m=beams_m,
            path_m=self._path_m,
            restart=self._restart if first else tracked.restart,
            noise_m=self._noise.sigma_m,
            odometry=self._odometry,
            doubt_ns=self._doubt_ns,
            suspect=tracked.suspect or (first and self._restart is not None),
        )
        self._doubt_ns = None
        self._odometry = OdometryStep.none(np.zeros(PARAMETERS))
        return self._last

    def _due(self, tracked: Tracked) -> bool:
        if self._last is None or tracked.restart is not None:
            return True
        moved = between(self._last.T_map_base, tracked.T_map_base)
        travel_m = self._path_m - self._last.path_m
        turned = abs(moved[2]) / np.deg2rad(self._config.turn_deg)
        share = max(travel_m / self._config.travel_m, turned)
        waited_s = (tracked.stamp_ns - self._last.stamp_ns) * 1e-9
        return bool(share >= 1.0 or (waited_s >= self._config.interval_s and share >= 0.1))


def chain_edge(
    before: Keyframe, after: Keyframe, odometry: OdometryNoise, config: GraphConfig
) -> GraphEdge:
    """The front end's measurement between two consecutive key frames.

    Information of the match and of odometry add up, so that a direction which the walls do not
    hold keeps the uncertainty of the wheels. An edge to where the local map was begun anew is as
    sure as the front end was of its place then.
    """
    noise = BLIND
    if after.odometry is not None:
        noise = odometry.covariance(after.odometry)
    floor = np.diag(np.square([config.min_sigma_m] * 2 + [np.deg2rad(config.min_sigma_deg)]))
    information = np.linalg.inv(floor + (noise if after.restart is None else after.restart))
    if after.restart is None:
        # Both ends were matched to the same local map: their variances add.
        information += after.information / (2.0 * config.sigma_scale**2)
    covariance = np.linalg.inv(information) + floor
    T = between(before.T_map_base, after.T_map_base)
    turn = rotation(np.asarray(T[2]))
    kind: EdgeKind = "odometry" if after.broken else "match"
    return GraphEdge(before.index, after.index, T, turn @ covariance @ turn.T, kind)


def odometry_edge(before: Keyframe, after: Keyframe, odometry: OdometryNoise) -> GraphEdge:
    """What wheels and gyroscope alone say between two consecutive key frames.

    To where the local map was begun anew: what the front end believed then.
    """
    if after.restart is None:
        T, covariance = between(before.T_odom_base, after.T_odom_base), BLIND
        if after.odometry is not None:
            T = after.odometry.T_first_last
            covariance = odometry.covariance(after.odometry) + LEAST_MOTION
    else:
        T = between(before.T_map_base, after.T_map_base)
        covariance = after.restart + LEAST_MOTION
    turn = rotation(np.asarray(T[2]))
    return GraphEdge(before.index, after.index, T, turn @ covariance @ turn.T, "odometry")


def _some_beams(cloud: Cloud, reach_m: float) -> tuple[FloatArray, Float32Array]:
    """Where the beams of the first lidar begin, and the ends of up to MAX_BEAMS of those that hit
    something."""
    own = slice(cloud.own_beams)
    origins_m, points_m = cloud.origins_m[own], cloud.points_m[own]
    origin_m = origins_m.mean(axis=0) if len(origins_m) else np.zeros(2)
    length = np.linalg.norm(points_m - origins_m, axis=1)
    ends = points_m[cloud.hit[own] & (length <= reach_m)]
    stride = max(1, -(-len(ends) // MAX_BEAMS))
    return origin_m, ends[::stride].astype(np.float32)
