"""A data set as it is used: parts against wholes, truth against the simulator, processes."""

from __future__ import annotations

import multiprocessing
import pickle
import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
from dataset_reader import read_windows
from dataset_whole import COUNT, SECONDS
from hypothesis import given, settings
from hypothesis import strategies as st

import slamsim.dataset
from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.store.lazy_table import LazyTable
from slamsim.dataset.store.place import Location
from slamsim.dataset.store.reader import Dataset, Sequence
from slamsim.dataset.truth.tables import read_drive
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.io.parquet.file import Column, ParquetFile
from slamsim.recording import RawStream
from slamsim.sensors.motion import Motion
from slamsim.sim.drive.record import START_NS


@pytest.fixture(scope="module")
def dataset(small_set: Path) -> Dataset:
    return slamsim.dataset.open(small_set)


def test_sequences_are_had_by_number_name_split_and_condition(dataset: Dataset) -> None:
    assert len(dataset) == COUNT and len(list(dataset)) == COUNT
    assert dataset[-1].name == dataset[COUNT - 1].name
    assert dataset["train/000001"].row["index"] == 1
    assert [one.row["index"] for one in dataset[1:4]] == [1, 2, 3]
    splits = [dataset.split(name) for name in ("train", "val", "test")]
    assert sum(map(len, splits)) == COUNT
    assert {one.row["split"] for one in splits[0]} == {"train"}
    healthy = dataset.filter(pc.field("faults") == "")
    assert len(healthy) == sum(one.row["faults"] == "" for one in dataset)
    assert dataset[0].config.seed == dataset[0].row["seed"]


