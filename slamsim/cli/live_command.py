"""``slamsim live`` and ``slamsim replay`` as they are typed."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.cli.common import Reporter, loaded_config, selection
from slamsim.console.options import (
    ConfigFile,
    ImuTopic,
    OdomTopic,
    Out,
    Overwrite,
    ScanTopic,
    Seed,
    Set,
    World,
)
from slamsim.guard.errors import SlamsimError, shown

if TYPE_CHECKING:
    from slamsim.live.controls import LiveOptions
    from slamsim.run.live.serving import Ports

LIVE_EPILOG = (
    "Examples: slamsim live labyrinth · slamsim live labyrinth --drive explore --record · "
    "slamsim live rooms --drive tour --rate max --until-done · slamsim live --from ws://robot:9090"
)
REPLAY_EPILOG = "Example: slamsim replay outputs/labyrinth_live/drive_1"


_PROTOCOLS = ("rosbridge", "foxglove")
"""May stand before the URL, though the protocol is found out anyway."""


class Drive(StrEnum):
    """Who drives at first."""

    MANUAL = "manual"
    TOUR = "tour"
    EXPLORE = "explore"


Rate = Annotated[
    str, typer.Option("--rate", help="Times real time, or max for as fast as possible.")
]
Duration = Annotated[
    float | None, typer.Option("--duration", metavar="S", help="End after so much time.", min=0.1)
]
Host = Annotated[
    str,
    typer.Option("--host", help="Address to listen at; beyond this machine a token is required."),
]
PagePort = Annotated[
    int, typer.Option("--page-port", help="Port of the page; 0 for none.", min=0, max=65535)
]
_OTHERS_PORT = "Port of {}; 0 for none (default: {}, with --from none)."
RosbridgePort = Annotated[
    int | None,
    typer.Option(help=_OTHERS_PORT.format("rosbridge", 9090), min=0, max=65535),
]
FoxglovePort = Annotated[
    int | None,
    typer.Option(help=_OTHERS_PORT.format("Foxglove", 8765), min=0, max=65535),
]
From = Annotated[
    str,
    typer.Option(
        "--from",
        metavar="URL",
        help="Map a robot that runs elsewhere: ws://robot:9090 (rosbridge) or ws://robot:8765 "
        "(Foxglove).",
    ),
]

Driven = Annotated[
    Drive, typer.Option("--drive", help="Who drives: you, the tour, or frontier exploration.")
]
Record = Annotated[bool, typer.Option("--record", help="Record from the start, with the commands.")]
UntilDone = Annotated[
    bool, typer.Option("--until-done", help="End when the tour or exploration is over.")
]
WithSlam = Annotated[bool, typer.Option("--slam/--no-slam", help="Map while driving.")]
Checked = Annotated[
    bool, typer.Option("--check/--no-check", help="With --from: check what arrives.")
]
InRerun = Annotated[bool, typer.Option("--rerun", help="Show it in a Rerun viewer.")]


def live(
    reporter: Reporter,
    name: World = "labyrinth",
    from_: From = "",
    drive: Driven = Drive.MANUAL,
    rate: Rate = "1",
    record: Record = False,
    duration: Duration = None,
    until_done: UntilDone = False,
    slam: WithSlam = True,
    check: Checked = True,
    rerun: InRerun = False,
    host: Host = "127.0.0.1",
    page_port: PagePort = 8000,
    rosbridge_port: RosbridgePort = None,
    foxglove_port: FoxglovePort = None,
    scan_topic: ScanTopic = None,
    odom_topic: OdomTopic = "",
    imu_topic: ImuTopic = "",
    out: Out = None,
    seed: Seed = None,
    set_: Set = None,
    config: ConfigFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a robot in real time: drive it from a browser, Foxglove or ROS, and watch it map.

    With --from, map a robot that runs elsewhere.
    """
    from slamsim.console.summary import labelled
    from slamsim.live.controls import LiveOptions
    from slamsim.run.naming import output_folder

    duration_s = math.inf if duration is None else duration
    options = LiveOptions(_rate(rate), drive.value, record, until_done, duration_s, slam)
    url = _url(from_, name)
    if url:
        _refuse_simulated(options, "" if name in ("labyrinth", url) else name, seed)
    loaded = loaded_config(None if url else name, config, set_, seed)
    place = url or loaded.config.world.name
    ports = _ports(host, page_port, rosbridge_port, foxglove_port, simulated=not url)
    ports = replace(ports, rerun=rerun)
    called = "robot_live" if url else f"{place}_live"
    with output_folder(out, called, overwrite=overwrite, inputs=loaded.files) as folder:
        if url:
            from slamsim.live.remote.robot import RemoteSetup
            from slamsim.run.live.remote import map_remote

            wanted = selection(scan_topic, odom_topic, imu_topic, "")
            setup = RemoteSetup(loaded.config, folder, wanted, record, duration_s)
            numbers = map_remote(url, setup, ports, reporter, check=check)
        else:
            from slamsim.run.live.world import live_world

            numbers = live_world(loaded.config, folder, options, ports, reporter)
    reporter.table(f"Live {'from' if url else 'in'} {place}", labelled(numbers))
    reporter.result({**numbers, "folder": str(folder)})


def replay(
    reporter: Reporter,
    source: Annotated[Path, typer.Argument(help="A drive that was recorded live.")],
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Drive the commands of a live recording again, which gives the same recording."""
    from slamsim.run.naming import output_folder

    called = f"{source.resolve().parent.name}_replay"
    with output_folder(out, called, overwrite=overwrite, inputs=(source,)) as folder:
        from slamsim.run.live.world import replay_drive

        numbers = replay_drive(source, folder, reporter, overwrite=overwrite)
    reporter.say(f"Written to {folder}/")
    reporter.result({**numbers, "folder": str(folder)})


def _url(asked: str, name: str) -> str:
    """Of ``--from URL``, also with the protocol before it, as one word or two; empty without."""
    protocol, _, url = asked.strip().rpartition(" ")
    if url in _PROTOCOLS and name.startswith(("ws:", "wss:")):
        return name
    if protocol not in ("", *_PROTOCOLS):
        raise SlamsimError(f"--from {shown(asked, 200)}: a URL such as ws://robot:9090 is needed")
    return url


def _refuse_simulated(options: LiveOptions, world: str, seed: int | None) -> None:
    """Raises SlamsimError for what only a simulation takes."""
    given = {
        "--drive": options.mode != Drive.MANUAL.value,
        "--rate": options.rate != 1.0,
        "--until-done": options.until_done,
        "--no-slam": not options.slam,
        "--seed": seed is not None,
        f"The world {world}": world != "",
    }
    for option, is_given in given.items():
        if is_given:
            raise SlamsimError(f"{option} belongs to simulations; --from maps a robot as it drives")


def _ports(
    host: str, page: int, rosbridge: int | None, foxglove: int | None, *, simulated: bool
) -> Ports:
    """Those of ROS are served by default where a simulation has no other server."""
    from slamsim.run.live.serving import Ports

    by_default = (9090, 8765) if simulated else (0, 0)
    rosbridge = by_default[0] if rosbridge is None else rosbridge
    foxglove = by_default[1] if foxglove is None else foxglove
    return Ports(host, page, rosbridge, foxglove)


def _rate(text: str) -> float | None:
    """Raises SlamsimError."""
    if text == "max":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.01 <= rate <= 100.0:
        raise SlamsimError(f"--rate {text}: a number from 0.01 to 100, or max")
    return rate
