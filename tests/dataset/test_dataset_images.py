"""Data sets with cameras: every format tells the same images, textures follow the split."""

from __future__ import annotations

import pickle
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import slamsim.dataset
from slamsim.cameras.codecs.planes import pack_planes, unpack_planes
from slamsim.dataset.catalogue.verify import verify
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.make.produce import produce
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.store.reader import Dataset
from slamsim.guard.errors import Excessive, InputRefused, NotFound
from slamsim.io.cameras import open_cameras
from slamsim.io.parquet.images import pixels_of, table_of
from slamsim.io.ros.bag import open_bag

COUNT = 2
RECIPE: dict[str, Any] = {
    "name": "seen",
    "title": "Seconds of driving, seen by a small camera",
    "seed": 5,
    "duration_s": 2,
    "splits": {"train": 0.5, "val": 0.0, "test": 0.5},
    "formats": ["mcap", "parquet", "tum_rgbd", "euroc"],
    "worlds": [{"world": "tiny"}],
    "config": {
        "sensors": {
            "additional": [
                {
                    "type": "camera",
                    "name": "front",
                    "rate_hz": 5,
                    "mount": {"z_m": 0.3},
                    "imagers": {
                        "color": {
                            "lens": {"width": 48, "height": 32},
                            "truth": ["depth", "normals", "instances", "materials", "flow"],
                        },
                        "depth": {
                            "kind": "depth",
                            "lens": {"width": 40, "height": 30},
                            "encoding": "png",
                        },
                        "grey": {
                            "kind": "grey",
                            "lens": {"width": 24, "height": 16},
                            "encoding": "raw",
                        },
                    },
                }
            ]
        }
    },
}


def recipe_file(folder: Path, **changes: object) -> str:
    path = folder / "seen.yaml"
    path.write_text(yaml.safe_dump({**RECIPE, **changes}))
    return str(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, one_worker: WorkEngine) -> Path:
    folder = tmp_path_factory.mktemp("seen")
    recipe = load_recipe(recipe_file(folder))
    summary = make_dataset(recipe, COUNT, str(folder / "set"), one_worker)
    assert summary.failures == ()
    return folder / "set"


@pytest.fixture(scope="module")
def dataset(made: Path) -> Dataset:
    return slamsim.dataset.open(made)


@pytest.mark.long
def test_tables_hold_the_images_of_the_recording(made: Path, dataset: Dataset) -> None:
    sequence = dataset[0]
    with open_cameras(made / sequence.name) as cameras:
        for topic in cameras.topics:
            table = sequence.images(Path(table_of(topic)).stem)
            frames = list(cameras.frames({topic}))
            assert len(frames) == len(table.table) > 5
            assert table.stamps_ns.tolist() == [frame.stamp_ns for frame in frames]
            np.testing.assert_array_equal(table.K, cameras.model(topic).K)
            for row, frame in enumerate(frames):
                np.testing.assert_array_equal(table.at(row), frame.pixels)
    assert dataset[0].row["quality.images.front_color"] == len(frames)


@pytest.mark.long
def test_truth_is_lossless(made: Path, dataset: Dataset) -> None:
    sequence = dataset[0]
    kinds = {"32FC1": "<f4", "32FC3": "<f4", "32SC1": "<i4", "8UC1": "<u1", "32FC2": "<f4"}
    told = []
    with open_bag(made / sequence.name / "log") as bag:
        topics = {c.topic for c in bag.of_type("sensor_msgs/msg/Image") if "truth" in c.topic}
        rows = dict.fromkeys(topics, 0)
        for topic, _, data in bag.received(topics):
            message = bag.deserialize(topic, data)
            pixels = np.asarray(message.data, np.uint8).view(kinds[message.encoding])
            found = sequence.images(f"truth/{Path(table_of(topic)).stem}").at(rows[topic])
            if message.encoding == "32FC1":  # depths: what there is not is nan
                pixels = np.where(np.isfinite(pixels) & (pixels > 0.0), pixels, np.nan)
            np.testing.assert_array_equal(found.ravel(), pixels)
            rows[topic] += 1
            told.append(message.encoding)
    assert set(told) == set(kinds)