def test_what_is_not_there_is_refused_in_words(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no finished data set"):
        slamsim.dataset.open(tmp_path)
    (tmp_path / "manifest.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputRefused, match="manifest"):
        slamsim.dataset.open(tmp_path)
    with pytest.raises(IndexError):
        dataset[COUNT]
    with pytest.raises(KeyError, match="train/000099"):
        dataset["train/000099"]
    with pytest.raises(SlamsimError, match="train, val, test"):
        dataset.split("valid")
    with pytest.raises(ValueError, match="no time"):
        dataset[0].between(3.0, 3.0)


@settings(max_examples=25)
@given(
    which=st.integers(0, COUNT - 1),
    start_s=st.floats(0.0, SECONDS + 2.0),
    length_s=st.floats(0.01, SECONDS),
)
def test_a_part_is_the_whole_cut_by_true_time(
    which: int, start_s: float, length_s: float, dataset: Dataset
) -> None:
    whole = dataset[which]
    part = whole.between(start_s, start_s + length_s)
    span = START_NS + round(start_s * 1e9), START_NS + round((start_s + length_s) * 1e9)
    for name in ("scans", "imu", "encoders"):
        stream: RawStream = getattr(whole, name)
        truth = LazyTable(whole.place, f"{whole.name}/truth/{name}.parquet")
        true_ns = truth.column("true_stamp_ns")[stream.samples]
        require_rows(getattr(part, name), stream, (true_ns >= span[0]) & (true_ns < span[1]))
    moved = whole.odometry.stamps_ns
    require_rows(part.odometry, whole.odometry, (moved >= span[0]) & (moved < span[1]))
    true_ns = whole.truth.scans.true_stamps_ns
    inside = (true_ns >= span[0]) & (true_ns < span[1])
    for field in fields(part.truth.scans):
        all_of_it = getattr(whole.truth.scans, field.name)
        np.testing.assert_array_equal(getattr(part.truth.scans, field.name), all_of_it[inside])


def require_rows(part: RawStream, whole: RawStream, kept: np.ndarray[Any, Any]) -> None:
    for field in fields(part):
        mine, all_of_it = getattr(part, field.name), getattr(whole, field.name)
        if isinstance(all_of_it, np.ndarray):
            np.testing.assert_array_equal(mine, all_of_it[kept], field.name)
        else:
            assert mine == all_of_it


@settings(max_examples=25)
@given(data=st.data())
def test_the_truth_of_any_instant_is_the_simulators_own(
    data: st.DataObject, dataset: Dataset, small_set: Path
) -> None:
    sequence = dataset[0]
    motion = Motion(read_drive(small_set / sequence.name / "truth/trajectory.parquet"))
    ends = st.integers(START_NS, motion.covered_ns)
    begin_ns, end_ns = sorted(data.draw(st.tuples(ends, ends), "part"))
    instants = data.draw(st.lists(st.integers(begin_ns, end_ns), min_size=1), "instants")
    stamps_ns = np.array([*instants, begin_ns, end_ns])
    part = sequence.between((begin_ns - START_NS) * 1e-9, (end_ns - START_NS + 1) * 1e-9)
    for truth in (part.truth, sequence.truth):
        found = truth.at(stamps_ns)
        np.testing.assert_array_equal(found.positions_m, motion.positions_at(stamps_ns))
        np.testing.assert_array_equal(found.quats_xyzw, motion.quats_xyzw_at(stamps_ns))


def test_beams_pairs_surfaces_and_grid_come_with_the_truth(dataset: Dataset) -> None:
    sequence = next(one for one in dataset if one.row["faults"] == "")
    truth, recorded = sequence.truth, sequence.scans
    beams = truth.scans
    assert beams.ranges_m.shape == recorded.ranges_m.shape == beams.surfaces.shape  # type: ignore[union-attr]
    assert beams.surfaces[np.isfinite(beams.ranges_m)].max() < truth.surfaces["surface"].size
    assert set(truth.pairs) >= {"scan_a", "scan_b", "x_m", "closes_loop"}
    assert truth.occupancy.occupancy.ndim == 2
    assert len(sequence.log.scans) == len(recorded)
    assert truth.imu["true_stamp_ns"].size == len(sequence.imu)
    assert truth.encoders["wheel_left_rad"].size == len(sequence.encoders)


@pytest.mark.parametrize("table", ["parquet/imu", "truth/trajectory", "truth/surfaces"])
def test_tables_of_many_sequences_read_as_one_join_with_the_manifest(
    dataset: Dataset, small_set: Path, table: str
) -> None:
    files = [str(small_set / one.name / f"{table}.parquet") for one in dataset]
    rows = pads.dataset(files).to_table(columns=["sequence"]).group_by("sequence")
    joined = rows.aggregate([([], "count_all")]).join(dataset.manifest, "sequence", "index")
    found = {row["name"]: row["count_all"] for row in joined.to_pylist()}
    assert found == {
        one.name: len(LazyTable(one.place, f"{one.name}/{table}.parquet")) for one in dataset
    }


@pytest.mark.parametrize("fault", ["", "faulty"])
def test_windows_are_stretches_of_scans_with_their_poses(dataset: Dataset, fault: str) -> None:
    chosen = dataset.filter(
        pc.equal(pc.field("faults"), "") if not fault else pc.field("faults") != ""
    )
    windows = chosen.windows(scans=5, stride=3)
    sensed = [int(str(one.row["quality.scans"])) for one in chosen]
    firsts = [
        (one, first) for one, n in zip(chosen, sensed, strict=True) for first in range(0, n - 4, 3)
    ]
    assert len(windows) == len(firsts)
    for number, (sequence, first) in enumerate(firsts):
        window = windows[number]
        truth = sequence.truth.scans
        assert window["sequence"] == sequence.row["index"]
        np.testing.assert_array_equal(
            window["true_stamps_ns"], truth.true_stamps_ns[first : first + 5]
        )
        np.testing.assert_array_equal(
            window["poses"], sequence.truth.poses_at(window["true_stamps_ns"])
        )
        assert window["ranges_m"].shape == (5, windows.beams)
        if not fault:
            assert window["recorded"].all()
            whole = np.asarray(sequence.scans.ranges_m)
            beams = whole.shape[1]
            np.testing.assert_array_equal(window["ranges_m"][:, :beams], whole[first : first + 5])
            assert np.isnan(window["ranges_m"][:, beams:]).all()
            lidar = sequence.config.sensors.lidar
            angles = np.radians(lidar.angle_min_deg + lidar.angle_step_deg * np.arange(beams))
            np.testing.assert_allclose(window["angles_rad"][:beams], angles, atol=1e-4)
            assert np.isnan(window["angles_rad"][beams:]).all()
    with pytest.raises(IndexError):
        windows[len(windows)]
    with pytest.raises(ValueError, match="none"):
        chosen.windows(scans=0)


def test_a_scan_that_was_lost_leaves_a_gap_in_its_window(tmp_path: Path, dataset: Dataset) -> None:
    sequence = next(one for one in dataset if one.row["faults"] == "")
    source = Path(sequence.place.address) / sequence.name
    lossy = Dataset(
        Location(str(tmp_path)), dataset.manifest.slice(int(str(sequence.row["index"])), 1)
    )
    (tmp_path / sequence.name).mkdir(parents=True)
    shutil.copytree(source / "truth", tmp_path / sequence.name / "truth")
    (tmp_path / sequence.name / "parquet").mkdir()
    whole = pq.read_table(source / "parquet/scans.parquet")
    kept = [row for row in range(whole.num_rows) if row not in (1, 2)]
    pq.write_table(whole.take(kept), tmp_path / sequence.name / "parquet/scans.parquet")
    window = lossy.windows(scans=4, stride=4)[0]
    assert window["recorded"].tolist() == [True, False, False, True]
    assert np.isnan(window["ranges_m"][1:3]).all()
    np.testing.assert_array_equal(window["ranges_m"][3], sequence.scans.ranges_m[3])


def test_windows_of_a_data_set_that_does_not_tell_its_beams_are_refused(dataset: Dataset) -> None:
    old = replace(dataset, manifest=dataset.manifest.drop_columns(["quality.beams"]))
    with pytest.raises(SlamsimError, match=r"made by an earlier version.*quality\.beams"):
        old.windows()


def test_windows_of_several_lidars_are_all_of_one_shape(dataset: Dataset) -> None:
    lidars = set(dataset.manifest["drawn.sensors.lidar"].to_pylist())
    assert len(lidars) > 1
    windows = dataset.windows(scans=4, stride=9)
    batch = [windows[number] for number in range(len(windows))]
    for name in batch[0]:
        assert np.stack([window[name] for window in batch]).shape[0] == len(windows)


@pytest.mark.long
def test_other_processes_read_the_same(dataset: Dataset) -> None:
    windows = dataset.filter(pc.field("drawn.sensors.lidar") == "lds_01").windows(4, 4)
    numbers = list(range(len(windows)))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(read_windows, windows, numbers).result() == read_windows(
            windows, numbers
        )
    part: Sequence = pickle.loads(pickle.dumps(dataset[0].between(1.0, 2.0)))
    assert len(part.scans) == len(dataset[0].between(1.0, 2.0).scans)


@settings(max_examples=40)
@given(
    lengths=st.lists(st.integers(0, 40), max_size=3),
    first=st.integers(0, 130),
    last=st.integers(0, 130),
)
def test_rows_of_a_table_are_slices_of_it(
    lengths: list[int], first: int, last: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("lazy")
    values = np.arange(2 * sum(lengths), dtype=np.float32).reshape(-1, 2)
    columns = [Column("pair", "float32", width=2), Column("number", "int64")]
    with ParquetFile(path / "t.parquet", columns, {"said": 1}, rows_per_group=16) as file:
        file.append({"pair": values, "number": np.arange(len(values))})
    table = LazyTable(Location(str(path)), "t.parquet")
    assert len(table) == len(values) and table.facts == {"said": 1}
    np.testing.assert_array_equal(table.rows(first, last)["pair"], values[first:last])
    np.testing.assert_array_equal(table.column("number"), np.arange(len(values)))


def test_behind_a_url_it_is_the_same(dataset: Dataset, small_set: Path) -> None:
    fsspec.filesystem("memory").put(str(small_set), "/data/set", recursive=True)
    remote = slamsim.dataset.open("memory://data/set")
    assert len(remote) == COUNT
    for mine, theirs in zip(remote, dataset, strict=True):
        np.testing.assert_array_equal(mine.scans.ranges_m, theirs.scans.ranges_m)
        grids = mine.truth.occupancy.occupancy, theirs.truth.occupancy.occupancy
        np.testing.assert_array_equal(*grids)
    with pytest.raises(SlamsimError, match="copy it"):
        _ = remote[0].log
    assert verify("memory://data/set").whole
    fsspec.filesystem("memory").pipe_file("/data/set/train/000000/config.yaml", b"other: 1")
    (finding,) = verify("memory://data/set").findings
    assert finding.path == "train/000000/config.yaml" and "bytes long" in finding.reason
