"""The metadata.yaml beside a rosbag2 recording, and quality of service in YAML.

Written is version 8, with policies as numbers in a text: ROS 2 Humble reads no later one ("bad
conversion", ros2/rosbag2 issue 1895), and Jazzy and Rolling read it as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from slamsim.guard.errors import InputRefused
from slamsim.guard.yaml import parse_yaml
from slamsim.io.ros.message_types import ros2_types
from slamsim.io.ros.parts import METADATA

OFFERED_QOS, TYPE_HASH = "offered_qos_profiles", "topic_type_hash"
"""What rosbag2 writes into the metadata of an MCAP channel."""
VERSION, DISTRO = 8, "iron"
_FOREVER = {"sec": 9223372036, "nsec": 854775807}

_POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        *("system_default", "automatic", "manual_by_node"),
        *("manual_by_topic", "unknown", "best_available"),
    ),
}
"""Names in the order of their numbers (rmw/types.h)."""


@dataclass(frozen=True, slots=True)
class Topic:
    """quality_of_service: the offered profiles, as ``profiles_text`` writes them."""

    name: str
    type_name: str
    type_hash: str
    quality_of_service: str
    encoding: str = "cdr"


def topic_as_declared(
    name: str, type_name: str, metadata: Mapping[str, str], encoding: str = "cdr"
) -> Topic:
    """A topic with hash and profiles as the metadata of its MCAP channel have them.

    A reader may want those of metadata.yaml to be the same.
    """
    type_hash = metadata.get(TYPE_HASH) or _known_hash(type_name)
    return Topic(name, type_name, type_hash, metadata.get(OFFERED_QOS, ""), encoding)


def with_numbered_policies(metadata: Mapping[str, str]) -> dict[str, str]:
    """The metadata of an MCAP channel, with profiles as ``profiles_text`` writes them."""
    numbered = dict(metadata)
    if offered := numbered.get(OFFERED_QOS):
        numbered[OFFERED_QOS] = profiles_text(offered)
    return numbered


def topics_announced(information: Mapping[str, Any]) -> dict[str, Topic]:
    """By name, as a metadata.yaml has them; those that it has not whole are left out."""
    found = {}
    for entry in information.get("topics_with_message_count") or ():
        told = entry.get("topic_metadata") if isinstance(entry, dict) else None
        if isinstance(told, dict) and isinstance(told.get("name"), str):
            kind, encoding = str(told.get("type", "")), str(told.get("serialization_format", "cdr"))
            type_hash = str(told.get("type_description_hash") or _known_hash(kind))
            offered = profiles_text(told.get(OFFERED_QOS, ""))
            found[told["name"]] = Topic(told["name"], kind, type_hash, offered, encoding)
    return found


def profiles_text(offered: Any) -> str:
    """Offered profiles with numbers for the policies, from a list of them, as which ROS 2 writes
    them since Jazzy, or from the text of one; empty if that is none."""
    if isinstance(offered, str):
        try:
            offered = parse_yaml(offered, Path(METADATA)).data
        except InputRefused:
            return ""
    if not isinstance(offered, list):
        return ""
    profiles = [_numbered(each) for each in offered if isinstance(each, dict)]
    return dump_yaml(profiles) if profiles else ""


def _numbered(profile: Mapping[str, Any]) -> dict[str, Any]:
    """Policies that have no such name are unknown."""
    numbered = dict(profile)
    for policy, names in _POLICIES.items():
        if isinstance(named := profile.get(policy), str):
            numbered[policy] = names.index(named if named in names else "unknown")
    return numbered


@cache
def _known_hash(type_name: str) -> str:
    store = ros2_types()
    return store.hash_rihs01(type_name) if type_name in store.fielddefs else ""


def quality_of_service(*, latched: bool) -> str:
    """Of our own topics. latched: a late subscriber still gets the last message."""
    profile = {
        "history": "keep_last",
        "depth": 1 if latched else 10,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
    return profiles_text([profile])


class _PlainDumper(yaml.CSafeDumper):
    """Writes equal objects twice instead of as anchor and alias."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump_yaml(data: Any) -> str:
    """YAML in the order of insertion, without aliases."""
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False, width=1000)


@dataclass(frozen=True, slots=True)
class BagFile:
    """counts: messages by topic. time_range_ns: log time of the first and the last message."""

    name: str
    counts: Mapping[str, int]
    time_range_ns: tuple[int, int]

    @property
    def messages(self) -> int:
        return sum(self.counts.values())


def bag_metadata(
    files: Sequence[BagFile],
    topics: Sequence[Topic],
    custom: Mapping[str, str],
    distro: str = DISTRO,
) -> str:
    """The text of metadata.yaml for MCAP files, at least one."""
    first_ns = min(file.time_range_ns[0] for file in files)
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(first_ns, max(file.time_range_ns[1] for file in files)),
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_counted(topic, files) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                **dict(reversed(_span(*file.time_range_ns).items())),
                "message_count": file.messages,
            }
            for file in files
        ],
        "custom_data": dict(custom),
        "ros_distro": distro,
    }
    return dump_yaml({"rosbag2_bagfile_information": information})


def _counted(topic: Topic, files: Sequence[BagFile]) -> dict[str, object]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": topic.encoding,
            "offered_qos_profiles": topic.quality_of_service,
            "type_description_hash": topic.type_hash,
        },
        "message_count": sum(file.counts.get(topic.name, 0) for file in files),
    }


def _span(first_ns: int, last_ns: int) -> dict[str, dict[str, int]]:
    return {
        "duration": {"nanoseconds": last_ns - first_ns},
        "starting_time": {"nanoseconds_since_epoch": first_ns},
    }
