"""``slamsim bench check --cameras``: faults of cameras named, and healthy cameras left alone.

Each seed draws a world, a camera, where it sits and how the robot drives; images are small, for
what questions rest on are thumbnails. A drive is rendered once; a fault is put into the recording
as ``slamsim fault`` does, in a copy of it only where pixels change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.bench.logs import Children, kept_or_temporary, simulated_log
from slamsim.check.check import check_recording
from slamsim.config.faults import FaultChoice
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.randomness import random_stream
from slamsim.io import LOG
from slamsim.io.cameras.survey import read_with_cameras
from slamsim.recording import Recording
from slamsim.run.fixing import inject_faults
from slamsim.sensors.faults.registry import chosen_fault, injected, load_fault

FAULTS: Sequence[tuple[str, float | None]] = (
    *(("camera_late", 0.05), ("camera_late", 0.1), ("camera_late", -0.1), ("camera_late", 0.3)),
    *(("depth_late", 0.03), ("depth_late", 0.04), ("depth_late", -0.045)),
    *(("camera_info_size", 2.0), ("camera_info_size", 0.5)),
    *(("camera_info_focal", 0.05), ("camera_info_focal", -0.1), ("camera_info_focal", 0.2)),
    *(("camera_info_folds", -3.0), ("camera_info_folds", -6.0)),
    *(("depth_scale", 0.03), ("depth_scale", -0.04), ("depth_scale", 0.1), ("depth_unit", None)),
    *(("camera_frozen", 1.0), ("camera_frozen", 3.0)),
    *(("camera_duplicates", 0.2), ("camera_duplicates", 0.5)),
    *(("camera_flicker", 0.15), ("camera_flicker", 0.3), ("stereo_swapped", None)),
    *(("camera_turned", 2.0), ("camera_turned", -3.0), ("camera_turned", 8.0)),
    *(("camera_moved", 0.06), ("camera_moved", -0.1)),
    *(("camera_tilted", 3.0), ("camera_tilted", -5.0), ("camera_tilted", 10.0)),
    *(("camera_readout", 0.02), ("camera_readout", 0.03), ("camera_readout", -0.02)),
    *(("camera_damaged", 0.01), ("camera_damaged", 0.2), ("camera_moved", 0.2)),
)
"""Thirty-nine, with sizes from barely harmful on. Red and blue exchanged is none of them: the
drives have one colour camera each, which alone does not tell."""
_OF_OAK_D = (("stereo_swapped", None), ("camera_readout", -0.02))
"""What only a stereo pair can have, and a camera whose shutter rolls."""
PER_SEED = 6
SECONDS = 40.0
"""Enough turns and standing for most questions about cameras to be answered: on some drives of the
world loop the robot turns by less than a radian, and shutters are not told."""
_WORLDS = ("labyrinth", "rooms", "loop")
_PRESETS = {
    "realsense_d435": ("color", "depth"),
    "realsense_d455": ("color", "depth"),
    "oak_d": ("color", "left", "right", "depth"),
}


@dataclass(frozen=True, slots=True)
class CameraTrial:
    """One recording that was checked. fault: empty for a healthy one. said: names of the faults
    that were told; false: those that are not there."""

    seed: int
    world: str
    preset: str
    fault: str
    size: float | None
    said: tuple[str, ...]
    false: tuple[str, ...]
    is_named: bool


@dataclass(frozen=True, slots=True)
class CameraScenario:
    """What a seed stands for."""

    seed: int
    world: str
    preset: str
    config: RunConfig


def random_scenario(seed: int, seconds: float, preset: str = "") -> CameraScenario:
    """Always the same of a seed. preset: of the camera, drawn if empty."""
    rng = random_stream(seed, "bench check", "cameras")
    world, drawn = str(rng.choice(_WORLDS)), str(rng.choice(list(_PRESETS)))
    name = preset or drawn
    mount = {
        **{"x_m": rng.uniform(0.05, 0.2), "y_m": rng.uniform(-0.05, 0.05)},
        **{"z_m": rng.uniform(0.2, 0.45), "yaw_deg": rng.uniform(-20.0, 20.0)},
    }
    about = ", ".join(f"{key}: {value:.3f}" for key, value in mount.items())
    lens = "{lens: {width: 160, height: 120}}"
    shown = dict.fromkeys(_PRESETS[name], lens)
    if name.startswith("realsense"):
        shown |= {"infra1": "{enabled: false}", "infra2": "{enabled: false}"}
    imagers = ", ".join(f"{key}: {value}" for key, value in shown.items())
    camera = f"type: camera, name: cam, preset: {name}, rate_hz: 10, mount: {{{about}}}"
    overrides = [
        f"drive.route.max_duration_s={seconds:.1f}",
        f"sensors.additional=[{{{camera}, imagers: {{{imagers}}}}}]",
    ]
    return CameraScenario(seed, world, name, load_run_config(world, None, overrides, seed))


def run_camera_check(
    seeds: Sequence[int],
    clean_seeds: Sequence[int],
    seconds: float | None,
    kept: Path | None,
    reporter: Reporter,
) -> dict[str, object]:
    """Shares and false alarms over all of them, each told as it is done.

    Of each of ``seeds`` six or seven of the faults, turn by turn, and the healthy recording; of
    ``clean_seeds`` the healthy one alone. kept: folder of simulated logs, as ``simulated_log``
    keeps and finds them; None for none that outlives its trials.
    """
    trials: list[CameraTrial] = []
    runs = [(s, faults_of(i)) for i, s in enumerate(seeds)] + [(s, ()) for s in clean_seeds]
    count = sum(1 + len(faults) for _, faults in runs)
    with Children() as children, reporter.stage("cameras", "recordings") as progress:
        for seed, faults in runs:
            for trial in _trials(seed, faults, seconds or SECONDS, kept, children):
                trials.append(trial)
                reporter.say(_line(trial))
                progress(len(trials), count)
    figures = summary(trials)
    reporter.table("Cameras", {name: str(value) for name, value in figures.items()})
    return {**figures, "trials": [asdict(trial) for trial in trials]}


def faults_of(number: int) -> tuple[tuple[str, float | None], ...]:
    """Of the drive with this number: every sixth of all, so that six drives have them all."""
    rounds = len(FAULTS) // PER_SEED
    return tuple(FAULTS[number % rounds :: rounds])


def summary(trials: Sequence[CameraTrial]) -> dict[str, object]:
    """Named is a fault with a right name told and nothing false beside it."""
    faulty = [trial for trial in trials if trial.fault]
    healthy = [trial for trial in trials if not trial.fault]
    named = sum(trial.is_named for trial in faulty)
    return {
        "camera_faults": len(faulty),
        "camera_named_share": named / len(faulty) if faulty else None,
        "camera_clean": len(healthy),
        "camera_false_alarms": sum(bool(trial.false) for trial in healthy),
    }


def _trials(
    seed: int,
    faults: Sequence[tuple[str, float | None]],
    seconds: float,
    kept: Path | None,
    children: Children,
) -> Iterator[CameraTrial]:
    needs_oak = any(each in _OF_OAK_D for each in faults)
    scenario = random_scenario(seed, seconds, "oak_d" if needs_oak else "")
    with (
        kept_or_temporary(kept) as logs,
        TemporaryDirectory(prefix="slamsim-cameras-") as folder,
    ):
        # By camera, since a seed whose faults need an OAK-D drives with one in place of its own.
        log = simulated_log(scenario.config, logs / scenario.preset, children) / LOG
        recording = read_with_cameras(log)
        yield _checked(scenario, recording, "", None)
        for number, (name, size) in enumerate(faults):
            choice = FaultChoice(name=name, size=size)
            corrupted = injected(recording, [chosen_fault(choice)], seed)
            if any(camera.changes for camera in corrupted.cameras):
                copy = Path(folder) / str(number)
                inject_faults(log, copy, [choice], seed=seed)
                corrupted = read_with_cameras(copy)
            yield _checked(scenario, corrupted, name, size)


def _checked(
    scenario: CameraScenario, recording: Recording, name: str, size: float | None
) -> CameraTrial:
    """Healthy ones are asked everything, others all but what compares scans alone."""
    report = check_recording(recording, quick=bool(name))
    said = tuple(sorted({str(finding.fault) for finding in report.faults}))
    right = {load_fault(name).expects} if name else set()
    allowed = right | (set(load_fault(name).also) if name else set())
    false = tuple(each for each in said if each not in allowed)
    is_named = bool(right & set(said)) and not false
    about = (scenario.seed, scenario.world, scenario.preset)
    return CameraTrial(*about, name, size, said, false, is_named)


def _line(trial: CameraTrial) -> str:
    size = "" if trial.size is None else f":{trial.size:g}"
    what = f"{trial.fault}{size}" if trial.fault else "clean"
    is_good = trial.is_named if trial.fault else not trial.false
    verdict = "" if is_good else " (wrong)"
    about = f"seed {trial.seed} {trial.world} {trial.preset}"
    return f"{about}: {what}: {', '.join(trial.said) or 'nothing'}{verdict}"
