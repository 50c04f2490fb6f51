"""Topics of a recording as channels of the Foxglove SDK: the same bytes, described by their ROS 2
definitions."""

from __future__ import annotations

from collections.abc import Iterable
from threading import Lock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slamsim.io.bag2.writer import TopicKind


class FoxgloveChannels:
    """The channels of some topics in a context of their own. Safe to use from any thread."""

    def __init__(self, topics: Iterable[TopicKind]) -> None:
        import foxglove

        self.context = foxglove.Context()
        kinds = list(topics)
        self._channels = {topic.name: self._channel(topic) for topic in kinds}
        self._latched: dict[str, tuple[int, bytes] | None] = {
            topic.name: None for topic in kinds if topic.latched
        }
        self._lock = Lock()

    def send(self, topic: str, log_ns: int, data: bytes) -> None:
        """Pass a message on to all who subscribed to its topic; never waits for them."""
        if topic not in self._latched:
            self._channels[topic].log(data, log_time=log_ns)
            return
        with self._lock:  # a new subscriber gets this message once, and none before it later
            self._latched[topic] = log_ns, data
            self._channels[topic].log(data, log_time=log_ns)

    def repeat(self, topic: str, client: int) -> None:
        """Send a client that subscribed just now the last message of a latched topic."""
        with self._lock:
            last = self._latched.get(topic)
            if last is not None:
                self._channels[topic].log(last[1], log_time=last[0], sink_id=client)

    def close(self) -> None:
        """The SDK keeps channels that are not closed for as long as the process lives."""
        for channel in self._channels.values():
            channel.close()

    def _channel(self, topic: TopicKind) -> Any:
        import foxglove

        from slamsim.io.bag2.writer import described

        text = described(topic.type_name)[1]
        schema = ros2_schema(topic.type_name, text)
        return foxglove.Channel(
            topic.name, message_encoding="cdr", schema=schema, context=self.context
        )


def ros2_schema(type_name: str, text: str) -> Any:
    """A message type with its ROS 2 definition."""
    import foxglove

    return foxglove.Schema(name=type_name, encoding="ros2msg", data=text.encode())


class Listener:
    """Hears of clients, on threads of the SDK; sends late subscribers what is latched."""

    def __init__(self, channels: FoxgloveChannels) -> None:
        self._channels = channels

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """The SDK gives a client and its sink one number."""
        self._channels.repeat(channel.topic, client.id)

    def __getattr__(self, name: str) -> Any:
        """Of all else that a listener may hear, nothing is needed."""
        if name.startswith("on_"):
            return lambda *heard: None
        raise AttributeError(name)
