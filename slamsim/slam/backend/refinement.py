"""The last step: key frames moved to where all their views agree best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from slamsim.core.geometry import compose, inverse
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.bundle import refine
from slamsim.slam.backend.surface_information import SurfaceInformation
from slamsim.slam.frontend.keyframes import Keyframe, odometry_edge
from slamsim.slam.frontend.preintegration import OdometryNoise


def refine_keyframes(
    keyframes: Sequence[Keyframe],
    poses: FloatArray,
    noise: OdometryNoise,
    noise_m: float,
    edges: Sequence[GraphEdge],
    held: int = 1,
) -> tuple[FloatArray, SurfaceInformation]:
    """(n, 3) T_map_base beginning at ``poses``, and what holds them there; raises as ``refine``.

    noise: of the odometry. noise_m: standard deviation of a range. edges: of the graph.
    held: so many of the first key frames stay where they are.
    """
    odometry = [odometry_edge(*pair, noise) for pair in pairwise(keyframes[held - 1 :])]
    views = [keyframe.view for keyframe in keyframes]
    T_base_view = np.array([keyframe.T_base_view for keyframe in keyframes])
    refined = refine(views, compose(poses, T_base_view), odometry, noise_m, edges, held)
    poses = compose(refined.poses, inverse(T_base_view))
    return poses, replace(refined.information, T_base_view=T_base_view[held - 1 :])
