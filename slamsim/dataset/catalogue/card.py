"""The data card: ``README.md`` with the front matter that Hugging Face reads, and the licence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import yaml

from slamsim.dataset.catalogue.statistics import Statistics
from slamsim.dataset.make.pictures import PICTURES
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.model import OWN_LICENCE, Recipe
from slamsim.dataset.recipe.sequence import FormatName
from slamsim.guard.quantities import as_size
from slamsim.sensors.kinds.camera import CameraEntry

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))
_FORMATS: Mapping[FormatName, str] = {
    "mcap": "`log/`: rosbag2 (MCAP), as a robot would have recorded it; the truth is on topics "
    "of its own",
    "parquet": "`parquet/`: the same messages as typed tables: `scans`, `imu`, `encoders`, "
    "`odometry`, `joints`, `transforms`",
    "tum": "`tum/`: odometry and true path as TUM trajectories",
    "kitti": "`kitti/`: scans freed of motion and true poses in the layout of KITTI odometry",
    "carmen": "`carmen/log.clf`: a CARMEN log",
    "tum_rgbd": "`tum_rgbd/`: colour and depth images and true path in the layout of TUM RGB-D",
    "euroc": "`euroc/`: images, IMU and true path of the body in the layout of EuRoC (ASL)",
}
_IMAGES = (
    "`images/`: a table of each camera's images with stamps, encoding and JPEG or PNG files, and "
    "the claimed camera in its schema; `frames.png`: some of them",
    "`truth/CAMERA_IMAGER_depth.parquet` and others: lossless truth of every pixel; `..._frame`: "
    "true instant, exposure, and the pose of each row",
)
_TRUTH = (
    "`truth/trajectory.parquet`: the motion at the rate of the physics; any instant follows from "
    "it exactly as every sensor had it",
    "`truth/scans.parquet`: of each beam its true range, the surface that it met "
    "(`truth/surfaces.parquet`) and at which angle",
    "`truth/imu.parquet`, `truth/encoders.parquet`: true stamps, values without error, biases",
    "`truth/pairs.parquet`: which scans see the same walls, how much of them, which close a loop",
    "`truth/occupancy.png` and `.yaml`: the true grid, as ROS map_server reads it",
    "`world.yaml`, `config.yaml`: world and settings; `sequence.json`: numbers, sizes, hashes",
)
_LIMITS = (
    "Everything is simulated: rigid bodies, a flat floor, walls that do not move, no people.",
    "Walls are upright and return light alike at equal range and incidence; lidars meet no glass.",
    "Noise, biases, clock offsets and slip follow models with the sizes that `config.yaml` names.",
    "Splits are by world: no world is in two of them, but all worlds grow from one recipe.",
)
_SHOWN = {
    "quality.duration_s": "duration, s",
    "quality.path_length_m": "path, m",
    "quality.scans": "scans",
    "quality.loop_closures": "loop closures",
    "quality.contact_share": "time touching walls",
    "quality.slip_share": "slip of the wheels",
    "quality.no_return_share": "beams without return",
    "quality.min_clearance_m": "least room to walls, m",
    "quality.seen_share": "floor seen",
    "quality.degenerate_share": "scans that fix no place",
}
_MOST_COUNTS = 12


def data_card(
    recipe: Recipe,
    told: Statistics,
    versions: Mapping[str, str],
    pictures: Iterable[str],
    seen: Sequence[str] = (),
) -> str:
    """told: what ``statistics`` says. pictures: names of the files under ``figures/``. seen: names
    of sequences of which some images are shown."""
    parts = [
        _front_matter(recipe, told),
        f"# {recipe.title}\n\n{_lead(recipe, told)}",
        "![Some of the worlds and the ways through them](preview.png)",
        f"## What it holds\n\n{_contents(recipe, bool(seen))}",
        _cameras(recipe, told, seen),
        f"## How to open it\n\n{_opening(recipe, bool(seen))}",
        f"## Splits\n\n{_splits(told)}",
        f"## Statistics\n\n{_numbers(told)}\n\n{_counts(told)}",
        "\n".join(f"![{name.replace('_', ' ')}](figures/{name}.png)" for name in pictures),
        f"## How it was made\n\n{_making(recipe, told, versions)}",
        f"## Known limits\n\n{_items(_LIMITS)}",
        f"## Licence\n\n{recipe.licence}, see [LICENSE.txt](LICENSE.txt).",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def licence_text(recipe: Recipe) -> str:
    """What ``LICENSE.txt`` says."""
    told = f"{recipe.title}\n\nThis data set is given away under the licence {recipe.licence}"
    if recipe.licence.startswith(OWN_LICENCE):
        return f"{told}.\nAsk the publisher of the data for its full text.\n"
    return (
        f"{told} (SPDX identifier).\nIts full text:\n"
        f"https://spdx.org/licenses/{recipe.licence}.html\n"
    )


def _front_matter(recipe: Recipe, told: Statistics) -> str:
    sizes = (name for most, name in _SIZES if told["sequences"] < most)
    matter = {
        "pretty_name": recipe.title,
        "license": "other" if recipe.licence.startswith(OWN_LICENCE) else recipe.licence.lower(),
        "task_categories": ["robotics"],
        "tags": ["slam", "lidar", "odometry", "synthetic"],
        "size_categories": [next(sizes, "n>1M")],
        "configs": _tables(recipe, told),
    }
    return f"---\n{yaml.safe_dump(matter, sort_keys=False, allow_unicode=True, width=100)}---"


def _tables(recipe: Recipe, told: Statistics) -> list[dict[str, Any]]:
    """What ``datasets.load_dataset`` gives by name: the manifest, and tables of all sequences."""
    whole = {"config_name": "manifest", "data_files": "manifest.parquet", "default": True}
    found = list[dict[str, Any]]([whole])
    if "parquet" not in recipe.formats or not told["splits"]:
        return found
    beams = told["numbers"].get("quality.beams", {"least": 0, "most": 1})
    one_lidar = beams["least"] == beams["most"]
    for name in ("imu", "encoders", "odometry", *(["scans"] if one_lidar else [])):
        files = [
            {"split": split, "path": f"{split}/*/parquet/{name}.parquet"}
            for split in told["splits"]
        ]
        found.append({"config_name": name, "data_files": files})
    return found


def _lead(recipe: Recipe, told: Statistics) -> str:
    failed = f", of which {told['failed']:,} could not be made" if told["failed"] else ""
    return (
        f"`{recipe.name}`: {told['sequences']:,} simulated recordings{failed} in "
        f"{told['worlds']:,} worlds, {told['simulated_h']:,.3g} hours and "
        f"{told['path_km']:,.3g} km of driving, {told['scans']:,} laser scans, "
        f"{as_size(told['size_bytes'])}, with the complete truth of each."
    )


def _cameras(recipe: Recipe, told: Statistics, seen: Sequence[str]) -> str:
    """The cameras of the first sequence, which others may have with other values, and pictures."""
    if not seen:
        return ""
    sensors = sequence_spec(recipe, 0, told["sequences"]).config.sensors.additional
    rows = [
        (
            f"`{camera.name}_{name}`",
            camera.preset or "none",
            imager.kind,
            f"{imager.lens.width} x {imager.lens.height}",
            f"{camera.rate_hz:g}",
            imager.encoding,
            ", ".join(imager.truth) or "none",
        )
        for camera in sensors
        if isinstance(camera, CameraEntry)
        for name, imager in camera.enabled_imagers.items()
    ]
    head = ("table", "preset", "kind", "pixels", "Hz", "encoding", "truth of each pixel")
    shown = "\n\n".join(f"![Images of {name}]({name}/{PICTURES})" for name in seen)
    return (
        f"## Cameras\n\n{_table(head, rows)}\n\nTextures, colours and posters of the test split "
        "are in no other. From three instants of a sequence: images of each table, then the truth "
        f"of their pixels, depth from 0 (blue) to 6 m (red):\n\n{shown}"
    )


def _contents(recipe: Recipe, has_images: bool) -> str:
    images = _IMAGES if has_images else ()
    formats = _items([*(_FORMATS[name] for name in recipe.formats), *images, *_TRUTH])
    return (
        "One folder for each sequence, `SPLIT/INDEX/`, with\n\n"
        f"{formats}\n\n"
        "and beside them `manifest.parquet`: one row for each sequence with seed, drawn values, "
        "faults, quality numbers, size and hash, and for one that could not be made the reason and "
        "the command that shows it (`DIR`: this folder); `statistics.json`; `recipe.yaml` and "
        "`dataset.yaml`: of what and with which software it was made; `SHA256SUMS`. "
        "In every table of a sequence the column `sequence` is its `index` in the manifest.\n\n"
        "Units are SI and in the names; stamps are integer nanoseconds; frames are right-handed, "
        "x forward, y left, z up; `T_a_b` takes coordinates in b to coordinates in a. No return "
        "is `inf`, an invalid reading `nan`."
    )


def _opening(recipe: Recipe, has_images: bool) -> str:
    lines = [
        "```python",
        "import slamsim.dataset",
        "",
        'dataset = slamsim.dataset.open("PATH OR URL")',
        "sequence = dataset[0]",
        "part = sequence.between(1.0, 3.0)          # seconds of true time",
        "part.truth.poses_at(part.truth.scans.true_stamps_ns)   # (n, 3) x, y, yaw",
    ]
    if "parquet" in recipe.formats:
        lines.insert(-1, "part.scans.ranges_m                        # (n, beams)")
        if has_images:
            lines += ['frames = dataset.frames("CAMERA_IMAGER")   # for a PyTorch DataLoader']
        lines += [
            "",
            "import polars as pl                        # or pyarrow, pandas, datasets",
            "",
            'imu = pl.scan_parquet("PATH/train/*/parquet/imu.parquet")   # of all sequences',
            'rows = pl.scan_parquet("PATH/manifest.parquet")',
            'imu.join(rows, left_on="sequence", right_on="index").collect()',
        ]
    return "\n".join([*lines, "```"])


def _splits(told: Statistics) -> str:
    rows = [
        (
            split,
            f"{part['sequences']:,}",
            f"{part['worlds']:,}",
            f"{part['simulated_h']:,.3g}",
            f"{part['path_km']:,.3g}",
            f"{part['loop_closures']:,}",
        )
        for split, part in told["splits"].items()
    ]
    return _table(("split", "sequences", "worlds", "hours", "km", "loop closures"), rows)


def _numbers(told: Statistics) -> str:
    keys = ("least", "p10", "median", "p90", "most")
    rows = [
        (text, *(f"{told['numbers'][name][key]:.4g}" for key in keys))
        for name, text in _SHOWN.items()
        if name in told["numbers"]
    ]
    return _table(("of a sequence", "least", "10 %", "median", "90 %", "most"), rows)


def _counts(told: Statistics) -> str:
    rows = []
    for name, counts in {**told["drawn"], "faults": told["faults"]}.items():
        shown = [f"{value} {count:,}" for value, count in list(counts.items())[:_MOST_COUNTS]]
        more = [f"{len(counts) - _MOST_COUNTS} more"] if len(counts) > _MOST_COUNTS else []
        rows.append((f"`{name}`", ", ".join([*shown, *more])))
    return _table(("drawn", "sequences"), rows)


def _making(recipe: Recipe, told: Statistics, versions: Mapping[str, str]) -> str:
    software = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        "Each robot was driven with rigid-body physics, then sensed: every beam is cast from the "
        "pose at its own instant, every stream is stamped by a clock of its own. Each sequence "
        f"follows from the recipe's seed ({recipe.seed}) and its index alone; these commands "
        "make the same bytes again and check them:\n\n```bash\n"
        f"slamsim dataset make recipe.yaml -n {told['sequences']} --out FOLDER\n"
        f"slamsim dataset verify FOLDER --again 3\n```\n\nMade with {software}."
    )


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _items(texts: Iterable[str]) -> str:
    return "\n".join(f"- {text}" for text in texts)
