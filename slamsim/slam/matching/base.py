"""What every scan matcher takes and gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from slamsim.core.types import Cloud, FloatArray
from slamsim.guard.numbers import FINITE, require_finite, require_number

ROUNDING = 1e-9
"""Of a sum of shares that make 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan fits the local map, and how well. A failed match is ``None``, never this.

    T_map_base: (3,) at the cloud's stamp. information: (3, 3) inverse covariance of a small step
    (dx_m, dy_m, dyaw_rad) of the base in its own frame (``compose(T_map_base, step)``), from the
    scan alone; it is zero along degenerate directions. inlier_ratio: share of the scan, where
    the map covers it, that lies on it. covered_ratio: share of the scan that the map covers.
    degenerate_directions: (k, 3) steps of the base, in its own frame, that the surfaces do not
    hold; k = 0 for most scans. pull: (3,) the scan alone would rather be at the step ``d`` with
    ``information @ d = pull``; the prediction holds it back.
    """

    T_map_base: FloatArray
    information: FloatArray
    inlier_ratio: float
    covered_ratio: float
    degenerate_directions: FloatArray
    pull: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        require_finite("the pose of a match", self.T_map_base, (3,))
        require_finite("the information of a match", self.information, (3, 3), FINITE)
        require_finite("the pull of a match", self.pull, (3,), FINITE)
        require_number("the inlier ratio of a match", self.inlier_ratio, 0.0, 1.0 + ROUNDING)
        require_number("the covered ratio of a match", self.covered_ratio, 0.0, 1.0 + ROUNDING)

    @property
    def fit(self) -> float:
        """Share of the whole scan that lies on the map."""
        return self.inlier_ratio * self.covered_ratio

    @property
    def degenerate(self) -> bool:
        return bool(len(self.degenerate_directions))


class Matcher(Protocol):
    """Lays clouds onto a local map that it keeps itself."""

    def pieces(self, cloud: Cloud) -> FloatArray:
        """(k, PIECE_FIELDS) the straight surface pieces of a cloud, in the base frame.

        Of the latest cloud they are made once only.
        """
        ...

    def pieces_of_part(self, part: Cloud) -> FloatArray:
        """As ``pieces``, of a part of a cloud: nothing is learnt of it about noise."""
        ...

    def match(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """The pose of the cloud's base near the guess, or None if there is none to believe.

        prior_covariance: (3, 3) of the guess, for a small step of the base in its own frame.
        """
        ...

    def match_part(
        self, part: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """As ``match``, of a part of a cloud: nothing is learnt of it about noise and usual fit."""
        ...

    def search(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """As ``match``, from a guess that may be wrong by decimetres and tens of degrees."""
        ...

    def support(self, cloud: Cloud, T_map_base: FloatArray) -> float:
        """How many surface pieces of the cloud lie on the map when its base is at a pose (3,)."""
        ...

    def insert(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """Make the cloud part of the local map. T_map_base: (3,)."""
        ...

    def forget(self) -> None:
        """Begin an empty local map."""
        ...
