"""Random changes of messages, and the harm that they do to a consumer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from independent.cases import Case, bag_of, cases, make
from independent.consumer import HARMFUL_M, harm_m, use_of
from independent.mutate import Numbered, mutated
from independent.writer import STORE, messages_of

MESSAGES = 25


@pytest.fixture(scope="module")
def numbered() -> Numbered:
    return list(enumerate(messages_of(bag_of(Case("clean", 1), 12.0)[0])))


def test_an_unchanged_recording_does_no_harm(numbered: Numbered) -> None:
    use = use_of(numbered)
    assert not use.broken
    assert len(use.ends_m) > 50
    assert harm_m(use, use) < 1e-9


@pytest.mark.parametrize(
    ("name", "least_m", "most_m"),
    [
        ("angle_step_5%", 0.05, 1.0),
        ("laser_yaw_0.5deg", 0.0, 0.05),
        ("ranges_mm_all", 10.0, np.inf),
        ("twist_deg", 1.0, np.inf),
        ("scan_frame_unknown", np.inf, np.inf),
        ("beams_more", np.inf, np.inf),
        ("odometry_nan", np.inf, np.inf),
        ("acceleration_g", np.inf, np.inf),
    ],
)
def test_harm_is_measured(name: str, least_m: float, most_m: float) -> None:
    before = use_of(list(enumerate(messages_of(bag_of(Case("clean", 1), 12.0)[0]))))
    faulty = messages_of(bag_of(Case("fault", 1, "", (name,)), 12.0)[0])
    assert least_m <= harm_m(before, use_of(list(enumerate(faulty)))) <= most_m


@pytest.mark.long
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_mutations_leave_messages_that_can_be_written(numbered: Numbered, seed: int) -> None:
    """And never touch the recording that they are made of."""
    before = [str(message) for _, message in numbered[:MESSAGES]]
    mutation = mutated(numbered, np.random.default_rng(seed))
    assert mutation.words
    for _, (_, _, message) in mutation.messages[:: len(mutation.messages) // MESSAGES]:
        assert STORE.serialize_cdr(message, message.__msgtype__)
    assert [str(message) for _, message in numbered[:MESSAGES]] == before


@pytest.mark.long
def test_many_mutations_are_harmful_and_many_are_not(numbered: Numbered) -> None:
    before = use_of(numbered)
    every = [mutated(numbered, np.random.default_rng(seed)) for seed in range(16)]
    harms_m = [harm_m(before, use_of(one.messages)) for one in every]
    assert 3 <= sum(harm > HARMFUL_M for harm in harms_m) <= 13


def test_a_harmful_mutation_must_be_told_and_another_need_not(tmp_path: Path) -> None:
    cases_made = cases([], 0, 0, [f"mutation_{number}@1" for number in range(6)])
    made = [make(case, tmp_path / case.name, 4.0) for case in cases_made]
    assert {one.right for one in made} == {(), (None,)}
    assert all("harm" in one.about or "breaks" in one.about for one in made)
