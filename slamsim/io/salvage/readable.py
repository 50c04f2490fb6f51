"""Tests whether a message without a checksum decodes as its declared type.

Readers refuse a recording in which one cannot.
"""

from __future__ import annotations

from slamsim.io.ros.message_types import MessageTypes


class DecodableMessages:
    """Judges messages by the definitions of their types."""

    def __init__(self) -> None:
        self._types = MessageTypes()
        self._known: dict[str, bool] = {}

    def describe(
        self, topic: str, type_name: str, encoding: str, written_as: str, definition: str
    ) -> None:
        """How the messages of a topic are serialised, and their definition, if there is one."""
        self._types.declare(topic, type_name, encoding)
        if definition:
            self._types.define(type_name, written_as, definition)
        self._known.pop(topic, None)

    def __call__(self, topic: str, data: bytes) -> bool:
        """True as well where no definition tells."""
        if topic not in self._known:
            try:
                self._types.is_cdr(topic)
                self._known[topic] = True
            except Exception:
                self._known[topic] = False
        if self._known[topic]:
            try:
                self._types.deserialize(topic, data)
            except Exception:
                return False
        return True