def test_truth_of_frames_is_that_of_the_motion(dataset: Dataset) -> None:
    sequence = dataset[0]
    rows = np.arange(4)
    poses = sequence.images("front_color").T_map_optical(rows)
    cells = sequence.images("truth/front_color_frame").table.rows(0, 4)
    there = sequence.truth.at(cells["true_stamp_ns"])
    away_m = poses[:, :3, 3] - there.positions_m
    # fixed to the robot: the same distance from its origin at all times
    np.testing.assert_allclose(np.linalg.norm(away_m, axis=1), np.linalg.norm(away_m[0]), atol=1e-6)
    assert (cells["exposure_s"] > 0.0).all()


def test_image_folders_are_those_of_the_recording(made: Path, dataset: Dataset) -> None:
    sequence = dataset[0]
    for layout, topic, name in (
        ("tum_rgbd", "rgb", "front_color"),
        ("tum_rgbd", "depth", "front_depth"),
        ("euroc", "cam0", "front_color"),
        ("euroc", "cam1", "front_grey"),
    ):
        with open_cameras(made / sequence.name / layout) as cameras:
            found = next(each for each in cameras.topics if topic in each)
            frames = list(cameras.frames({found}))
        table = sequence.images(name)
        assert [frame.stamp_ns for frame in frames] == table.stamps_ns.tolist()
        for row in (0, len(frames) - 1):
            pixels = table.at(row)
            if topic == "depth":
                pixels = np.where(pixels < 13.1, pixels, np.nan)
            np.testing.assert_array_equal(frames[row].pixels, pixels)


def test_textures_follow_the_split(dataset: Dataset) -> None:
    assert [one.row["split"] for one in dataset] == ["train", "test"]
    assert [one.config.world.looks.split for one in dataset] == ["train", "test"]


def test_textures_cannot_be_drawn_against_the_split(tmp_path: Path) -> None:
    worlds = [{"world": "tiny", "vary": {"looks.split": {"choice": ["train", "test"]}}}]
    with pytest.raises(InputRefused, match=r"looks\.split: cannot vary: it follows the split"):
        load_recipe(recipe_file(tmp_path, worlds=worlds))


def test_stretches_of_frames_hold_what_is_nearest(dataset: Dataset) -> None:
    beside = ("front_depth", "truth/front_color_instances")
    frames = dataset.frames("front_color", beside, count=3, stride=2)
    expected = [
        (one, first)
        for one in dataset
        for first in range(0, len(one.images("front_color").table) - 2, 2)
    ]
    assert len(frames) == len(expected)
    for number, (sequence, first) in enumerate(expected):
        window = frames[number]
        for name in ("front_color", *beside):
            table = sequence.images(name)
            for place, stamp_ns in enumerate(window["stamps_ns"]):
                apart = [abs(int(s) - int(stamp_ns)) for s in table.stamps_ns]
                row = apart.index(min(apart))
                np.testing.assert_array_equal(window[name][place], table.at(row))
        rows = np.arange(first, first + 3)
        poses = sequence.images("front_color").T_map_optical(rows)
        np.testing.assert_array_equal(window["T_map_optical"], poses)
        assert window["sequence"] == sequence.row["index"]
    again = pickle.loads(pickle.dumps(frames))
    np.testing.assert_array_equal(again[-1]["front_color"], frames[len(frames) - 1]["front_color"])


def test_windows_of_scans_come_with_images(dataset: Dataset) -> None:
    window = dataset.windows(scans=4, stride=4, images=("front_color",))[1]
    table = dataset[0].images("front_color")
    for image, stamp_ns in zip(window["front_color"], window["true_stamps_ns"], strict=True):
        row = int(np.argmin(np.abs(table.stamps_ns - stamp_ns)))
        np.testing.assert_array_equal(image, table.at(row))


def test_images_that_are_not_there_are_named(dataset: Dataset) -> None:
    with pytest.raises(NotFound, match="'back'; there are front_color, front_depth, front_grey"):
        dataset.frames("back")
    with pytest.raises(NotFound, match=r"truth/front_color_masks\.parquet"):
        dataset.frames("front_color", ("truth/front_color_masks",))[0]
    with pytest.raises(ValueError, match="are none"):
        dataset.frames("front_color", count=0)


def test_the_card_shows_the_cameras(made: Path, dataset: Dataset) -> None:
    card = (made / "README.md").read_text()
    assert "| `front_color` | none | color | 48 x 32 | 5 | jpeg | depth, normals," in card
    for one in dataset:
        picture = f"{one.name}/images/frames.png"
        assert f"]({picture})" in card and (made / picture).is_file()


