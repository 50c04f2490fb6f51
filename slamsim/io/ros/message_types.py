"""Decodes messages with the type definitions stored in the recording."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from slamsim.io.ros.limits import check_definitions
from slamsim.io.ros.standard_types import ros2_types

WRITTEN_AS = ("ros2msg", "ros1msg", "ros2idl", "omgidl")
"""The ways of writing a definition that are read."""
_IDL_RULE = "=" * 80 + "\n"


class MessageTypes:
    """The types of a recording's topics; a definition is looked at when it is first needed.

    Each is taken for itself, with the parts that it brings along: what one says of a part holds
    for no other.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, tuple[str, str]] = {}
        self._definitions: dict[str, tuple[str, str, str]] = {}

    def declare(self, topic: str, type_name: str, encoding: str) -> None:
        """How the messages of a topic are serialised: ``cdr`` or ``ros1``.

        A topic of several types is not read.
        """
        kind = normal_type_name(type_name)
        known, _ = self._kinds.get(topic, (kind, encoding))
        self._kinds[topic] = (kind if known == kind else f"{known} and {kind}", encoding)

    def define(self, type_name: str, written_as: str, text: str, known_hash: str = "") -> None:
        """written_as: ``ros1msg``, ``ros2msg``, ``ros2idl`` or ``omgidl``.

        known_hash: what its MD5 (ROS 1) or RIHS01 hash (ROS 2) must be, if the file says.
        """
        self._definitions[normal_type_name(type_name)] = (written_as, text, known_hash)

    def type_name(self, topic: str) -> str:
        """With ``msg`` in the middle; of a topic with several types their names."""
        return self._kinds[topic][0]

    def deserialize(self, topic: str, data: bytes) -> Any:
        """The message object, with the fields of its definition; raises whatever the library
        raises on damage."""
        name, encoding = self._kinds[topic]
        if encoding == "cdr":
            return self._store(name).deserialize_cdr(data, name)
        if encoding == "ros1":
            return self._store(name).deserialize_ros1(data, name)
        raise ValueError(f"messages are encoded as {encoding[:30]!r}; cdr and ros1 are read")

    def serialize(self, topic: str, message: Any) -> bytes:
        """The message as its topic's others are serialised (CDR: little-endian)."""
        name, encoding = self._kinds[topic]
        store = self._store(name)
        if encoding == "ros1":
            return bytes(store.serialize_ros1(message, name))
        return bytes(store.serialize_cdr(message, name))

    def fields(self, topic: str) -> list[tuple[str, str]]:
        """(name, type) of the topic's fields, of what is no plain message the type is empty.

        Raises ValueError for a topic without a known definition.
        """
        name, _ = self._kinds[topic]
        return [
            (field, str(kind[1]) if kind[0] == Nodetype.NAME else "")
            for field, kind in self._store(name).fielddefs[name][1]
        ]

    def encoding(self, topic: str) -> str:
        """``cdr``, ``ros1``, or what the file says else."""
        return self._kinds[topic][1]

    def types(self, topic: str) -> Mapping[str, Any]:
        """The classes of the topic's message and of all its parts, by name."""
        return self._store(self._kinds[topic][0]).types

    def is_cdr(self, topic: str) -> bool:
        """Whether messages are serialised as ROS 2 does, with the standard definition."""
        name, encoding = self._kinds[topic]
        defined, standard = self._store(name).fielddefs, ros2_types().fielddefs
        return encoding == "cdr" and all(standard.get(kind) == of for kind, of in defined.items())

    def _store(self, name: str) -> Typestore:
        definition = self._definitions.get(name)
        if definition is not None and definition[1]:
            return _store_of(name, *definition)
        if name not in ros2_types().fielddefs:
            raise ValueError(f"no definition of {name[:60]!r}")
        return ros2_types()


@lru_cache(maxsize=64)
def _store_of(name: str, written_as: str, text: str, known_hash: str) -> Typestore:
    """One definition; what it generates is kept for the next file that has the very same."""
    check_definitions([(name, text)])
    store = get_typestore(Stores.EMPTY)
    register(store, name, written_as, text)
    if known_hash and known_hash != _hash(store, name, written_as):
        raise ValueError(f"the definition of {name[:60]} does not fit its hash")
    return store


def _hash(store: Typestore, name: str, written_as: str) -> str:
    if written_as == "ros1msg":
        return str(store.generate_msgdef(name)[1])
    return str(store.hash_rihs01(name))


def register(store: Typestore, name: str, encoding: str, text: str) -> None:
    """Adds a definition in the ROS 2 .msg, ROS 1 .msg or IDL way of writing."""
    if encoding in ("ros2msg", "ros1msg"):
        store.register(get_types_from_msg(text, name))
    elif encoding in ("ros2idl", "omgidl"):
        for part in text.split(_IDL_RULE):
            _, is_section, body = part.partition("\n") if part.startswith("IDL: ") else ("", "", "")
            idl = body if is_section else part
            if idl.strip():
                store.register(get_types_from_idl(idl))
    else:
        raise ValueError(f"{name[:60]} is defined as {encoding[:30]!r}, which is not known")


def normal_type_name(type_name: str) -> str:
    """``pkg/Type`` of ROS 1 as ``pkg/msg/Type``."""
    package, _, name = type_name.partition("/")
    return type_name if "/" in name or not name else f"{package}/msg/{name}"
