"""``slamsim dataset make`` as a script meets it: how it ends, and what the rows tell."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from dataset_run import tree
from dataset_stub import Stub

from slamsim.console.reporter import Reporter
from slamsim.dataset.catalogue.statistics import MANIFEST
from slamsim.dataset.make.shard import Tried
from slamsim.dataset.store.lazy_table import rows_from_parquet
from slamsim.guard.errors import NotFound, SlamsimError
from slamsim.run.dataset.making import ConsoleWatch, run_make

COUNT = 3


@pytest.mark.long
def test_sequences_that_fail_for_good_end_in_an_error_that_tells_how_many_and_where(
    orders: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("slamsim.dataset.make.make.produce", Stub(orders))
    there = tmp_path / "a"
    recipes = {there: "tiny", tmp_path / "elsewhere" / "b": f"file://{there}/recipe.yaml"}
    for place, recipe in recipes.items():
        (orders / "1").write_text("refuse refuse refuse")
        with pytest.raises(SlamsimError, match="1 of 3 sequences could not be made") as raised:
            run_make(recipe, COUNT, str(place), Reporter(as_json=True), workers=1)
        assert raised.value.exit_code == 1 and str(place / MANIFEST) in str(raised.value)
        told = json.loads(capsys.readouterr().out)
        assert (told["made"], [one["index"] for one in told["failures"]]) == (COUNT - 1, [1])
        assert f"make {recipe} -n {COUNT} --out {place} --only 1" in told["failures"][0]["command"]
    assert tree(there) == tree(place)
    row = rows_from_parquet((there / MANIFEST).read_bytes())[1]
    assert (row["status"], row["reason"]) == ("failed", "the robot is stuck")
    words = "slamsim dataset make DIR/recipe.yaml -n 3 --out DIR --only 1"
    assert row["command"] == words


def test_a_recipe_that_is_not_behind_its_url_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"nothing\.yaml does not exist"):
        run_make(f"file://{tmp_path}/nothing.yaml", 1, str(tmp_path / "b"), Reporter(quiet=True))


def test_what_is_told_while_it_runs_ends_with_the_catalogue(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with ConsoleWatch(Reporter()) as watch:
        watch.begin(5, 2)
        watch.made(Tried(2, 1.0, {"quality.duration_s": 60.0, "size_bytes": 10**6}))
        watch.tried(3, "it broke", 1)
        watch.failed(3, "it broke", "slamsim ...")
        watch.catalogue()
    told = capsys.readouterr().err
    for part in ("2 of 5 sequences", "4 of 5", "1 failed", "sequence 3, try 1", "catalogue"):
        assert part in told
