"""The path of a robot, or of a camera alone, from what its camera, wheels and gyroscope tell."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import se2_from_se3, se3_from_se2, wrap_angle, xyzw_from_matrix
from slamsim.core.spatial import CameraTrack, SpatialEdge
from slamsim.core.types import FloatArray, Trajectory
from slamsim.guard.errors import SlamsimError
from slamsim.models.wheel_gyro import GYRO_BIAS, PARAMETERS
from slamsim.slam.frontend.motion import Odometry
from slamsim.slam.frontend.preintegration import OdometryNoise
from slamsim.slam.visual.graph import solve_in_space

WALK_M_S, WALK_RAD_S = 0.7, 0.7
"""Standard deviation of a motion of which nothing is known: that of a robot that drives."""
STILL_M, STILL_RAD = 0.002, 0.001
"""Least of a step of wheels and gyroscope."""
FLOOR_M, FLOOR_RAD = 0.01, 0.01
"""Standard deviation by which a robot on wheels heaves and tilts."""
SHARED = 0.04
"""Share of a view's variance that all of a tag have in common: a small tag far away is seen nearer
than it is, by a fifth of the standard deviation of one image."""
ANYWHERE_M, ANY_YAW_RAD = 1e3, 10.0
"""Standard deviations of what a floor does not tell: place and heading."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedTag:
    """T_map_tag: (4, 4). covariance: (6, 6) of a small step in its own frame. seen: key frames that
    see it; doubted: of these, those that do not fit."""

    number: int
    T_map_tag: FloatArray
    covariance: FloatArray
    seen: int
    doubted: int


@dataclass(frozen=True, slots=True, eq=False)
class CameraMap:
    """trajectory: T_map_base of the images; of the optical frame where it is on no robot. poses:
    (k, 4, 4) of key frames, with covariances (k, 6, 6) of small steps in their own frames. edges:
    of the graph, whose tags are numbered after the key frames. guessed: steps from key frame to key
    frame that nothing tells."""

    trajectory: Trajectory
    poses: FloatArray
    covariances: FloatArray
    edges: tuple[SpatialEdge, ...]
    tags: tuple[MappedTag, ...]
    guessed: int

    @property
    def closures(self) -> tuple[int, int]:
        """(believed, withdrawn)."""
        weights = [edge.weight for edge in self.edges if edge.kind == "closure"]
        return sum(w > 0.0 for w in weights), sum(w == 0.0 for w in weights)

    @property
    def sigmas_m(self) -> FloatArray:
        """(k,) standard deviation of where each key frame is, relative to the first."""
        return np.asarray(np.sqrt(np.trace(self.covariances[:, :3, :3], axis1=1, axis2=2)))


def camera_map(
    track: CameraTrack, T_base_camera: FloatArray, odometry: Odometry | None, motion: MotionConfig
) -> CameraMap:
    """The most likely path, and where the tags are.

    T_base_camera: (4, 4), the identity for a camera that is on no robot. odometry: wheels and
    gyroscope, None for none. Raises SlamsimError where nothing tells any motion, or no solution
    is found.
    """
    stamps_ns, count = track.keyframe_stamps_ns, len(track.keyframes)
    seen = [_of_base(edge, T_base_camera) for edge in track.edges]
    known, wheels = np.zeros(PARAMETERS), list[SpatialEdge]()
    if odometry is not None:
        known[GYRO_BIAS] = _gyro_bias(stamps_ns.tolist(), odometry, seen)
        wheels = _by_wheels(stamps_ns.tolist(), odometry, known, motion)
    told = sum(edge.kind == "camera" for edge in seen) + len(wheels) + len(track.tags)
    if not told:
        raise SlamsimError(
            "nothing tells how the camera moved: there are no tags and no wheels, and no depth "
            "image shows what the last one did"
        )
    chain = _chain(stamps_ns.tolist(), [*wheels, *seen])
    poses = _along(chain)
    guesses = [edge for edge in chain if edge.kind == "guess"]
    joined = [e for e in seen if e.kind != "guess"]
    floor = [_on_floor(k, pose) for k, pose in enumerate(poses)] if wheels else []
    tags, first = _tags(track, T_base_camera, poses)
    everything = np.concatenate([poses, np.array(list(first.values())).reshape(-1, 4, 4)])
    solved = solve_in_space(everything, [*guesses, *joined, *wheels, *floor, *tags])
    found = []
    for place, number in enumerate(first, count):
        views = [e for e in solved.edges if e.kind == "tag" and e.target == place]
        doubted = sum(edge.weight == 0.0 for edge in views)
        pose, covariance = solved.poses[place], solved.covariances[place]
        found.append(MappedTag(number, pose, covariance, len(views), doubted))
    kept = solved.poses[:count]
    return CameraMap(
        _trajectory(track, kept, T_base_camera, odometry, known),
        kept,
        solved.covariances[:count],
        solved.edges,
        tuple(found),
        len(guesses),
    )


def _of_base(edge: SpatialEdge, T_base_camera: FloatArray) -> SpatialEdge:
    """An edge between optical frames as one between the robot's poses."""
    T_camera_base = np.asarray(np.linalg.inv(T_base_camera))
    T = T_base_camera @ edge.T_source_target @ T_camera_base
    carry = _adjoint(T_base_camera)
    covariance = carry @ edge.covariance @ carry.T
    return SpatialEdge(edge.source, edge.target, T, covariance, edge.kind)


