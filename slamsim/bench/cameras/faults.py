"""``slamsim bench check --cameras``: faults of cameras named, and healthy cameras left alone.

Each seed draws a world, a camera, where it sits and how the robot drives; images are small, for
what questions rest on are thumbnails. A drive is rendered once; a fault is put into the recording
as ``slamsim fault`` does, in a copy of it only where pixels change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.bench.logs import Children, each_done, kept_or_temporary, simulated_log
from slamsim.check.check import check_recording
from slamsim.config.faults import FaultChoice, typed_choices
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import OverrideRefused, SlamsimError
from slamsim.io import LOG
from slamsim.io.cameras.survey import read_with_cameras
from slamsim.recording import Recording
from slamsim.run.fixing import inject_faults
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import chosen_fault, injected, load_fault

Fault = tuple[str, float | None]
"""Name and size, None for the one that is clearly harmful."""

FAULTS: Sequence[Fault] = (
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


@dataclass(frozen=True, slots=True)
class CameraCampaign:
    """What to run: of each of ``seeds`` the healthy recording and six or seven of ``FAULTS``, turn
    by turn, or all of ``faults``; of ``clean_seeds`` the healthy one alone.

    workers: drives at a time. kept: folder of simulated logs, as ``simulated_log`` keeps and finds
    them; None for none that outlives its trials.
    """

    seeds: Sequence[int]
    clean_seeds: Sequence[int] = ()
    faults: Sequence[Fault] | None = None
    seconds: float = SECONDS
    workers: int = 1
    kept: Path | None = None

    def drives(self) -> list[tuple[int, Sequence[Fault]]]:
        """The seed of each drive, and which faults its recording gets."""
        own = self.faults
        faulty = [(s, faults_of(i) if own is None else own) for i, s in enumerate(self.seeds)]
        return [*faulty, *((seed, ()) for seed in self.clean_seeds)]


def run_camera_check(campaign: CameraCampaign, reporter: Reporter) -> dict[str, object]:
    """Shares and false alarms over all drives, each told as it is done; one that fails is told and
    counted."""
    trials: list[CameraTrial] = []
    failures: list[dict[str, object]] = []
    drives = campaign.drives()
    jobs = [partial(_tried, campaign, *drive) for drive in drives]
    with (
        reporter.stage("cameras", "drives") as progress,
        each_done(jobs, campaign.workers) as done,
    ):
        for count, (seed, result) in enumerate(done, 1):
            if isinstance(result, str):
                failures.append({"seed": seed, "error": result})
                reporter.say(f"seed {seed}: failed: {result}")
            else:
                trials += result
                reporter.say("\n".join(map(_line, result)))
            progress(count, len(drives))
    trials.sort(key=lambda trial: trial.seed)
    figures = summary(trials) | {"failed": len(failures)}
    reporter.table("Cameras", {name: str(value) for name, value in figures.items()})
    return {**figures, "trials": [asdict(trial) for trial in trials], "failures": failures}


def typed_faults(text: str) -> tuple[Fault, ...]:
    """Faults of cameras as typed, name,name:size,...; raises OverrideRefused for another."""
    choices = typed_choices(text.split(","))
    for choice in choices:
        if not isinstance(chosen_fault(choice), CameraFault):
            known = ", ".join(dict.fromkeys(name for name, _ in FAULTS))
            raise OverrideRefused(
                f"--faults {choice.name}", f"is none of cameras; these are: {known}"
            )
    return tuple((choice.name, choice.size) for choice in choices)


def faults_of(number: int) -> tuple[Fault, ...]:
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


def _tried(
    campaign: CameraCampaign, seed: int, faults: Sequence[Fault], children: Children
) -> tuple[int, list[CameraTrial] | str]:
    """The seed of a drive and its trials, or why there are none."""
    needs_oak = any(each in _OF_OAK_D for each in faults)
    scenario = random_scenario(seed, campaign.seconds, "oak_d" if needs_oak else "")
    try:
        with kept_or_temporary(campaign.kept) as logs:
            # By camera: a seed whose faults need an OAK-D drives with one in place of its own.
            log = simulated_log(scenario.config, logs / scenario.preset, children) / LOG
            return seed, children.run(_trials, scenario, log, faults)
    except SlamsimError as error:
        return seed, str(error)


def _trials(scenario: CameraScenario, log: Path, faults: Sequence[Fault]) -> list[CameraTrial]:
    recording = read_with_cameras(log)
    trials = [_checked(scenario, recording, "", None)]
    with TemporaryDirectory(prefix="slamsim-cameras-") as folder:
        for number, (name, size) in enumerate(faults):
            choice = FaultChoice(name=name, size=size)
            corrupted = injected(recording, [chosen_fault(choice)], scenario.seed)
            if any(camera.changes for camera in corrupted.cameras):
                copy = Path(folder) / str(number)
                inject_faults(log, copy, [choice], seed=scenario.seed)
                corrupted = read_with_cameras(copy)
            trials.append(_checked(scenario, corrupted, name, size))
    return trials


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
