"""Tags in rendered worlds: what is claimed of their positions is so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from slamsim.bench.cameras.tags import measure_tag_nees, tag_errors
from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter


@pytest.mark.long
def test_tags_in_a_rendered_world_are_where_they_are_claimed_to_be() -> None:
    steps, squares = tag_errors(load_run_config("gallery").world, 101, 6)
    assert len(steps) == len(squares) >= 3
    assert np.median(np.linalg.norm(steps, axis=1)) < 0.002
    assert squares.mean() < 3.0 * chi2.ppf(0.999, 3 * len(squares)) / (3 * len(squares))


@pytest.mark.slow
def test_tags_of_twenty_worlds_are_consistent() -> None:
    figures = measure_tag_nees(load_run_config("gallery"), Reporter(quiet=True))
    nees, band = figures["tag_nees"], figures["tag_nees_band"]
    assert isinstance(nees, float) and isinstance(band, list)
    assert band[0] < nees < band[1]
