"""The command line: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim import __version__
from slamsim.bench.command import bench
from slamsim.cli.calibrate_command import EPILOG as CALIBRATE_EPILOG
from slamsim.cli.calibrate_command import calibrate
from slamsim.cli.check_command import CHECK_EPILOG, FIX_EPILOG, check, fix
from slamsim.cli.common import Commands, Reporter, close_run, config_of, loaded_config
from slamsim.cli.convert_command import EPILOG as CONVERT_EPILOG
from slamsim.cli.convert_command import convert
from slamsim.cli.dataset_command import dataset
from slamsim.cli.demo_command import EPILOG as DEMO_EPILOG
from slamsim.cli.demo_command import demo
from slamsim.cli.fault_command import fault
from slamsim.cli.identify_command import EPILOG as IDENTIFY_EPILOG
from slamsim.cli.identify_command import identify
from slamsim.cli.info_command import EPILOG as INFO_EPILOG
from slamsim.cli.info_command import info
from slamsim.cli.live_command import LIVE_EPILOG, REPLAY_EPILOG, live, replay
from slamsim.cli.map_command import LOCALISE_EPILOG, MAP_EPILOG, localise, map_
from slamsim.cli.odometry_command import EPILOG as ODOMETRY_EPILOG
from slamsim.cli.odometry_command import odometry
from slamsim.cli.recover_command import EPILOG as RECOVER_EPILOG
from slamsim.cli.recover_command import recover
from slamsim.cli.scenario_command import EPILOG as SCENARIO_EPILOG
from slamsim.cli.scenario_command import HELP as SCENARIO_HELP
from slamsim.cli.scenario_command import scenario
from slamsim.cli.verify_command import EPILOG as VERIFY_EPILOG
from slamsim.cli.verify_command import verify
from slamsim.cli.view_command import EPILOG as VIEW_EPILOG
from slamsim.cli.view_command import view
from slamsim.console.options import (
    ConfigFile,
    DriveSeed,
    Faults,
    Out,
    Overwrite,
    Relations,
    Seed,
    Set,
    World,
)

app = Commands(
    name="slamsim",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Simulate a robot in a labyrinth, run SLAM on any recording, and check recordings.",
    epilog="Start with: [bold]slamsim map labyrinth[/bold]",
)


@app.command(epilog="Example: slamsim world labyrinth --seed 7 --out outputs/my_world")
def world(
    reporter: Reporter,
    name: World = "labyrinth",
    out: Out = None,
    seed: Seed = None,
    set_: Set = None,
    config: ConfigFile = None,
    view: Annotated[
        bool, typer.Option("--view", help="Also view.png: what a camera at the start sees.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Build a world: preview, mesh and true occupancy map."""
    from slamsim.console.summary import labelled
    from slamsim.run.naming import output_folder

    loaded = loaded_config(name, config, set_, seed)
    resolved = loaded.config
    called = f"{resolved.world.name}_world"
    with output_folder(out, called, overwrite=overwrite, inputs=loaded.files) as folder:
        from slamsim.run.recording import export_world

        facts = export_world(resolved, folder, with_view=view, overwrite=overwrite)
    reporter.table(f"World {resolved.world.name}", labelled(facts))
    reporter.say(f"Written to {folder}/")
    reporter.result({**facts, "folder": str(folder)})


@app.command(
    epilog="Example: slamsim simulate labyrinth --fault laser_world_fixed --fault lidar_late:0.02"
)
def simulate(
    reporter: Reporter,
    name: World = "labyrinth",
    out: Out = None,
    seed: Seed = None,
    drive_seed: DriveSeed = None,
    set_: Set = None,
    config: ConfigFile = None,
    faults: Faults = None,
    overwrite: Overwrite = False,
) -> Path:
    """Drive through a world and record what the sensors measure."""
    from slamsim.run.naming import output_folder

    loaded = loaded_config(name, config, set_, seed, faults, drive_seed=drive_seed)
    called = loaded.config.world.name
    with output_folder(out, called, overwrite=overwrite, inputs=loaded.files) as folder:
        from slamsim.run.recording import simulate_world

        report = simulate_world(loaded.config, folder, reporter, overwrite=overwrite)
    close_run(reporter, report, folder)
    return folder


app.command("map", epilog=MAP_EPILOG)(map_)
app.command(epilog=LOCALISE_EPILOG)(localise)


@app.command(epilog="Example: slamsim evaluate outputs/labyrinth")
def evaluate(
    reporter: Reporter,
    estimate: Annotated[Path, typer.Argument(help="Folder of a run, or a TUM trajectory.")],
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="True trajectory: TUM file or recording with truth."),
    ] = None,
    relations: Relations = None,
) -> None:
    """Score a trajectory and a map against the truth or against relations."""
    from slamsim.console.summary import labelled
    from slamsim.guard.replaceable import require_apart

    require_apart((), (estimate, truth, relations))  # before libraries are loaded for seconds
    from slamsim.run.evaluation import evaluate_run

    scores = evaluate_run(estimate, truth, relations, reporter)
    reporter.table(f"Scores of {estimate}", labelled(scores))
    reporter.result(scores)


app.command(epilog=LIVE_EPILOG)(live)
app.command(epilog=REPLAY_EPILOG)(replay)
app.command(epilog=INFO_EPILOG)(info)
app.command(epilog=CHECK_EPILOG)(check)
app.command(epilog=FIX_EPILOG)(fix)
app.command(epilog=RECOVER_EPILOG)(recover)
app.command(epilog=CONVERT_EPILOG)(convert)
app.command(epilog=ODOMETRY_EPILOG)(odometry)
app.command(epilog=CALIBRATE_EPILOG)(calibrate)
app.command(epilog=DEMO_EPILOG)(demo)
app.command(help=SCENARIO_HELP, epilog=SCENARIO_EPILOG)(scenario)
app.command(epilog=IDENTIFY_EPILOG)(identify)
app.command(epilog=VERIFY_EPILOG)(verify)
app.add_typer(dataset)


app.command(epilog=VIEW_EPILOG)(view)


app.command(
    epilog="Examples: slamsim bench --json · slamsim bench accuracy --seeds 20 --logs outputs/bench"
)(bench)


app.command(epilog="Example: slamsim fault my_rosbag2/ faulty/ --fault laser_yaw:2")(fault)


@app.command(epilog="Example: slamsim config --set sensors.lidar=rplidar_a2 > my_run.yaml")
def config(
    name: World = "labyrinth",
    config: ConfigFile = None,
    set_: Set = None,
    seed: Seed = None,
) -> None:
    """Print every setting with its unit and meaning, as YAML that can be used again."""
    from slamsim.config.dump import dump_commented_yaml
    from slamsim.console.reporter import write_result

    write_result(dump_commented_yaml(config_of(name, config, set_, seed), untold=()))


def _version(asked: bool) -> None:
    if asked:
        from slamsim.console.reporter import write_result

        write_result(f"slamsim {__version__}\n")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
