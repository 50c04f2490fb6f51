"""How the back end chooses key frames, closes loops and solves the graph."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config


class KeyframeConfig(Config):
    """When a scan becomes a node of the graph, and what is kept of it."""

    travel_m: float = Field(0.5, gt=0.0, le=100.0)
    """A new key frame after this much travel."""

    turn_deg: float = Field(17.0, gt=0.0, le=180.0)
    """A new key frame after this much turning."""

    interval_s: float = Field(10.0, gt=0.0, le=1e6)
    """A new key frame after this long, if the robot has moved at all meanwhile."""


class SubmapConfig(Config):
    """How key frames are joined into the pieces of map that closures are sought in."""

    travel_m: float = Field(3.0, gt=0.0, le=100.0)
    """Travelled distance that one submap covers; the next starts half way through it."""

    turn_deg: float = Field(360.0, gt=0.0, le=1e6)
    """A submap also ends after this much turning."""

    max_keyframes: int = Field(24, ge=2, le=1000)
    """A submap never joins more key frames than this."""

    resolution_m: float = Field(0.08, gt=0.0, le=1.0)
    """Cell size of the likelihood grids of the correlative search."""

    radius_m: float = Field(20.0, gt=0.0, le=200.0)
    """Returns farther than this from its anchor are left out of its grid."""

    cached_grids: int = Field(48, ge=2)
    """How many likelihood grids stay in memory; the least recently used are built anew."""


class ClosureConfig(Config):
    """Where loop closures are sought and what one must show before it counts."""

    enabled: bool = True
    """Whether to close loops at all."""

    min_travel_m: float = Field(6.0, ge=0.0, le=1e6)
    """Submaps left behind by less than this much travel are not sought again."""

    max_candidates: int = Field(3, ge=1, le=100)
    """At most this many submaps are searched for one key frame."""

    reach_m: float = Field(5.0, gt=0.0, le=1e6)
    """Submaps are candidates within this distance, widened by the uncertainty of the estimate."""

    gate_sigmas: float = Field(3.5, gt=0.0, le=10.0)
    """Half width of the search, in standard deviations of the relative pose."""

    min_window_m: float = Field(0.5, gt=0.0, le=1e6)
    """The search reaches at least this far on each side of the prediction."""

    max_window_m: float = Field(15.0, gt=0.0, le=50.0)
    """The search reaches at most this far, however uncertain the estimate."""

    min_window_deg: float = Field(6.0, gt=0.0, le=180.0)
    """The search turns at least this far to each side of the prediction."""

    max_window_deg: float = Field(45.0, gt=0.0, le=180.0)
    """The search turns at most this far."""

    query_travel_m: float = Field(2.0, ge=0.0, le=1e6)
    """Key frames up to this much travel back are joined with the one being matched."""

    min_score: float = Field(0.55, gt=0.0, lt=1.0)
    """Least mean likelihood of the query's points in the submap's grid."""

    min_inliers: float = Field(0.6, gt=0.0, lt=1.0)
    """Least share of the query's surfaces, where the submap has any, that lie on them."""

    min_overlap: float = Field(0.5, gt=0.0, lt=1.0)
    """Least share of the query's points that lie where the submap knows anything."""

    max_contradiction: float = Field(0.16, gt=0.0, lt=1.0)
    """Largest share of either side's points that stand where the other saw free space; half as
    much again for a closure found where it was expected."""

    ambiguity_ratio: float = Field(0.88, gt=0.0, lt=1.0)
    """A second peak of the score, relative to the best, above which the match is ambiguous."""

    ambiguity_distance_m: float = Field(0.6, gt=0.0, le=1e6)
    """How far from the best pose a second peak counts as another place."""

    ambiguity_turn_deg: float = Field(20.0, gt=0.0, le=360.0)
    """How much turned from the best pose a second peak counts as another place."""

    sure_window_m: float = Field(0.6, ge=0.0, le=1e6)
    """A closure whose search had to reach farther than this waits for others that agree, as does
    one beyond the gate."""

    min_support: int = Field(3, ge=1, le=20)
    """How many closures must agree with each other before an unexpected one counts."""

    rounds: int = Field(2, ge=0, le=10)
    """Searches over all key frames after the run, each with the estimate of the one before."""

    images: bool = False
    """Whether places that a depth camera sees again are searched as well, wherever the estimate has
    them."""


class GraphConfig(Config):
    """How the pose graph weighs its measurements and how it is solved."""

    sigma_scale: float = Field(2.0, gt=0.0, le=100.0)
    """Match standard deviations are multiplied by this: scan points are not independent."""

    min_sigma_m: float = Field(0.003, gt=0.0, le=1e3)
    """Least standard deviation of a matched translation between key frames."""

    min_sigma_deg: float = Field(0.06, gt=0.0, le=360.0)
    """Least standard deviation of a matched turn between key frames."""

    closure_sigma_m: float = Field(0.01, gt=0.0, le=1e3)
    """Least standard deviation of a closure's translation."""

    closure_sigma_deg: float = Field(0.15, gt=0.0, le=360.0)
    """Least standard deviation of a closure's turn."""

    cauchy_width: float = Field(1.0, gt=0.0, le=1e6)
    """Residual, in standard deviations, at which a closure loses half its weight."""

    withdraw_sigmas: float = Field(4.0, gt=0.0, le=1e9)
    """A closure whose residual stays above this many standard deviations is withdrawn."""


class RefinementConfig(Config):
    """The last step: all key frames and all surfaces solved at once (bundle adjustment)."""

    enabled: bool = True
    """Whether to do it; the graph's own solution is the result without it."""


class BackEndConfig(Config):
    """Key frames, submaps, loop closures and the pose graph."""

    keyframes: KeyframeConfig = KeyframeConfig()
    """When a scan becomes a node of the graph."""

    submaps: SubmapConfig = SubmapConfig()
    """Pieces of map made of several key frames."""

    closures: ClosureConfig = ClosureConfig()
    """Search for and verification of loop closures."""

    graph: GraphConfig = GraphConfig()
    """Weights and solvers of the pose graph."""

    refinement: RefinementConfig = RefinementConfig()
    """What follows the last solution of the graph."""
