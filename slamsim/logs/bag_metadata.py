"""The metadata.yaml beside a rosbag2 recording (version 9), and quality of service in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True, slots=True)
class Topic:
    """latched: a late subscriber still gets the last message (durability TRANSIENT_LOCAL)."""

    name: str
    type_name: str
    type_hash: str
    latched: bool = False

    def quality_of_service(self) -> list[dict[str, Any]]:
        """The offered profile, as rosbag2 writes it."""
        return [
            {
                "history": "keep_last",
                "depth": 1 if self.latched else 10,
                "reliability": "reliable",
                "durability": "transient_local" if self.latched else "volatile",
                "deadline": _FOREVER,
                "lifespan": _FOREVER,
                "liveliness": "automatic",
                "liveliness_lease_duration": _FOREVER,
                "avoid_ros_namespace_conventions": False,
            }
        ]


class _PlainDumper(yaml.CSafeDumper):
    """Writes equal objects twice instead of as anchor and alias."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump_yaml(data: Any) -> str:
    """YAML in the order of insertion, without aliases."""
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False, width=1000)


def bag_metadata(
    file_name: str,
    topics: list[Topic],
    counts: Mapping[str, int],
    time_range_ns: tuple[int, int],
    custom: Mapping[str, str],
) -> str:
    """The text of metadata.yaml for one MCAP file."""
    start = {"nanoseconds_since_epoch": time_range_ns[0]}
    duration = {"nanoseconds": time_range_ns[1] - time_range_ns[0]}
    total = sum(counts.values())
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.quality_of_service(),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": counts[topic.name],
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [
            {
                "path": file_name,
                "starting_time": start,
                "duration": duration,
                "message_count": total,
            }
        ],
        "custom_data": dict(custom),
        "ros_distro": "jazzy",
    }
    return dump_yaml({"rosbag2_bagfile_information": information})
