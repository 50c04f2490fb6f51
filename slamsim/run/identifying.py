"""``slamsim identify``: fit, report, and write a folder with the robot."""

from __future__ import annotations

from pathlib import Path

from rich.progress import BarColumn, TextColumn

from slamsim.config.measurements import MeasurementsConfig
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS
from slamsim.console.reporter import Reporter, TimeColumn
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.run.scenario import tell
from slamsim.run.scenario_folder import told, write_results
from slamsim.scenarios.base import ScenarioResult
from slamsim.scenarios.identify.findings import identification_found
from slamsim.scenarios.identify.identify import Identified
from slamsim.scenarios.identify.identify import identify as identified
from slamsim.scenarios.identify.robot_file import robot_file as written
from slamsim.sim.engine import engine_parameters

SEED = 0
"""All random numbers of an identification are always the same."""


def identify_and_report(
    config: MeasurementsConfig,
    command: str,
    folder: Path,
    reporter: Reporter,
    *,
    robot_file: Path | None = None,
    jobs: int | None = None,
    overwrite: bool = False,
) -> None:
    """Raises SlamsimError. command: what was typed; robot_file: where else the robot is to go."""
    with partial_folder(folder, overwrite) as partial:
        found = _identified(config, reporter, jobs)
        result = ScenarioResult(
            name="identify",
            title=f"Identification of {config.name}",
            config=config,
            rows=found.rows,
            findings=identification_found(found),
            scenes=(),
            engine=engine_parameters(SCENARIO_PHYSICS),
        )
        robot = written(found, command).encode()
        write_results(partial, [result], config, SEED)
        write_atomic(partial / f"{found.robot.name}.yaml", robot)
        if robot_file is not None:
            write_atomic(robot_file, robot)
    tell(result, reporter)
    reporter.say(f"The robot: {folder / f'{found.robot.name}.yaml'}")
    reporter.say(f"Look at {folder}/report.html")
    reporter.result({**told([result], SEED, with_rows=False), "folder": str(folder)})


def _identified(config: MeasurementsConfig, reporter: Reporter, jobs: int | None) -> Identified:
    columns = (TextColumn("{task.description:<14}"), BarColumn(bar_width=30), TimeColumn())
    with reporter.bars(*columns) as bars:
        task = bars.add_task("fit", total=1.0)

        def listen(stage: str, share: float) -> None:
            bars.update(task, description=stage, completed=share)

        return identified(config, jobs=jobs, listen=listen)
