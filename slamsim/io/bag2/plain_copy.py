"""Writes a recording message by message with rosbags alone, as a reference for the cost of
writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Self

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from slamsim.io.ros.message_types import ros2_types

_VERSION: Final = 9


class PlainCopy:
    """All messages of a rosbag2 folder in memory, to be written as often as one likes."""

    def __init__(self, messages: list[tuple[str, str, int, Any]]) -> None:
        self._messages = messages
        self._types = ros2_types()

    @classmethod
    def of(cls, folder: Path) -> Self:
        """As the reader of rosbags gives them."""
        types = ros2_types()
        with Reader(folder) as reader:
            return cls(
                [
                    (
                        connection.topic,
                        connection.msgtype,
                        stamp_ns,
                        types.deserialize_cdr(data, connection.msgtype),
                    )
                    for connection, stamp_ns, data in reader.messages()
                ]
            )

    def write(self, folder: Path) -> None:
        """Serialise and write every message into a new folder, as MCAP."""
        connections = {}
        with Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, kind, stamp_ns, message in self._messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self._types)
                data = self._types.serialize_cdr(message, kind)
                writer.write(connections[topic], stamp_ns, data)
