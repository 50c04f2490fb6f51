"""Scoring goes on where one of the scores cannot be had."""

from __future__ import annotations

import numpy as np
import pytest
from view_example import example_run

from slamsim.console.reporter import Reporter
from slamsim.run import scoring
from slamsim.run.scoring import Estimated, Known, score
from slamsim.run.stages import Stages


def test_covariances_that_are_none_cost_the_nees_alone(caplog: pytest.LogCaptureFixture) -> None:
    view = example_run()
    graph = view.result.graph
    estimated = Estimated(
        view.result.trajectory,
        view.result.odometry,
        keyframes=graph.keyframes,
        covariances=np.zeros_like(graph.covariances),
        parts={"graph": graph.keyframes},
    )
    with caplog.at_level("WARNING", logger=scoring.__name__):
        found = score(estimated, Known(view.truth), None, Stages(Reporter(quiet=True)))
    assert found.consistency is None
    assert found.trajectory is not None
    assert list(found.budget) == ["odometry", "graph"]
    assert "NEES is unknown" in caplog.text
