"""Connections of a ROS 1 bag: topic, type, and a check of the definition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from rosbags.typesys import Stores, get_typestore

from slamsim.io.bag1.reader import header_fields
from slamsim.io.ros.limits import check_definitions
from slamsim.io.ros.message_types import normal_type_name, register


@dataclass(frozen=True, slots=True)
class Connection:
    """record: with its header."""

    number: int
    topic: str
    type_name: str
    definition: str
    md5sum: str
    record: bytes

    def fits_its_hash(self) -> bool:
        """Whether the definition is the one whose MD5 stands beside it.

        A bag describes a connection twice, so that one of them may be damaged.
        """
        return _md5sum(normal_type_name(self.type_name), self.definition) == self.md5sum


@lru_cache(maxsize=256)
def _md5sum(name: str, definition: str) -> str | None:
    """As ROS 1 computes it; None for a definition that cannot be."""
    try:
        check_definitions([(name, definition)])
        store = get_typestore(Stores.EMPTY)
        register(store, name, "ros1msg", definition)
        return store.generate_msgdef(name, ros_version=1)[1]
    except Exception:
        return None


def connection(fields: dict[bytes, bytes], record: bytes, data: int) -> Connection:
    """The one in a record with this header, whose data begin at byte ``data``.

    Raises ValueError if it is none.
    """
    described = header_fields(record[data:])
    texts = {name: described.get(name, b"").decode() for name in (b"type", b"message_definition")}
    if not texts[b"type"]:
        raise ValueError("a connection without a type")
    return Connection(
        int.from_bytes(fields[b"conn"], "little"),
        fields[b"topic"].decode(),
        texts[b"type"],
        texts[b"message_definition"],
        described.get(b"md5sum", b"").decode(),
        record,
    )
