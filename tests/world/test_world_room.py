"""How far cells of a floor are from what stands on it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from slamsim.world.reachable_space import _cells_to_nearest


@given(
    sides=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    share=st.sampled_from([0.0, 0.5, 0.99, 1.0]),
    seed=st.integers(0, 999),
)
def test_distances_are_those_of_scipy_to_the_bit(
    sides: tuple[int, int], share: float, seed: int
) -> None:
    free = np.pad(np.random.default_rng(seed).random(sides) < share, 1)
    assert _cells_to_nearest(free).tobytes() == ndimage.distance_transform_edt(free).tobytes()