def _adjoint(T_a_b: FloatArray) -> FloatArray:
    """(6, 6) takes a small step in frame b, metres and radians, to frame a."""
    R, (x, y, z) = T_a_b[:3, :3], T_a_b[:3, 3]
    found = np.asarray(np.kron(np.eye(2), R), dtype=np.float64)
    found[:3, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    return found


def _gyro_bias(stamps_ns: Sequence[int], odometry: Odometry, seen: Sequence[SpatialEdge]) -> float:
    """rad/s, by what the gyroscope says at rest, and beyond what the camera saw it turn."""
    turned = {e.source: se2_from_se3(e.T_source_target)[2] for e in seen if e.kind == "camera"}
    beyond_rad = seconds = 0.0
    for k, (first_ns, last_ns) in enumerate(pairwise(stamps_ns)):
        if not (odometry.has_gyro and odometry.covers(first_ns, last_ns)):
            continue
        step = odometry.step(first_ns, last_ns, np.zeros(PARAMETERS))
        if step.rest_s > 0.0:
            beyond_rad, seconds = beyond_rad + step.rest_turn_rad, seconds + step.rest_s
        elif k in turned:
            beyond_rad += float(wrap_angle(step.T_first_last[2] - turned[k]))
            seconds += step.gyro_s
    return beyond_rad / seconds if seconds > 0.0 else 0.0


def _by_wheels(
    stamps_ns: Sequence[int], odometry: Odometry, known: FloatArray, motion: MotionConfig
) -> list[SpatialEdge]:
    noise = OdometryNoise(motion)
    in_plane = np.ix_([0, 1, 5], [0, 1, 5])
    found = []
    for k, (first_ns, last_ns) in enumerate(pairwise(stamps_ns)):
        if odometry.covers(first_ns, last_ns):
            step = odometry.step(first_ns, last_ns, known)
            tilted = np.square([FLOOR_M, FLOOR_RAD, FLOOR_RAD])
            least = np.square([STILL_M, STILL_M, STILL_RAD])
            covariance = np.diag([0.0, 0.0, *tilted, 0.0])
            covariance[in_plane] = noise.covariance(step) + np.diag(least)
            T = se3_from_se2(step.T_first_last)
            found.append(SpatialEdge(k, k + 1, T, covariance, "wheels"))
    return found


def _chain(stamps_ns: Sequence[int], edges: Sequence[SpatialEdge]) -> list[SpatialEdge]:
    """From each key frame to the next: what the camera tells, else wheels, else a guess."""
    rank = {"camera": 0, "wheels": 1, "guess": 2}
    best: dict[int, SpatialEdge] = {}
    for edge in edges:
        if edge.target != edge.source + 1 or edge.kind not in rank:
            continue
        known = best.get(edge.source)
        if known is None or rank[edge.kind] < rank[known.kind]:
            best[edge.source] = edge
    chain = []
    for k, (first_ns, last_ns) in enumerate(pairwise(stamps_ns)):
        seconds = 1e-9 * (last_ns - first_ns)
        sigmas = seconds * np.repeat([WALK_M_S, WALK_RAD_S], 3)
        T = best[k].T_source_target if k in best else np.eye(4)
        guess = SpatialEdge(k, k + 1, T, np.diag(np.square(sigmas)), "guess")
        chain.append(best[k] if k in best and best[k].kind != "guess" else guess)
    return chain


def _along(chain: Sequence[SpatialEdge]) -> FloatArray:
    poses = [np.eye(4)]
    for edge in chain:
        poses.append(poses[-1] @ edge.T_source_target)
    return np.array(poses)


def _on_floor(number: int, pose: FloatArray) -> SpatialEdge:
    sigmas = [ANYWHERE_M, ANYWHERE_M, FLOOR_M, FLOOR_RAD, FLOOR_RAD, ANY_YAW_RAD]
    T = se3_from_se2(se2_from_se3(pose))
    return SpatialEdge(number, number, T, np.diag(np.square(sigmas)), "floor")


def _tags(
    track: CameraTrack, T_base_camera: FloatArray, poses: FloatArray
) -> tuple[list[SpatialEdge], dict[int, FloatArray]]:
    """Edges to the tags, which are numbered after the poses, and where each is by its best view."""
    by_number = defaultdict(list)
    for one in track.tags:
        by_number[one.number].append(one)
    edges, first = [], {}
    for place, number in enumerate(sorted(by_number), len(poses)):
        views = by_number[number]
        surest = min(views, key=lambda one: float(np.trace(one.covariance)))
        first[number] = poses[surest.keyframe] @ T_base_camera @ surest.T_camera_tag
        shared = 1.0 + SHARED * len(views)
        for one in views:
            T, covariance = T_base_camera @ one.T_camera_tag, shared * one.covariance
            edges.append(SpatialEdge(one.keyframe, place, T, covariance, "tag"))
    return edges, first


def _trajectory(
    track: CameraTrack,
    poses: FloatArray,
    T_base_camera: FloatArray,
    odometry: Odometry | None,
    known: FloatArray,
) -> Trajectory:
    """Of all images that anything joins to their key frame; known: parameters of the odometry."""
    T_camera_base = np.linalg.inv(T_base_camera)
    starts_ns = track.keyframe_stamps_ns[track.keyframe_of]
    chosen, found = [], []
    for k, (stamp_ns, start_ns) in enumerate(
        zip(track.stamps_ns.tolist(), starts_ns.tolist(), strict=True)
    ):
        T = T_base_camera @ track.T_keyframe_camera[k] @ T_camera_base
        if stamp_ns != start_ns and np.array_equal(track.T_keyframe_camera[k], np.eye(4)):
            if odometry is None or not odometry.covers(start_ns, stamp_ns):
                continue
            T = se3_from_se2(odometry.step(start_ns, stamp_ns, known).T_first_last)
        chosen.append(k)
        found.append(poses[track.keyframe_of[k]] @ T)
    places = np.array(found)
    quats = np.array([xyzw_from_matrix(one[:3, :3]) for one in places])
    return Trajectory(track.stamps_ns[chosen], places[:, :3, 3], quats)
