"""A robot that runs elsewhere, played from a recording many times as fast as it was."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from slamsim.config.loading import load_run_config
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.bag import open_bag
from slamsim.live.hub import Hub, Message
from slamsim.live.mapping import MappingProcess
from slamsim.live.published import SLAM_TOPICS
from slamsim.live.remote.checking import CheckingProcess
from slamsim.live.remote.received import read_topics
from slamsim.live.remote.robot import RemoteRobot, RemoteSetup
from slamsim.simulation.simulate import simulate

SPEED, LOOP = 12.0, "remote robot"


def is_living() -> bool:
    """Whether a robot's loop goes on."""
    return any(thread.name == LOOP for thread in threading.enumerate())


def simulated(folder: Path, *settings: str) -> list[Message]:
    """The messages of a drive through the smallest world."""
    simulate(load_run_config("tiny", None, ["sensors.lidar=lds_01", *settings]), folder)
    return recorded(folder)


def recorded(folder: Path) -> list[Message]:
    with open_bag(folder) as bag:
        kinds = {
            number: TopicKind(one.topic, one.type_name, one.topic == "/tf_static")
            for number, one in bag.source.declarations.items()
        }
        return [Message(kinds[n], ns, bytes(data)) for n, ns, _, _, data in bag.everything()]


class PlayedSource:
    """A ``MessageLink``. more: topics that are there, and say nothing."""

    url = "ws://played"
    dropped = 0

    def __init__(
        self, messages: Sequence[Message], more: Iterable[TopicKind] = (), speed: float = SPEED
    ) -> None:
        self._speed = speed
        self._topics = list(dict.fromkeys([*(m.topic for m in messages), *more]))
        self.play(messages)
        self._names: set[str] = set()
        self.published: list[tuple[str, str, bytes]] = []

    def play(self, messages: Sequence[Message]) -> None:
        """From now on."""
        self._begun_s, self._begun_ns = time.monotonic(), messages[0].log_ns
        self._messages = list(messages)

    def topics(self) -> Sequence[TopicKind]:
        return self._topics

    def subscribe(self, names: Iterable[str]) -> None:
        self._names |= set(names)

    def receive(self, timeout_s: float) -> Message | None:
        until_s = time.monotonic() + timeout_s
        while self._messages:
            message = self._messages[0]
            due_s = self._begun_s + (message.log_ns - self._begun_ns) * 1e-9 / self._speed
            if due_s > until_s:
                break
            time.sleep(max(due_s - time.monotonic(), 0.0))
            self._messages.pop(0)
            if message.topic.name in self._names:
                return message
        time.sleep(max(until_s - time.monotonic(), 0.0))
        return None

    @property
    def is_over(self) -> bool:
        return not self._messages

    def publish(self, topic: str, type_name: str, data: bytes) -> None:
        self.published.append((topic, type_name, data))

    def of(self, topic: str) -> list[bytes]:
        return [data for name, _, data in self.published if name == topic]


@contextmanager
def mapping(
    source: PlayedSource,
    folder: Path,
    process: MappingProcess,
    checker: CheckingProcess | None = None,
    **options: object,
) -> Iterator[tuple[RemoteRobot, Hub]]:
    """The robot while it is mapped; what its loop raises is raised at the end."""
    setup = RemoteSetup(load_run_config("tiny"), folder, **options)  # type: ignore[arg-type]
    topics = read_topics(source)
    hub = Hub([*topics, *SLAM_TOPICS])
    robot = RemoteRobot(setup, source, topics, hub, process, checker)
    failures: list[BaseException] = []

    def live() -> None:
        try:
            robot.run()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=live, name=LOOP)
    thread.start()
    try:
        yield robot, hub
    finally:
        robot.stop()
        thread.join()
    if failures:
        raise failures[0]
