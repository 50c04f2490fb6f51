"""What a lidar measures of panes: glass lets beams through, mirrors throw them back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.cameras.appearance import Appearance
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.sensors.scene import NO_TRIANGLE, NOTHING, Hits, Scene

_FLASH = np.float32(np.cos(np.radians(3.0)))
"""Beams within so much of a pane's normal come straight back from it, be it glass or mirror. Our
choice: in scans of real glass that are some degrees about the normal."""
_LEAST_RETURN = 0.25
"""Share of a beam that is left after a pane has thrown it there and back, below which the lidar
gets no return: a mirror leaves 0.81, glass 0.006."""
_LIFT_M = 1e-3
"""So far from a mirror begin the beams that it throws back, so as not to meet it again."""


def past_panes(scene: Scene, rays: Float32Array, hits: Hits, looks: Appearance) -> Hits:
    """The hits of (n, 6) rays, those on panes being what the lidar takes for them.

    Beams along a pane's normal end at it. Else a mirror gives the whole way to what it shows,
    once, for a mirror in a mirror counts as wall; behind glass nothing answers.
    """
    if (shares := looks.mirroring) is None:
        return hits
    met = np.flatnonzero(hits.triangles != NO_TRIANGLE)
    points_m = _ends(rays, hits, met) + scene.origin_m
    panes = shares[looks.materials(hits.triangles[met], points_m)]
    is_pane = (panes > 0.0) & (hits.cos_incidence[met] < _FLASH)
    met, left = met[is_pane], np.square(panes[is_pane])
    seen = replace(hits, **{name: getattr(hits, name).copy() for name in Hits.__slots__})
    seen.ranges_m[met], seen.cos_incidence[met] = np.inf, 0.0
    seen.surfaces[met], seen.triangles[met] = NOTHING, NO_TRIANGLE
    mirrors = met[left >= _LEAST_RETURN]
    if mirrors.size:
        shown = scene.cast(_thrown_back(scene, rays, hits, mirrors))
        seen.ranges_m[mirrors] = hits.ranges_m[mirrors] + shown.ranges_m
        seen.cos_incidence[mirrors] = shown.cos_incidence
        seen.surfaces[mirrors], seen.triangles[mirrors] = shown.surfaces, shown.triangles
    return seen


def _ends(rays: Float32Array, hits: Hits, at: IntArray) -> FloatArray:
    """(k, 3) where some rays end, relative to the scene's origin."""
    way_m = hits.ranges_m[at, None].astype(np.float64)
    return np.asarray(rays[at, :3] + way_m * rays[at, 3:])


def _thrown_back(scene: Scene, rays: Float32Array, hits: Hits, mirrors: IntArray) -> Float32Array:
    """(k, 6) rays from mirrors."""
    normals = scene.met(rays[mirrors])[1].astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = rays[mirrors, 3:].astype(np.float64)
    along = np.einsum("ni,ni->n", normals, directions)[:, None]
    towards = -np.sign(along) * normals
    out = directions - 2.0 * along * normals
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    back = np.hstack([_ends(rays, hits, mirrors) + _LIFT_M * towards, out])
    return back.astype(np.float32)