def test_a_changed_image_is_found(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path / "set")
    path = tmp_path / "set" / "train/000000/images/front_color.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    found = verify(str(tmp_path / "set"))
    assert [one.path for one in found.findings] == ["train/000000/images/front_color.parquet"]


def test_groups_of_rows_do_not_depend_on_windows(made: Path) -> None:
    file = pq.ParquetFile(made / "train/000000/images/front_color.parquet")
    groups = [file.metadata.row_group(number).num_rows for number in range(file.num_row_groups)]
    assert groups[:-1] == [8] * (len(groups) - 1) and 0 < groups[-1] <= 8


def test_formats_do_not_change_each_other(made: Path, tmp_path: Path) -> None:
    recipe = load_recipe(recipe_file(tmp_path, formats=["euroc"]))
    folder = tmp_path / "train" / "000000"
    folder.mkdir(parents=True)
    produce(sequence_spec(recipe, 0, COUNT), folder)
    files = sorted(p.relative_to(folder) for p in (folder / "euroc").rglob("*") if p.is_file())
    assert len(files) > 20
    for name in files:
        assert (folder / name).read_bytes() == (made / "train/000000" / name).read_bytes()
    assert not (folder / ".log").exists() and not (folder / "images").exists()


def test_a_robot_without_cameras_has_no_image_folders(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=r"euroc holds images, but .* no camera"):
        load_recipe(recipe_file(tmp_path, formats=["euroc"], config={}))


@pytest.mark.long
@pytest.mark.parametrize("name", ["diverse_rgbd", "stereo_imu"])
def test_bundled_recipes_have_cameras_and_many_looks(name: str) -> None:
    recipe = load_recipe(name)
    specs = [sequence_spec(recipe, index, 40) for index in range(0, 40, 2)]
    assert all(spec.config.sensors.additional for spec in specs)
    assert len({spec.config.world.looks.family for spec in specs}) == 5
    for spec in specs:
        assert spec.config.world.looks.split == ("test" if spec.split == "test" else "train")


IMAGES = st.tuples(
    st.sampled_from(["u1", "u2", "i4", "f4", "f8"]),
    st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 3)),
    st.integers(0, 2**32),
)


@given(IMAGES)
def test_planes_give_every_bit_back(drawn: tuple[str, tuple[int, int, int], int]) -> None:
    dtype, shape, seed = drawn
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    content = np.random.default_rng(seed).integers(0, 256, size, np.uint8)
    pixels: NDArray[Any] = content.view(dtype).reshape(shape)  # nan of all sorts among the floats
    packed = pack_planes(pixels)
    assert unpack_planes(packed, shape, dtype).tobytes() == pixels.tobytes()
    with pytest.raises(ValueError, match=r"cut|damaged"):
        unpack_planes(packed[:-1], shape, dtype)
    with pytest.raises(ValueError, match="not"):
        unpack_planes(packed, (shape[0] + 1, *shape[1:]), dtype)


def test_smooth_depth_becomes_small() -> None:
    rows, columns = np.mgrid[0:240, 0:424]
    depth_m = (2.0 + 0.001 * rows + 0.0005 * columns).astype(np.float32)
    sizes = [len(pack_planes(depth_m)), depth_m.nbytes]
    assert 3 * sizes[0] < sizes[1]


@pytest.mark.parametrize(
    ("encoding", "size", "error", "match"),
    [
        ("32FC1; planes", (4, 4), ValueError, "not 64"),
        ("64FC1; planes", (2, 2), ValueError, "64FC1"),
        ("32FC1; planes", (10**6, 10**6), Excessive, "pixels"),
        ("rgb8; jpeg compressed bgr8", (2, 2), ValueError, "PNG"),
    ],
)
def test_bad_rows_are_refused(
    encoding: str, size: tuple[int, int], error: type[Exception], match: str
) -> None:
    data = pack_planes(np.ones((2, 2), np.float32))
    with pytest.raises(error, match=match):
        pixels_of(encoding, data, size)


def test_stamps_of_images_grow(dataset: Dataset) -> None:
    assert len(dataset) > 0
    for one in dataset:
        stamps = one.images("front_color").stamps_ns.tolist()
        assert len(stamps) > 1
        assert all(before < after for before, after in pairwise(stamps))
