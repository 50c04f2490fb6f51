"""What a plan says of a data set, and the contact sheet."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from typed import typed

from slamsim.dataset.recipe import preview
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.plan import Pilots, Rehearsal, make_pilots, plan
from slamsim.dataset.recipe.preview import contact_sheet
from slamsim.dataset.recipe.sequence import SequenceSpec
from slamsim.guard.errors import SlamsimError
from slamsim.guard.quantities import as_size, as_time
from slamsim.run.dataset.telling import plan_rows

TINY = load_recipe("tiny")


def _asked_s(spec: SequenceSpec) -> float:
    asked_s = spec.config.drive.route.max_duration_s
    assert asked_s is not None
    return asked_s


def _pilot(spec: SequenceSpec) -> Rehearsal:
    """A maker whose costs are known: they grow with duration and beams."""
    asked_s, beams = _asked_s(spec), spec.config.sensors.lidar.beam_count
    sizes = {"mcap": 1000 + round(asked_s * beams * 10), "settings": 500}
    return Rehearsal(asked_s - 1.0, 2.0 + 0.1 * asked_s, sizes)


def _made(specs: Sequence[SequenceSpec]) -> Pilots:
    return Pilots(tuple(map(_pilot, specs)), (), 10**8, 3.0)


def _longer(**update: object) -> Recipe:
    duration = {"choice": [20.0, 60.0]}
    text = TINY.model_dump(mode="json")
    return Recipe.model_validate({**text, "duration_s": duration, **update})


def test_costs_are_those_of_all_sequences_by_their_kinds() -> None:
    recipe = _longer()
    found = plan(recipe, 50, workers=4, make=_made)
    every = [_pilot(sequence_spec(recipe, index, 50)) for index in range(50)]
    assert found.simulated_s == pytest.approx(sum(one.simulated_s for one in every))
    assert found.core_s == pytest.approx(sum(one.core_s for one in every))
    assert found.seconds == pytest.approx(3.0 + found.core_s / 4)
    for name in ("mcap", "settings"):
        expected = sum(one.sizes[name] for one in every)
        assert found.disk_bytes[name] == pytest.approx(expected, rel=1e-3)
    assert found.total_bytes == sum(found.disk_bytes.values())


def test_counts_are_those_of_the_sequences() -> None:
    found = plan(TINY, 31, make=_made)
    specs = [sequence_spec(TINY, index, 31) for index in range(31)]
    assert found.worlds == 16
    assert found.splits == {
        split: sum(spec.split == split for spec in specs) for split in ("train", "val", "test")
    }
    assert sum(found.counts["sensors.lidar"].values()) == 31
    faulty = sum(bool(spec.config.faults) for spec in specs)
    assert found.counts["faults"]["none"] == 31 - faulty
    assert "robot" not in found.counts
    assert plan_rows(found)["sequences"] == "31 in 16 worlds: train 15, val 8, test 8"


def test_a_large_data_set_is_scaled_from_what_was_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.dataset.recipe.plan.MOST_DRAWN", 40)
    small, large = plan(TINY, 40, make=_made), plan(TINY, 4000, make=_made)
    assert large.core_s == pytest.approx(100 * small.core_s)
    assert large.splits == {"train": 2000, "val": 1000, "test": 1000}
    assert large.counts["world"] == {"tiny": 4000}


def test_kinds_that_cannot_be_tried_cost_what_the_others_do() -> None:
    def no_faults(specs: Sequence[SequenceSpec]) -> Pilots:
        made = tuple(None if spec.config.faults else _pilot(spec) for spec in specs)
        return Pilots(made, ("nothing to damage",), 10**8, 3.0)

    found = plan(TINY, 30, make=no_faults)
    assert found.core_s == pytest.approx(30 * (2.0 + 0.1 * 12.0))


def test_a_recipe_of_which_nothing_can_be_made_is_told() -> None:
    def none(specs: Sequence[SequenceSpec]) -> Pilots:
        return Pilots((None,) * len(specs), ("the robot does not fit",), 0, 0.0)

    with pytest.raises(SlamsimError, match=r"nothing can be made.*the robot does not fit"):
        plan(TINY, 3, make=none)


@pytest.mark.long
def test_pilots_are_made_for_real() -> None:
    spec = sequence_spec(TINY, 1, 2)
    pilots = make_pilots([spec])
    assert pilots.reasons == ()
    assert pilots.made[0] is not None
    assert 8.0 < pilots.made[0].simulated_s <= 12.0
    assert pilots.made[0].sizes["mcap"] > 10_000
    assert pilots.made[0].sizes["parquet"] > 10_000
    assert 50e6 < pilots.memory_bytes < 2e9


def test_the_contact_sheet_shows_every_world_in_the_colour_of_its_split() -> None:
    told = list[tuple[float, float]]()
    data = contact_sheet(TINY, 3, lambda done, total: told.append((done, total)))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert told == [(1, 3), (2, 3), (3, 3)]
    width = 400
    bands = [image[3, column * width + 300].tolist() for column in range(2)]
    assert bands[0] != bands[1]  # train, val
    tile = image[30:380, :width]
    assert (tile < 100).all(axis=2).sum() > 500  # walls
    assert ((tile[..., 2] > 180) & (tile[..., 0] < 60)).sum() > 50  # the second way


def test_the_contact_sheet_tells_in_words_what_was_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    written = list[str]()
    monkeypatch.setattr(preview, "write_text", lambda _, text, *__: written.append(text))
    text = TINY.model_dump(mode="json")
    text["worlds"][0]["vary"]["maze.cell_m"] = {"uniform": [2.0, 2.0]}
    contact_sheet(Recipe.model_validate(text), 1)
    drawn = ", ".join(written)
    assert "cell 2 m" in drawn and "clutter per cell 0." in drawn and "random goals, 12 s" in drawn


def test_a_world_that_cannot_be_built_is_told_on_its_tile() -> None:
    world = {**TINY.worlds[0].model_dump()["world"], "clearance_m": 5.0}
    variant = TINY.worlds[0].model_copy(update={"world": world})
    assert contact_sheet(TINY.model_copy(update={"worlds": (variant,)}), 1)


def test_sizes_and_times_as_people_say_them() -> None:
    assert [as_size(size) for size in (0, 999, 5.5e9, 1.2e13)] == [
        "0 B",
        "999 B",
        "5.5 GB",
        "12 TB",
    ]
    told = ["8 s", "10 min", "1 h 40 min", "10 days 10 h"]
    assert [as_time(s) for s in (8, 600, 6000, 9e5)] == told


def test_preview_as_typed(tmp_path: Path) -> None:
    done = typed("dataset", "preview", "tiny", "-n", "1", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"file": "tiny.png", "worlds": 1}
    again = typed("dataset", "preview", "tiny", "-n", "1", cwd=tmp_path)
    assert again.returncode == 1
    assert "tiny.png is there already" in again.stderr


def test_help_names_all_and_nothing_heavy_is_imported() -> None:
    code = (
        "import sys; from slamsim.cli.main import app\n"
        "heavy = {'pybullet', 'open3d', 'scipy', 'pyarrow', 'cv2', 'numba', 'pydantic', 'dask'}\n"
        "print(sorted(heavy & sys.modules.keys()))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.stdout.strip() == "[]", done.stderr
    helped = typed("dataset", "--help", cwd=Path.cwd())
    for name in ("make", "plan", "preview", "verify", "stats"):
        assert name in helped.stdout
