"""Loops that drift far beyond any search near the estimate are closed, and nothing else is."""

from __future__ import annotations

import pytest
from corridor_round import round_of_corridors

from slamsim.bench.truth import false_closures
from slamsim.config.slam import SlamConfig
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.slam.session import run_slam


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_round_of_two_kilometres_of_corridors_is_closed(seed: int) -> None:
    log, truth = round_of_corridors(seed)
    result = run_slam(log, SlamConfig())
    stamps_ns = result.graph.keyframes.stamps_ns
    closed = [
        edge
        for edge in result.graph.edges
        if edge.kind == "closure"
        and edge.weight > 0.5
        and stamps_ns[edge.target] - stamps_ns[edge.source] > 3_000_000_000_000
    ]
    assert len(closed) > 20
    assert not any(check.believed for check in false_closures(result.graph, truth, 0.3))
    assert not [event for event in result.events if event.kind in ("torn", "kidnapped")]
    # The angles between beams are right, which ranges that are 3 cm too long must not put in doubt.
    assert result.log is not None
    assert not any("angle" in words for words in result.log.warnings)
    # Wheels alone are 170 m off, the front end 1 to 3 m.
    assert statistics(compare(result.trajectory, truth).translation_m).rmse < 0.3
