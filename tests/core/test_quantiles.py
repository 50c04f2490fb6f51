"""Quantiles beside those of ``scipy.stats``, whose numbers they are to the last bit."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, t

from slamsim.core.quantiles import chi_square, student_t


def test_quantiles_are_those_of_scipy_also_where_there_is_none() -> None:
    random = np.random.default_rng(1)
    share, freedom = random.random(2000), random.uniform(-1.0, 400.0, 2000)
    for degrees in (freedom, np.rint(freedom)):
        np.testing.assert_array_equal(chi_square(share, degrees), chi2.ppf(share, degrees))
        np.testing.assert_array_equal(student_t(share, degrees), t.ppf(share, degrees))
    assert float(chi_square(0.95, 2)) == chi2.ppf(0.95, 2)
    assert float(student_t(0.975, 5)) == t.ppf(0.975, 5)
