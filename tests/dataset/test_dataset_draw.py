"""Drawing: one index, one sequence; no world in two splits; faults that can be told apart."""

from __future__ import annotations

from collections import Counter
from itertools import combinations, pairwise
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from slamsim.config.bundled import bundled_names
from slamsim.config.dump import dump_commented_yaml
from slamsim.dataset.recipe.draw import draw, sequence_spec, split_counts, split_of
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.model import PARTS, Recipe, Splits
from slamsim.dataset.recipe.sequence import SPLITS
from slamsim.guard.errors import SlamsimError
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults, load_fault

TINY = load_recipe("tiny")


@pytest.mark.parametrize("name", bundled_names("configs/datasets"))
def test_every_bundled_recipe_loads_and_means_the_same_without_its_files(
    name: str, tmp_path: Path
) -> None:
    recipe = load_recipe(name)
    path = tmp_path / "resolved.yaml"
    path.write_text(dump_commented_yaml(recipe))
    again = load_recipe(str(path))
    assert again == recipe
    assert Recipe.model_validate(recipe.model_dump(mode="json")) == recipe
    assert sequence_spec(again, 123, 200) == sequence_spec(recipe, 123, 200)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 1000), st.integers(1, 1000))
def test_a_sequence_is_the_same_in_data_sets_of_any_size(index: int, one: int, more: int) -> None:
    assert sequence_spec(TINY, index, index + one) == sequence_spec(TINY, index, index + more)


def test_an_index_outside_is_a_mistake() -> None:
    for index in (-1, 5):
        with pytest.raises(ValueError, match="there is no sequence"):
            sequence_spec(TINY, index, 5)


def test_sequences_of_a_world_share_it_and_its_split_and_nothing_else() -> None:
    specs = [sequence_spec(TINY, index, 60) for index in range(60)]
    for one, other in pairwise(specs):
        same = one.world_index == other.world_index
        assert same == (one.config.world == other.config.world)
        assert not same or one.split == other.split
    assert len({spec.config.seed for spec in specs}) == len({spec.name for spec in specs}) == 60
    assert len({spec.config.drive.route.seed for spec in specs}) == 60
    assert len({spec.config.world.seed for spec in specs}) == 30
    assert specs[12].name == f"{specs[12].split}/000012"


def test_a_new_key_leaves_what_the_others_draw() -> None:
    more = TINY.model_copy(update={"vary": {**TINY.vary, "sensors.imu.rate_hz": TINY.duration_s}})
    for index in range(20):
        before, after = draw(TINY, index).values, draw(more, index).values
        assert {key: after[key] for key in before} == before


def test_what_was_drawn_is_in_the_configuration() -> None:
    spec = sequence_spec(TINY, 3, 4)
    maze = spec.config.world.maze
    assert maze is not None
    assert maze.rows == spec.drawn["world.maze.rows"]
    assert spec.config.world.clutter.per_cell == spec.drawn["world.clutter.per_cell"]
    assert spec.config.drive.route.max_duration_s == spec.drawn["duration_s"] == 12.0
    lidar = {"lds_01": 360, "rplidar_a2": 400}[str(spec.drawn["sensors.lidar"])]
    assert spec.config.sensors.lidar.beam_count == lidar
    assert {*spec.drawn} >= {"world", "drive"}


def test_values_that_do_not_fit_together_are_told() -> None:
    variant = TINY.worlds[0].model_copy(update={"world": {"clearance_m": -1.0}})
    with pytest.raises(SlamsimError, match="sequence 0 of tiny"):
        sequence_spec(TINY.model_copy(update={"worlds": (variant,)}), 0, 1)


@settings(max_examples=25)
@given(st.integers(0, PARTS), st.integers(0, PARTS), st.integers(1, 400), st.integers(1, 5))
def test_each_split_has_its_share_of_any_number_of_worlds(
    train: int, val: int, worlds: int, per_world: int
) -> None:
    assume(train + val <= PARTS)
    parts = (train, val, PARTS - train - val)
    splits = Splits(**{name: part / PARTS for name, part in zip(SPLITS, parts, strict=True)})
    recipe = TINY.model_copy(update={"splits": splits, "sequences_per_world": per_world})
    found = [split_of(splits, index) for index in range(worlds)]
    seen = Counter[str]()
    for number, split in enumerate(found, 1):
        seen[split] += 1
        for name, part in zip(SPLITS, parts, strict=True):
            assert abs(seen[name] - number * part / PARTS) <= 0.75 + 1e-9
    count = worlds * per_world - per_world // 2
    named = Counter(found[index // per_world] for index in range(count))
    assert split_counts(recipe, count) == {split: named[split] for split in SPLITS}


def test_shares_are_exact_where_they_can_be() -> None:
    found = Counter(split_of(Splits(train=0.8, val=0.1, test=0.1), index) for index in range(10))
    assert found == {"train": 8, "val": 1, "test": 1}
    assert split_of(Splits(train=0.0, val=1.0, test=0.0), 17) == "val"


@pytest.mark.long
def test_faults_are_as_frequent_as_asked_for_and_can_be_told_apart() -> None:
    recipe = load_recipe("faults")
    drafts = [draw(recipe, index) for index in range(800)]
    numbers = Counter(len(draft.faults) for draft in drafts)
    assert abs(numbers[0] / 800 - 0.3) < 0.05
    assert abs(numbers[1] / 800 - 0.5) < 0.05
    assert numbers[2] > 40 and numbers[3] > 40 and max(numbers) == 3
    for draft in drafts:
        for one, other in combinations([load_fault(choice.name) for choice in draft.faults], 2):
            assert one.told_apart(other)
    drawn = {choice.name for draft in drafts for choice in draft.faults}
    without_cameras = [f for f in bundled_faults() if not isinstance(f, CameraFault)]
    assert len(drawn) > 0.9 * len(without_cameras)
    assert drawn <= {fault.name for fault in without_cameras}
    late = [c.size for d in drafts for c in d.faults if c.name == "lidar_late"]
    assert late and all(size is not None and 0.002 <= size <= 0.5 for size in late)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("range_zero_no_return", "range_max_no_return"),
        ("tf_unknown_frame", "tf_not_rigid"),
        ("tf_unknown_frame", "tf_static_changes"),
    ],
)
def test_faults_that_cannot_be_injected_together(one: str, other: str) -> None:
    assert not load_fault(one).told_apart(load_fault(other))
