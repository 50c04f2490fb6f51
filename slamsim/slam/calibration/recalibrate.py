"""The finished graph and the calibration of its odometry, brought into agreement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from slamsim.config.back_end import GraphConfig
from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import between
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.calibration.online import FACTORS
from slamsim.slam.calibration.solve import (
    FREE_SHARE,
    Interval,
    Solved,
    closed_by_loops,
    freedom,
    moved_match,
    solve_calibration,
)
from slamsim.slam.frontend.keyframes import Keyframe, chain_edge


class Recalibration:
    """The calibration as all key frames show it, and what it changes about them.

    Only those that odometry joins to the one before take part; ``found`` tells if there are any.
    """

    def __init__(self, keyframes: Sequence[Keyframe], motion: MotionConfig) -> None:
        self._keyframes = list(keyframes)
        self._intervals: dict[tuple[int, int], Interval] = {}
        for before, after in pairwise(keyframes):
            if after.odometry is not None and after.restart is None and after.odometry.seconds > 0:
                self._intervals[before.index, after.index] = Interval(
                    after.odometry,
                    between(before.T_map_base, after.T_map_base),
                    after.information,
                    after.stamp_ns,
                )
        intervals = list(self._intervals.values())
        self._alone = solve_calibration(intervals, motion) if intervals else None
        self.solved: Solved | None = self._alone

    @property
    def moves_chain(self) -> bool:
        """Whether odometry places any key frame, for no match holds it all round."""
        if self.solved is None:
            return False
        noise = self.solved.noise
        return any(np.trace(freedom(one, noise)) > FREE_SHARE for one in self._intervals.values())

    def doubt_unseen_noise(self) -> bool:
        """Odometry of which matches showed no noise at all errs by as much as it is configured to;
        whether there is any such noise.

        Matches show it where walls hold the robot. No wheels are that exact, but what follows other
        scans is, and errs by more where no walls are. Noise that was seen holds everywhere: what it
        refutes are closures of places that look alike.
        """
        if self.solved is None or self._alone is None:
            return False
        noise = self._alone.noise
        path, turn = (1.0 if f <= FACTORS[0] else f for f in (noise.path, noise.turn))
        doubted = replace(noise, path=path, turn=turn)
        self._alone = self.solved = replace(self._alone, noise=doubted)
        return doubted != noise

    def chain(self, config: GraphConfig) -> list[GraphEdge]:
        """The edges from each key frame to the next, odometry calibrated and as sure as it was."""
        edges = []
        for before, after in pairwise(self._keyframes):
            interval = self._intervals.get((before.index, after.index))
            if interval is None or self.solved is None:
                continue
            edge = chain_edge(before, after, self.solved.noise, config)
            T_used = between(before.T_odom_base, after.T_odom_base)
            T_moved = moved_match(interval, T_used, self.solved)
            edges.append(replace(edge, T_source_target=T_moved))
        return edges

    def close(self, poses: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Let closures speak about the calibration, poses (n, 3) being the graph's solution."""
        if self.solved is not None and self._alone is not None:
            ends, intervals = list(self._intervals), list(self._intervals.values())
            self.solved = closed_by_loops(self._alone, self.solved, intervals, ends, poses, edges)

    def keyframes(self) -> list[Keyframe]:
        """All key frames, their odometry calibrated."""
        solved = self.solved
        if solved is None:
            return self._keyframes
        return [
            one
            if one.odometry is None
            else replace(one, odometry=solved.at(one.odometry, one.stamp_ns))
            for one in self._keyframes
        ]
