"""Messages that cannot be shown: a robot that runs elsewhere may send anything."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from slamsim.live.hub import Message

_log = logging.getLogger(__name__)


class Undrawn:
    """Told once for each topic, and left out."""

    def __init__(self) -> None:
        self._topics = set[str]()

    @contextmanager
    def told(self, message: Message) -> Iterator[None]:
        """Around what draws the message."""
        try:
            yield
        except Exception as error:  # of many types, for damage of any kind
            if message.topic.name not in self._topics:
                _log.warning("messages on %s cannot be shown: %s", message.topic.name, error)
            self._topics.add(message.topic.name)
