"""``slamsim demo rotation-bug``: the rotation bug of the study, found and repaired."""

from __future__ import annotations

from pathlib import Path

from slamsim.config.faults import FaultChoice
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import Log
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io import LOG
from slamsim.io.open import read_log, read_recording
from slamsim.io.text.tum import read_tum
from slamsim.report.pages.demo import MappedSide, demo_page
from slamsim.report.viewer.demo import write_sides
from slamsim.run import folder as run_folder
from slamsim.run.checking import check_stage
from slamsim.run.fixing import fix_log
from slamsim.run.mapping import map_recording, map_world
from slamsim.run.stages import Stages
from slamsim.slam.mapping.grid import build_grid
from slamsim.world.map_server import read_map

FAULT = "laser_world_fixed"
TORN, REPAIRED, REPAIRED_LOG = "torn", "repaired", "repaired_log"


def rotation_bug(
    config: RunConfig, folder: Path, reporter: Reporter, *, overwrite: bool = False
) -> dict[str, object]:
    """Simulate with rays fixed to the world, map, check, fix, map again, show side by side.

    The study's Figures 30 and 32. Leaves two runs, the repaired recording, ``report.html`` and
    ``run.rrd``; returns the faults found and both ATE. Raises SlamsimError.
    """
    faulty = config.model_copy(update={"faults": (FaultChoice(name=FAULT),)})
    with partial_folder(folder, overwrite) as partial:
        torn, repaired, log = (partial / name for name in (TORN, REPAIRED, REPAIRED_LOG))
        reporter.note("1. Simulate a drive with the rotation bug and map it")
        before_m = map_world(faulty, torn, reporter).numbers["ate_rmse_m"]
        reporter.note("2. Check the recording and repair it")
        verdict = check_stage(read_recording(torn / LOG), Stages(reporter))
        left = fix_log(torn, log, "all", reporter.without_result())
        reporter.note("3. Map the repaired recording")
        after_m = map_recording(log, config, repaired, reporter).numbers["ate_rmse_m"]
        sides = (
            _side("torn", "As recorded", torn, read_log(torn / LOG), config, before_m),
            _side("repaired", "After slamsim fix", repaired, read_log(log), config, after_m),
        )
        write_atomic(partial / run_folder.REPORT, demo_page(verdict, sides).encode())
        write_sides(partial / run_folder.RECORDING, sides)
    return {
        "faults": [finding.fault for finding in verdict.faults],
        "faults_left": [finding.fault for finding in left.faults],
        **{f"{side.key}_ate_rmse_m": side.ate_m for side in sides},
    }


def _side(
    key: str, title: str, run: Path, log: Log, config: RunConfig, ate_m: object
) -> MappedSide:
    """A finished run, and its scans laid along the path of the wheels as they are."""
    odometry = read_tum(run / run_folder.ODOMETRY).planar()
    return MappedSide(
        key=key,
        title=title,
        laid=build_grid(log.scans, odometry, log.T_base_laser, config.mapping),
        odometry=odometry,
        mapped=read_map(run / "map.yaml"),
        trajectory=read_tum(run / run_folder.TRAJECTORY).planar(),
        ate_m=ate_m if isinstance(ate_m, float) else None,
    )
