"""What slamsim seals: folders of every kind, and all that reads them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from slamsim.config.loading import load_run_config, load_simulated_config, load_world_config
from slamsim.console.reporter import Reporter
from slamsim.dataset import open as open_dataset
from slamsim.dataset.catalogue.verify import verify as verify_dataset
from slamsim.dataset.make.engines.local import LocalEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.recipe.distributions import Constant
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.sequence import LogFormat
from slamsim.io.open import read_log, read_recording, read_truth
from slamsim.io.text.keyframes import read_keyframes
from slamsim.io.text.tum import read_tum
from slamsim.report.viewer.process import recording_of
from slamsim.run.dataset.telling import run_stats
from slamsim.run.fixing import fix_log
from slamsim.run.localising import read_known_map
from slamsim.run.mapping import map_world
from slamsim.run.recording import export_world, simulate_world
from slamsim.run.verifying import verify_path
from slamsim.slam.mapping.saved_map import read_saved_map
from slamsim.world.map_server import read_map

QUIET = Reporter(quiet=True)
SHORT = ("drive.route.max_duration_s=8", "sensors.lidar.rate_hz=10")

Reader = Callable[[Path], object]


@dataclass(frozen=True, slots=True)
class Sealed:
    """A sealed folder. readers: what reads it, by name. damaged: what verify names."""

    name: str
    folder: Path
    readers: Mapping[str, Reader]
    damaged: Callable[[Path], set[str]]


def named_by_verify(folder: Path) -> set[str]:
    return {Path(damage.path).name for damage in verify_path(folder).damaged}


def _named_of_dataset(folder: Path) -> set[str]:
    return {Path(finding.path).name for finding in verify_dataset(str(folder), workers=1).findings}


def _recording(name: str) -> dict[str, Reader]:
    return {
        "log": lambda folder: read_log(folder / name),
        "recording": lambda folder: read_recording(folder / name),
        "truth": lambda folder: read_truth(folder / name),
    }


OF_WORLD: dict[str, Reader] = {
    "world": lambda folder: load_world_config(str(folder / "world.yaml")).model_dump(),
    "config": lambda folder: load_simulated_config(folder / "config.yaml").model_dump(),
    "ground truth": lambda folder: read_tum(folder / "ground_truth.tum"),
}
OF_MAP: dict[str, Reader] = {
    "trajectory": lambda folder: read_tum(folder / "trajectory.tum"),
    "odometry": lambda folder: read_tum(folder / "odometry.tum"),
    "parts": lambda folder: [read_tum(path) for path in sorted((folder / "parts").iterdir())],
    "key frames": lambda folder: read_keyframes(folder / "keyframes.csv"),
    "map": lambda folder: read_map(folder / "map.yaml"),
    "saved map": lambda folder: read_saved_map(folder / "session.npz"),
    "known map": read_known_map,
    "view": lambda folder: recording_of(folder).read_bytes(),
}
SIMULATED = {**_recording("log"), **OF_WORLD}


def of_run(folder: Path) -> Sealed:
    """What ``slamsim map`` of a world leaves."""
    config = load_run_config("tiny", overrides=SHORT)
    map_world(config, folder, QUIET)
    return Sealed("map", folder, {**SIMULATED, **OF_MAP}, named_by_verify)


def of_simulation(folder: Path) -> Sealed:
    """What ``slamsim simulate`` leaves."""
    simulate_world(load_run_config("tiny", overrides=SHORT), folder, QUIET)
    return Sealed("simulate", folder, SIMULATED, named_by_verify)


def of_fix(folder: Path) -> Sealed:
    """What ``slamsim fix`` leaves of a recording whose laser is turned."""
    from slamsim.config.faults import typed_choices

    config = load_run_config("tiny", overrides=("drive.route.max_duration_s=30", *SHORT[1:]))
    with tempfile.TemporaryDirectory() as damaged:
        run = Path(damaged) / "damaged"
        faults = (*config.faults, *typed_choices(["lidar_late:0.2"]))
        simulate_world(config.model_copy(update={"faults": faults}), run, QUIET)
        fix_log(run, folder, "all", QUIET)
    return Sealed("fix", folder, _recording("."), named_by_verify)


def of_world(folder: Path) -> Sealed:
    """What ``slamsim world`` leaves."""
    export_world(load_run_config("tiny"), folder)
    readers: dict[str, Reader] = {
        "map": lambda folder: read_map(folder / "map.yaml"),
        "world": lambda folder: load_world_config(str(folder / "world.yaml")).model_dump(),
        "mesh": lambda folder: _built(folder / "world.stl"),
    }
    return Sealed("world", folder, readers, named_by_verify)


def _built(mesh: Path) -> object:
    from slamsim.world.build import build_world

    return build_world(load_world_config(str(mesh)), seed=0).mesh


def of_dataset(folder: Path) -> Sealed:
    """What ``slamsim dataset make`` leaves, in every format."""
    changed = {"duration_s": Constant(constant=4.0), "formats": get_args(LogFormat)}
    with LocalEngine(1) as engine:
        make_dataset(load_recipe("tiny").model_copy(update=changed), 4, str(folder), engine)
    return sealed_dataset(folder)


def sealed_dataset(folder: Path) -> Sealed:
    """A finished data set as a sealed folder."""
    readers: dict[str, Reader] = {
        "manifest": lambda folder: open_dataset(folder).manifest.to_pylist(),
        "statistics": lambda folder: run_stats(str(folder), QUIET),
        "recipe": lambda folder: load_recipe(str(folder / "recipe.yaml")).model_dump(),
    }
    for sequence in open_dataset(folder):
        readers |= _of_sequence(sequence.name, folder)
    return Sealed("data set", folder, readers, _named_of_dataset)


def _of_sequence(name: str, folder: Path) -> dict[str, Reader]:
    def read(attribute: str, of: str = "") -> Reader:
        def value(folder: Path) -> object:
            sequence = open_dataset(folder)[name]
            return getattr(getattr(sequence, of) if of else sequence, attribute)

        return value

    plain = ("scans", "imu", "odometry", "encoders", "config")
    true = ("motion", "scans", "imu", "encoders", "pairs", "surfaces", "occupancy")
    places = [folder / name / "log", folder / name / "parquet"]
    places += sorted((folder / name).rglob("*.log*"))
    readers = {f"{name} {one}": read(one) for one in plain}
    readers |= {f"{name} truth {one}": read(one, "truth") for one in true}
    for place in places:
        for one, reader in _recording(str(place.relative_to(folder))).items():
            readers[f"{name} {place.name} {one}"] = reader
    for path in sorted((folder / name).rglob("*.tum")):
        part = path.relative_to(folder)
        readers[f"{name} {path.name}"] = lambda folder, part=part: read_tum(folder / part)  # type: ignore[misc]
    return readers


KINDS: Sequence[Callable[[Path], Sealed]] = (
    of_run, of_simulation, of_fix, of_world, of_dataset,
)  # fmt: skip
