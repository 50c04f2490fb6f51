"""The classic real logs against hand-verified relations: all with one configuration."""

from __future__ import annotations

import pytest
from real_logs import needs_radish, radish

from slamsim.config.slam import SlamConfig
from slamsim.evaluate.relations import score_relations
from slamsim.io.open import read_log
from slamsim.io.text.relations import read_relations
from slamsim.slam.session import run_slam


@pytest.mark.slow
@needs_radish
@pytest.mark.parametrize(
    ("name", "all_m", "all_deg", "far_m"),
    [("fr079", 0.035, 0.50, 0.05), ("aces", 0.045, 0.42, 0.12), ("intel", 0.020, 0.40, 0.03)],
)
def test_real_logs_are_mapped_as_well_as_ever_published(
    name: str, all_m: float, all_deg: float, far_m: float
) -> None:
    """Cartographer, tuned for each: 0.045 m / 0.54 deg, 0.038 / 0.37, 0.023 / 0.45."""
    path, relations_path = radish(name)
    slam = run_slam(read_log(path), SlamConfig())
    relations = read_relations(relations_path)
    scores = score_relations(slam.trajectory, relations.from_ns, relations.to_ns, relations.planar)
    assert scores.all.translation_mean_m <= all_m
    assert scores.all.rotation_mean_deg <= all_deg
    assert scores.far is not None and scores.far.translation_mean_m <= far_m
