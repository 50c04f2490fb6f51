"""What every live robot has: servers, a loop that a signal ends, and a map in the end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from slamsim.guard.output import partial_folder
from slamsim.io.text.tum import write_tum
from slamsim.live.controls import Controls
from slamsim.live.hub import Hub
from slamsim.live.mapping import Finished
from slamsim.live.servers.access import Access, Server
from slamsim.process.exit_codes import STOPPING
from slamsim.process.supervisor import finish_in_peace
from slamsim.run import folder as run_folder

_LOOK_S = 0.2
"""How often the end is looked for."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Where clients find a robot; 0 for none. rerun: whether a Rerun viewer shows it."""

    host: str = "127.0.0.1"
    page: int = 8000
    rosbridge: int = 9090
    foxglove: int = 8765
    rerun: bool = False


class Loop(Protocol):
    """Of a live robot."""

    def run(self) -> None:
        """Until ``stop``, or an end of its own."""
        ...

    def stop(self) -> None:
        """End ``run`` soon; from any thread."""
        ...


def servers(hub: Hub, controls: Controls, ports: Ports) -> Iterator[Server]:
    """Those that are wanted, each started when it is asked for."""
    from slamsim.live.servers.foxglove import FoxgloveServer
    from slamsim.live.servers.page import PageServer
    from slamsim.live.servers.rerun import start_rerun
    from slamsim.live.servers.rosbridge.server import RosbridgeServer

    access = Access.at(ports.host)
    if ports.page:
        yield PageServer(hub, controls, access, ports.page)
    if ports.rosbridge:
        yield RosbridgeServer(hub, controls, access, ports.rosbridge)
    if ports.foxglove:
        yield FoxgloveServer(hub, controls, access, ports.foxglove)
    if ports.rerun:
        yield start_rerun(hub)


def run_until_signal(loop: Loop, look: Callable[[], None]) -> bool:
    """Let the robot live; whether a signal ended it.

    look: called now and then. Raises what the loop raises.
    """
    with _heeding(loop.stop) as heard, living(loop) as thread:
        while thread.is_alive():
            thread.join(_LOOK_S)
            look()
    return bool(heard)


@contextmanager
def living(loop: Loop) -> Iterator[threading.Thread]:
    """The thread on which the robot lives. It ends with the block at the latest, before what it
    writes to is closed. Raises what the loop raises."""
    failures: list[BaseException] = []

    def live() -> None:
        try:
            loop.run()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=live, name="slamsim-live")
    thread.start()
    try:
        yield thread
    finally:
        loop.stop()
        thread.join()
    if failures:
        raise failures[0]


@contextmanager
def _heeding(stop: Callable[[], None]) -> Iterator[list[int]]:
    """A first signal to stop calls this instead, for Ctrl-C is how a live robot usually ends.

    Gives the signal once it came.
    """
    heard: list[int] = []

    def heed(number: int, frame: object) -> None:
        if heard:
            return
        heard.append(number)
        finish_in_peace()
        stop()

    if threading.current_thread() is not threading.main_thread():
        yield heard  # of a program that uses this as a library, and has its own signals
        return
    before = {one: signal.getsignal(one) for one in STOPPING}
    for one, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(one, heed)
    try:
        yield heard
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def write_map(folder: Path, finished: Finished) -> None:
    """The final map and trajectory."""
    with partial_folder(folder) as partial:
        run_folder.write_map(partial, finished.grid)
        write_tum(partial / run_folder.TRAJECTORY, finished.trajectory)
