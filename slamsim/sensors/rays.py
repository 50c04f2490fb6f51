"""One ray per beam, from the pose of the laser at the beam's own instant."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.sensors.motion import PoseSamples


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
