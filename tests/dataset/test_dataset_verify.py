"""Verification: what was changed is found and named, nothing else is, and it can be repaired."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from dataset_run import tree
from dataset_whole import COUNT, copied, make_small
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamsim.console.reporter import Reporter
from slamsim.dataset.catalogue.statistics import MANIFEST
from slamsim.dataset.catalogue.verify import Verification, verify
from slamsim.dataset.make import sequence_check
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.store.lazy_table import rows_from_parquet, rows_to_parquet
from slamsim.guard.errors import NotFound, SlamsimError
from slamsim.guard.seal import (
    SUMS,
    SumsDamaged,
    read_sequence,
    read_sums,
    sequence_text,
    sha256_of,
    sums_text,
)
from slamsim.run.dataset.telling import repair_plan, run_stats, run_verify

QUIET = Reporter(quiet=True)


@pytest.fixture(scope="module")
def scratch(small_set: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy; whoever changes it puts it right again."""
    return copied(small_set, tmp_path_factory.mktemp("scratch") / "set")


def named(found: Verification) -> set[str]:
    return {finding.path for finding in found.findings}


def test_what_was_just_made_is_whole(small_set: Path) -> None:
    found = verify(str(small_set))
    assert found.whole and found.sequences == found.checked == COUNT
    assert found.again == () and found.failed == 0
    assert found.files == len(tree(small_set))


@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(data=st.data())
def test_one_flipped_bit_in_any_file_is_named_and_nothing_else_is(
    data: st.DataObject, scratch: Path
) -> None:
    files = tree(scratch)
    name = data.draw(st.sampled_from(sorted(files)))
    place = data.draw(st.integers(0, len(files[name]) - 1))
    changed = bytearray(files[name])
    changed[place] ^= 1 << data.draw(st.integers(0, 7))
    (scratch / name).write_bytes(changed)
    try:
        assert named(verify(str(scratch))) == {name}
    finally:
        (scratch / name).write_bytes(files[name])


def test_a_sequence_is_judged_by_the_manifest_and_not_by_what_it_says_of_itself(
    scratch: Path,
) -> None:
    """One that can be read as before, which few flipped bits leave so."""
    files = tree(scratch)
    name = next(name for name in sorted(files) if name.endswith("sequence.json"))
    (scratch / name).write_bytes(files[name] + b" ")
    try:
        (finding,) = verify(str(scratch)).findings
        assert finding.path == name and "not as the manifest has it" in finding.reason
    finally:
        (scratch / name).write_bytes(files[name])


@pytest.mark.long
def test_every_file_is_missed_when_it_is_gone_or_cut(scratch: Path) -> None:
    files = tree(scratch)
    judges = [name for name in files if name.endswith((SUMS, MANIFEST, "sequence.json"))]
    for names in (sorted(files.keys() - set(judges)), *([name] for name in judges)):
        for name in names:
            (scratch / name).unlink()
        assert named(verify(str(scratch))) >= set(names)
        for name in names:
            (scratch / name).write_bytes(files[name][:-1])
        assert named(verify(str(scratch))) == set(names)
        for name in names:
            (scratch / name).write_bytes(files[name])
    assert verify(str(scratch)).whole


def test_whatever_else_lies_there_is_told_but_for_logs_and_hidden_files(scratch: Path) -> None:
    strange = ["notes.txt", "shards/x.parquet", "train/000099/a", "train/000000/truth/b"]
    for name in (*strange, "logs/more.log", ".git/config", "train/000000/.cache"):
        (scratch / name).parent.mkdir(parents=True, exist_ok=True)
        (scratch / name).write_text("strange")
    assert named(verify(str(scratch))) == {*strange[:2], "train/000099", strange[3]}
    for name in (*strange, "train/000000/.cache"):
        (scratch / name).unlink()
    shutil.rmtree(scratch / "train/000099")
    assert verify(str(scratch)).whole


