"""Places that a depth camera sees again: candidates by their descriptors, closures by geometry.

ORB's binary descriptors (Rublee et al. 2011) are found again by some of their bits: an inverted
index whose words are fixed sets of bits (locality sensitive hashing, Indyk & Motwani 1998), rare
words counting more. Nothing is believed that the points of both images do not confirm: one rigid
motion must explain most of the matches, in pixels and in depth.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.randomness import random_stream
from slamsim.core.types import Float32Array, FloatArray
from slamsim.perception.corners import depths_at, rays_xy_at
from slamsim.perception.point_fit import FittedMotion, SeenPoints, blocks_of, fit_motion
from slamsim.perception.rgbd_odometry import rigid_motion

FEATURES = 500
TABLES, BITS = 8, 16
"""Two views of a corner differ in some 12 % of 256 bits: 1 of 8 words of 16 bits is the same."""
MOST_OF_WORD = 40
"""A word of more places than this tells none apart."""
CANDIDATES = 3
APART = 20
"""Places that come sooner one after the other are neighbours on the way, no loop."""
MOST_BITS_OFF = 64
WITHIN_PX = 3.0
"""ORB's corners are those of a coarser image, and a rolling shutter bends it besides."""
LEAST_RIGID, LEAST_RIGID_SHARE, LEAST_BLOCKS = 25, 0.3, 4
"""Of matches in a closure: so many, of so many of them, in so many parts of the image."""
MOST_DEPTH_OFF = 0.03
"""Share of the depth by which a scene may differ: a D435 errs by 1 % at 3 m."""
WORST_SIGMA_M = 0.1
"""A closure that is less sure is refused: bricks look alike, and chance fits badly."""
ANOTHER_VIEW = 4.0
"""Variance of a closure over what its points tell: rows of the shutter, and corners of ORB whose
errors go with the way that they are looked at."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A key frame with (n, 32) descriptors, where they are seen, and how far away."""

    keyframe: int
    part: int
    descriptors: NDArray[np.uint8]
    rays_xy: FloatArray
    depths_m: FloatArray

    @property
    def points_m(self) -> FloatArray:
        """(n, 3) in its camera."""
        return np.column_stack([self.rays_xy, np.ones(len(self.depths_m))]) * self.depths_m[:, None]


class Places:
    """Key frames that were seen, in their order."""

    def __init__(self, model: CameraModel) -> None:
        self._model, self._focal_px = model, float(model.focal_px.mean())
        self._orb = cv2.ORB.create(FEATURES)
        chosen = [random_stream(0, "places", str(k)).permutation(256)[:BITS] for k in range(TABLES)]
        self._bits = np.array(chosen)
        self._places: list[Place] = []
        self._found: dict[int, list[int]] = defaultdict(list)
        self.refused = 0

    def add(
        self, keyframe: int, part: int, grey: NDArray[np.uint8], depth_m: Float32Array
    ) -> list[tuple[int, FittedMotion]]:
        """Remember a key frame; earlier ones that show the same scene, and the motion since.

        part: how often the path was lost before; what was seen before that may be near. grey: (h,
        w). depth_m: (h, w), nan for none.
        """
        place = self._place(keyframe, part, grey, depth_m)
        words = self._words(place.descriptors)
        closures = []
        for earlier in self._alike(words, part):
            fitted = self._motion(earlier, place)
            if fitted is None:
                self.refused += 1
            else:
                closures.append((earlier.keyframe, fitted))
        for word in words:
            self._found[word].append(len(self._places))
        self._places.append(place)
        return closures

    def _place(
        self, keyframe: int, part: int, grey: NDArray[np.uint8], depth_m: Float32Array
    ) -> Place:
        corners, descriptors = None, None
        if min(grey.shape) > 2 * self._orb.getEdgeThreshold():
            corners, descriptors = self._orb.detectAndCompute(grey, None)
        if corners is None or descriptors is None:
            return Place(keyframe, part, np.zeros((0, 32), np.uint8), np.zeros((0, 2)), np.zeros(0))
        pixels = np.array([corner.pt for corner in corners], dtype=np.float32)
        depths_m, rays_xy = depths_at(depth_m, pixels), rays_xy_at(self._model, pixels)
        known = np.isfinite(depths_m) & np.isfinite(rays_xy).all(axis=1)
        kept = np.asarray(descriptors, np.uint8)[known]
        return Place(keyframe, part, kept, rays_xy[known], depths_m[known])

    def _words(self, descriptors: NDArray[np.uint8]) -> list[int]:
        """Each word of an image once."""
        bits = np.unpackbits(descriptors, axis=1)
        powers = 1 << np.arange(BITS)
        words = [table + TABLES * (bits[:, self._bits[table]] @ powers) for table in range(TABLES)]
        return sorted(set(np.concatenate(words).tolist()))

    def _alike(self, words: list[int], part: int) -> list[Place]:
        votes: dict[int, float] = defaultdict(float)
        for word in words:
            places = self._found.get(word, [])
            if 0 < len(places) <= MOST_OF_WORD:
                for place in places:
                    votes[place] += 1.0 / len(places)
        now = len(self._places)
        far = [k for k in votes if now - k >= APART or self._places[k].part != part]
        far.sort(key=lambda k: (-votes[k], k))
        return [self._places[k] for k in far[:CANDIDATES]]

    def _motion(self, earlier: Place, now: Place) -> FittedMotion | None:
        """What takes points of the earlier camera into that of now; None if they show no common
        scene."""
        if min(len(earlier.descriptors), len(now.descriptors)) < LEAST_RIGID:
            return None
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        matches = [
            one
            for one in matcher.match(earlier.descriptors, now.descriptors)
            if one.distance < MOST_BITS_OFF
        ]
        if len(matches) < LEAST_RIGID:
            return None
        before = np.array([one.queryIdx for one in matches])
        after = np.array([one.trainIdx for one in matches])
        nothing = np.zeros(len(matches))
        seen = SeenPoints(
            earlier.points_m[before],
            now.rays_xy[after],
            now.depths_m[after],
            nothing,
            nothing + 1.0,
        )
        guess, rigid = rigid_motion(seen.points_m, seen.rays_xy, self._focal_px, WITHIN_PX)
        if np.count_nonzero(rigid) < max(LEAST_RIGID, LEAST_RIGID_SHARE * len(matches)):
            return None
        chosen = seen.those(rigid)
        if len(np.unique(blocks_of(chosen.rays_xy))) < LEAST_BLOCKS:
            return None
        return self._agreed(guess, chosen)

    def _agreed(self, guess: FloatArray, seen: SeenPoints) -> FittedMotion | None:
        try:
            fitted = fit_motion(guess, seen, self._focal_px, np.zeros(6))
        except np.linalg.LinAlgError:
            return None
        there = seen.points_m @ fitted.T_now_keyframe[:3, :3].T + fitted.T_now_keyframe[:3, 3]
        off = np.abs(there[:, 2] - seen.depths_m) / seen.depths_m
        covariance = ANOTHER_VIEW * fitted.covariance
        sure = float(np.trace(covariance[:3, :3])) < WORST_SIGMA_M**2
        if not sure or float(np.nanmedian(off)) > MOST_DEPTH_OFF:
            return None
        return FittedMotion(fitted.T_now_keyframe, covariance, fitted.pixel_sigma)
