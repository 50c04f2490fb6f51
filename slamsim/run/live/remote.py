"""``slamsim live --from``: maps, checks and records a robot that runs elsewhere."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from pathlib import Path

from slamsim.console.reporter import Reporter
from slamsim.core.progress import Progress
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import TopicKind
from slamsim.live.hub import Hub
from slamsim.live.mapping import Finished, MappingProcess
from slamsim.live.published import SLAM_TOPICS
from slamsim.live.remote.checking import CheckingProcess
from slamsim.live.remote.controls import RemoteControls
from slamsim.live.remote.received import read_topics
from slamsim.live.remote.robot import RemoteRobot, RemoteSetup
from slamsim.live.sources.clients import open_source
from slamsim.live.sources.source import MessageLink
from slamsim.recording.schemas import TRANSFORMS
from slamsim.run.live.serving import Ports, run_until_signal, servers, write_map

_TRANSFORMS = TopicKind("/tf", TRANSFORMS)
"""The map's is published also for a robot that tells none."""


def map_remote(
    url: str, setup: RemoteSetup, ports: Ports, reporter: Reporter, *, check: bool = True
) -> dict[str, object]:
    """``live_remote`` of the server at a URL. Raises InputRefused besides where none answers."""
    with open_source(url, reporter.warn) as source:
        return live_remote(source, setup, ports, reporter, check=check)


def live_remote(
    source: MessageLink,
    setup: RemoteSetup,
    ports: Ports,
    reporter: Reporter,
    *,
    check: bool = True,
) -> dict[str, object]:
    """Until a signal comes or the setup's time is over; numbers of it.

    source: inside its block. What was mapped is in the folder ``map`` in the end: solved as a whole
    where time was over, as it was known where a signal came or something failed. Raises
    InputRefused where nothing can be mapped, SlamsimError where SLAM, a server or the disk fails.
    """
    with ExitStack() as opened:
        process = opened.enter_context(MappingProcess())
        checker = CheckingProcess(source.url, setup.wanted) if check else None
        if checker is not None:
            opened.enter_context(checker)
        topics = read_topics(source)
        hub = Hub([_TRANSFORMS, *topics, *SLAM_TOPICS])
        robot = RemoteRobot(setup, source, topics, hub, process, checker)
        for server in servers(hub, RemoteControls(robot), ports):
            opened.enter_context(server)
            reporter.note(server.address)
        try:
            with reporter.stage("live") as progress:
                stopped = run_until_signal(robot, lambda: _tell(robot, reporter, progress))
            lasted_s = time.monotonic() - robot.begun_s
            _tell(robot, reporter, progress)
            finished, folder = _final_map(robot, process, reporter, stopped=stopped)
        except BaseException:
            with suppress(SlamsimError, OSError):
                if robot.known.grid is not None:
                    kept = robot.known.save(setup.folder, "map")
                    reporter.warn(f"the map as it was known is in {kept}/")
            raise
    return {"duration_s": lasted_s, **_numbers(robot, finished, folder)}


def _final_map(
    robot: RemoteRobot, process: MappingProcess, reporter: Reporter, *, stopped: bool
) -> tuple[Finished | None, Path | None]:
    """The solution, if there was time for it, and the folder of the map, if there is one."""
    if not stopped and (robot.known.placed or process.behind):
        reporter.note("Solving the whole map")
        finished, folder = process.finish(), robot.setup.folder / "map"
        write_map(folder, finished)
        return finished, folder
    if robot.known.grid is None:
        return None, None
    return None, robot.known.save(robot.setup.folder, "map")


def _tell(robot: RemoteRobot, reporter: Reporter, progress: Progress) -> None:
    progress(time.monotonic() - robot.begun_s, robot.setup.duration_s)
    while robot.notes:
        reporter.note(robot.notes.popleft())
    known = robot.known
    while known.events:
        reporter.warn(known.events.popleft())


def _numbers(
    robot: RemoteRobot, finished: Finished | None, folder: Path | None
) -> dict[str, object]:
    status, checker = robot.status, robot.checker
    return {
        "messages": robot.received,
        "scans_mapped": robot.known.placed if finished is None else len(finished.trajectory),
        "keyframes": status.keyframes if finished is None else finished.keyframes,
        "closures": status.closures if finished is None else finished.closures,
        "checks": 0 if checker is None else checker.checks,
        "faults": [] if checker is None else [one.fault for one in checker.findings],
        "map": None if folder is None else str(folder),
        "recordings": [str(one) for one in robot.recordings.folders],
    }