def test_a_data_set_that_was_never_finished_is_not_whole(small_set: Path, tmp_path: Path) -> None:
    place = copied(small_set, tmp_path / "set")
    for name in (SUMS, "manifest.parquet", "shards/00001.parquet"):
        (place / name).unlink()
    found = verify(str(place))
    assert not found.whole and found.checked == 2
    assert [finding.reason for finding in found.findings] == [
        "missing: the data set was never finished",
        "tells nothing of 2 of 4 sequences; the first: 2",
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    "damaged",
    [
        pytest.param(["train/000000/config.yaml"], marks=pytest.mark.slow),
        ["train/000001/sequence.json", "shards/00000.parquet", "manifest.parquet"],
        ["recipe.yaml", "val/000002/truth/scans.parquet", SUMS],
        ["dataset.yaml", "test/000003/log/log_0.mcap"],
    ],
)
def test_what_is_damaged_is_made_again_by_the_commands_that_are_told(
    damaged: list[str], small_set: Path, one_worker: WorkEngine, tmp_path: Path
) -> None:
    place = copied(small_set, tmp_path / "set")
    for name in damaged:
        if (place / name).is_file():
            data = bytearray((place / name).read_bytes())
            data[len(data) // 2] ^= 1
            (place / name).write_bytes(data)
    plan = repair_plan(verify(str(place)))
    for name in plan.remove:
        if (place / name).is_dir():
            shutil.rmtree(place / name)
        else:
            (place / name).unlink()
    assert plan.commands[-1].endswith(f" -n {COUNT} --out {place}")
    make_small(place, one_worker)
    assert tree(place) == tree(small_set)


def forged(place: Path, name: str, data: bytes) -> None:
    """A file of the first sequence changed, and every hash that would tell."""
    (place / "train/000000" / name).write_bytes(data)
    mark = place / "train/000000/sequence.json"
    told = read_sequence(mark.read_bytes())
    for file in told["files"]:
        if file["path"] == name:
            file |= {"size_bytes": len(data), "sha256": sha256_of(data)}
    mark.write_text(sequence_text(told))
    rows = rows_from_parquet((place / MANIFEST).read_bytes())
    rows[0]["sha256"] = sha256_of(mark.read_bytes())
    (place / MANIFEST).write_bytes(rows_to_parquet(rows))
    sums = read_sums((place / SUMS).read_bytes())
    sums[MANIFEST] = sha256_of((place / MANIFEST).read_bytes())
    (place / SUMS).write_text(sums_text(sums))


@pytest.mark.long
def test_only_making_it_again_tells_what_was_never_made_so(small_set: Path, tmp_path: Path) -> None:
    place = copied(small_set, tmp_path / "set")
    forged(place, "world.yaml", b"name: another\n")
    assert verify(str(place)).whole
    found = verify(str(place), again=2, workers=1)
    assert found.again == (0, 2)
    assert named(found) == {"train/000000/world.yaml"}
    assert found.findings[0].index == 0


def test_other_software_does_not_judge(small_set: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequence_check, "versions", lambda: {"numpy": "0.1"})
    with pytest.raises(SlamsimError, match=r"numpy 0\.1 instead of"):
        verify(str(small_set), again=1)
    assert verify(str(small_set)).whole


def test_what_is_told_can_be_read_by_programs(
    scratch: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    teller = Reporter(as_json=True)
    assert run_verify(str(scratch), teller)
    told = json.loads(capsys.readouterr().out)
    assert told["whole"] and told["plan"] is None and told["checked"] == COUNT
    config = scratch / "train/000001/config.yaml"
    contents = config.read_bytes()
    config.unlink()
    assert not run_verify(str(scratch), teller)
    told = json.loads(capsys.readouterr().out)
    assert told["findings"] == [
        {"path": "train/000001/config.yaml", "reason": "missing", "index": 1}
    ]
    assert told["plan"]["remove"] == ["shards/00000.parquet", "train/000001"]
    config.write_bytes(contents)
    run_stats(str(scratch), teller)
    assert json.loads(capsys.readouterr().out)["sequences"] == COUNT


def test_a_part_is_spread_over_the_whole(small_set: Path) -> None:
    assert verify(str(small_set), share=0.5).checked == 2
    assert verify(str(small_set), share=1e-9).checked == 1
    assert run_verify(str(small_set), QUIET, subset="50%")


@pytest.mark.parametrize("subset", ["0%", "101%", "some", "nan"])
def test_a_part_that_is_none_is_refused(subset: str, small_set: Path) -> None:
    with pytest.raises(SlamsimError, match="a share of the sequences"):
        run_verify(str(small_set), QUIET, subset=subset)


def test_where_there_is_no_data_set_there_is_nothing_to_verify(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"no dataset\.yaml"):
        verify(str(tmp_path))
    with pytest.raises(NotFound):
        verify(str(tmp_path / "nowhere"))


@given(
    st.dictionaries(
        st.text(st.characters(exclude_characters="\n/", codec="utf-8"), min_size=3, max_size=20),
        st.binary(min_size=32, max_size=32),
        max_size=4,
    )
)
def test_sums_are_read_as_they_were_written(hashes: dict[str, bytes]) -> None:
    told = {path: sha256.hex() for path, sha256 in hashes.items()}
    text = sums_text(told).encode()
    assert read_sums(text) == told
    for damaged in (text[:-1], text + b"\n", text.replace(b"# of", b"# if"), text[1:]):
        with pytest.raises(SumsDamaged):
            read_sums(damaged)
