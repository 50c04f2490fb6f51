"""Copies a recording message by message and changes only the edited messages.

What an edit does not touch is copied as bytes: topics that are not modelled, their types, quality
of service, publish times and sequence numbers, metadata and attachments. A touched message is
decoded by the definition that the file itself brings along, what was edited is set in it, and it
is encoded again: fields that a ``Recording`` does not hold, such as covariances, stay.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap import records

from slamsim.core.types import IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.yaml import load_yaml
from slamsim.io.bag2.metadata import topics_announced
from slamsim.io.bag2.writer import METADATA_RECORD
from slamsim.io.copy.changes import (
    Row,
    TopicPlan,
    changes_between,
    new_edges,
    parts_with_origin,
    plans,
    transform_messages,
)
from slamsim.io.copy.images import InfoChange, info_changes, told_shutters
from slamsim.io.copy.shared_clocks import StampMap, header_topics, stamp_maps, stamp_of, with_stamp
from slamsim.io.copy.writers import Bag1Copy, Bag2Copy, Copy, Message, Spool
from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.bag import Bag, custom_data, open_bag
from slamsim.io.ros.parts import METADATA
from slamsim.io.ros.reader import TRANSFORM_TYPES, description_topic, is_truth, recorded_name
from slamsim.io.ros.sources import Bag1Source, McapSource
from slamsim.recording import Recording, TransformEdge
from slamsim.recording.schemas import TRANSFORMS


@dataclass(frozen=True, slots=True)
class Copied:
    """What became of a recording in a copy.

    changed: topics in which any message was changed, dropped or moved. unchanged: (topic, type,
    messages) of all others, byte for byte. restamped: (topic, stream) of topics that are not
    modelled and whose stamps were moved with those of the stream that they were made from.
    not_restamped: those with stamps that stayed, while stamps of others were changed. attached:
    files that travel along in the copy. lost: what its format could not hold. translated: topics
    that were not messages of ROS.
    """

    changed: tuple[str, ...] = ()
    unchanged: tuple[tuple[str, str, int], ...] = ()
    restamped: tuple[tuple[str, str], ...] = ()
    not_restamped: tuple[str, ...] = ()
    attached: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    translated: tuple[str, ...] = ()

    def sentences(self) -> Iterator[str]:
        """What a user should know of it, one line each."""
        if self.unchanged:
            topics = ", ".join(topic for topic, _, _ in self.unchanged)
            yield f"Copied byte for byte: {topics}"
        if self.translated:
            yield f"Written as messages of ROS that say the same: {', '.join(self.translated)}"
        for topic, stream in self.restamped:
            yield f"Stamps of {topic} were moved with those of {stream}: it has the same stamps"
        if self.not_restamped:
            topics = ", ".join(self.not_restamped)
            yield f"Stamps not moved, for nothing shows that they are on that clock: {topics}"
        for name in self.attached:
            yield f"All of {name} travels along as an attachment of the MCAP file"
        if self.lost:
            yield f"Not in the copy, for rosbag2 cannot hold it: {', '.join(self.lost)}"


def rewrite_recording(path: Path, read: Recording, edited: Recording, folder: Path) -> Copied:
    """Copy the ROS recording at path into a new or empty folder, with what was edited.

    read: as ``read_recording(path)`` gave it; edited: what was made of it. A ROS 1 bag stays one;
    every other recording becomes a rosbag2 folder with one MCAP file. Call it inside
    ``partial_folder``: after an exception the folder is unfinished. Raises InputRefused as
    ``open_bag`` does, and SlamsimError for a stamp that the format cannot hold.
    """
    with open_bag(path) as bag:
        edited = replace(edited, transforms=tuple(_latched(edited.transforms)))
        changes = changes_between(read, edited)
        modelled = {origin.topic for _, origin in parts_with_origin(read)}
        infos = info_changes(read, edited)
        known = {*modelled, *infos}
        others = [c.topic for c in bag.channels if c.topic not in known and not is_truth(c)]
        stamped = header_topics(bag, others)
        edits = _Edits(
            bag,
            plans(read, changes),
            stamp_maps(bag, changes, stamped),
            _new_description(bag, read, edited),
            infos,
        )
        edges = new_edges(edited)
        shutters = told_shutters(read, edited)
        with _copy_of(bag, folder, shutters) as copy, closing(Spool()) as spool:
            _require_stamps(copy, [*(c.stamps_ns for c in changes), *(e.stamps_ns for e in edges)])
            numbers = _declared(bag, copy, shutters)
            _spool_moved(edits, copy, numbers, spool)
            _spool_new(bag, edges, copy, numbers, spool)
            _merge(edits, copy, numbers, spool)
        restamps = any(change.restamped for change in changes)
        return _copied(edits, edges, [t for t in stamped if restamps and t not in edits.restamped])


def _latched(edges: Iterable[TransformEdge]) -> Iterator[TransformEdge]:
    """What holds until it is said again, as in Foxglove, does so in ROS on /tf_static alone."""
    for edge in edges:
        is_elsewhere = edge.is_static and not edge.topic.endswith("tf_static")
        yield replace(edge, topic="/tf_static") if is_elsewhere else edge


@dataclass(frozen=True, slots=True, eq=False)
class _Edits:
    """What changes in the messages of a bag, by topic.

    restamped: topics that are not modelled and whose stamps move. description: topic and text of
    another robot description. infos: what changes in CameraInfo. untranslated: messages that are
    left out.
    """

    bag: Bag
    plans: dict[str, TopicPlan]
    restamped: dict[str, StampMap]
    description: tuple[str, str] | None
    infos: dict[str, InfoChange]
    untranslated: Counter[str] = field(default_factory=Counter)

    def counted(self, topics: Container[str] | None = None) -> Iterator[tuple[str, int, Message]]:
        """(topic, number of the message on it, message) of all messages, or of some topics."""
        names = {n: each.topic for n, each in self.bag.source.declarations.items()}
        counts = dict.fromkeys(names.values(), 0)
        for message in self.bag.everything(topics):
            topic = names[message[0]]
            yield topic, counts[topic], message
            counts[topic] += 1

    def in_place(self, topic: str, count: int, data: bytes) -> bytes | None:
        """A message as it is to be written where it stands; None where nothing is left of it."""
        types = self.bag.source.types
        if self.bag.source.is_untranslated(topic, data):
            self.untranslated[topic] += 1
            return None
        if topic in self.plans:
            return self._as_planned(topic, self.plans[topic], count, data)
        if topic in self.restamped:
            encoding = types.encoding(topic)
            stamp_ns = self.restamped[topic](stamp_of(data, encoding))
            return with_stamp(data, encoding, stamp_ns)
        if topic in self.infos:
            message = self.bag.deserialize(topic, data)
            self.infos[topic].patch(message)
            return types.serialize(topic, message)
        if self.description is not None and topic == self.description[0]:
            message = self.bag.deserialize(topic, data)
            message.data = self.description[1]
            return types.serialize(topic, message)
        return data

    def _as_planned(self, topic: str, plan: TopicPlan, count: int, data: bytes) -> bytes | None:
        rows, dropped = plan.in_place.get(count, ()), plan.dropped.get(count, set())
        if not rows and not dropped:
            return data
        message = self.bag.deserialize(topic, data)
        parts = _parts(message)
        for row in rows:
            row.change.patch(parts[row.place], row.row)
        left = [part for place, part in enumerate(parts) if place not in dropped]
        if not left:
            return None
        if len(left) < len(parts):
            message.transforms = left
        return self.bag.source.types.serialize(topic, message)

    def moved(self, topic: str, row: Row, data: bytes) -> bytes:
        """The message with this row alone."""
        message = self.bag.deserialize(topic, data)
        part = _parts(message)[row.place]
        row.change.patch(part, row.row)
        if part is not message:
            message.transforms = [part]
        return self.bag.source.types.serialize(topic, message)


def _parts(message: Any) -> Sequence[Any]:
    """The transforms of a message that has several, else the message itself."""
    found: Sequence[Any] = getattr(message, "transforms", (message,))
    return found


def _copy_of(bag: Bag, folder: Path, said: Mapping[str, str]) -> Copy:
    """said: custom data that are new. Raises SlamsimError for such of a ROS 1 bag."""
    if isinstance(bag.source, Bag1Source):
        if said:
            raise SlamsimError(f"{bag.path}: a ROS 1 bag cannot tell the readout of a shutter")
        return Bag1Copy(folder, f"{recorded_name(bag.path)}.bag")
    profile = bag.source.profile if isinstance(bag.source, McapSource) else "ros2"
    custom = {**custom_data(bag), **said}
    if not (bag.path / METADATA).is_file():
        return Bag2Copy(folder, profile, custom)
    document: Any = load_yaml(bag.path / METADATA).data  # as ``open_bag`` found it
    told = document["rosbag2_bagfile_information"]
    distro = str(told.get("ros_distro") or "")
    return Bag2Copy(folder, profile, custom, distro, topics_announced(told))


def _declared(bag: Bag, copy: Copy, said: Mapping[str, str]) -> dict[int, int]:
    """All that stands beside the messages, copied: the number of each publisher in the copy.

    said: custom data that are new.
    """
    if isinstance(copy, Bag2Copy):
        for record in _metadata(bag, said):
            copy.put_metadata(record)
    if isinstance(bag.source, McapSource) and isinstance(copy, Bag2Copy):
        with as_input_errors(bag.path, "attachments"):
            for attachment in bag.source.attachments():
                copy.put_attachment(attachment)
    return {n: copy.declare(each) for n, each in bag.source.declarations.items()}


def _metadata(bag: Bag, said: Mapping[str, str]) -> list[records.Metadata]:
    """Records as they are, custom data that are new in our own: a file may be read alone."""
    found = bag.source.metadata() if isinstance(bag.source, McapSource) else []
    if not said:
        return found
    own = {**bag.metadata.get(METADATA_RECORD, {}), **said}
    others = (each for each in found if each.name != METADATA_RECORD)
    return [records.Metadata(name=METADATA_RECORD, metadata=own), *others]


def _spool_moved(edits: _Edits, copy: Copy, numbers: dict[int, int], spool: Spool) -> None:
    """Rows that have a log time or a topic of their own."""
    topics = {topic for topic, plan in edits.plans.items() if plan.moved}
    declared = edits.bag.source.declarations
    elsewhere: dict[tuple[int, str], int] = {}
    for topic, count, (number, log_ns, published_ns, sequence, data) in edits.counted(topics):
        for row in edits.plans[topic].moved.get(count, ()):
            target = numbers[number]
            if row.change.topic != topic:
                key = number, row.change.topic
                if key not in elsewhere:
                    there = replace(declared[number], topic=key[1])
                    if there.topic.endswith("tf_static"):
                        there = copy.declare_standard(there.topic, TRANSFORMS, latched=True)
                    elsewhere[key] = copy.declare(there)
                target = elsewhere[key]
            at_ns = row.log_ns
            moved = edits.moved(topic, row, data)
            spool.put(target, at_ns, max(published_ns + at_ns - log_ns, 0), sequence, moved)


def _spool_new(
    bag: Bag, edges: Sequence[TransformEdge], copy: Copy, numbers: dict[int, int], spool: Spool
) -> None:
    """Transforms that no message holds yet."""
    if not edges:
        return
    first_ns = next(bag.everything())[1]
    types, declared = bag.source.types, bag.source.declarations
    carrying = {c.topic for c in bag.of_type(*TRANSFORM_TYPES)}
    targets = {d.topic: numbers[n] for n, d in declared.items() if d.topic in carrying}
    for edge in edges:
        if edge.topic not in targets:
            made = copy.declare_standard(edge.topic, TRANSFORMS, latched=edge.is_static)
            targets[edge.topic] = copy.declare(made)
            types.declare(made.topic, made.type_name, made.encoding)
            types.define(made.type_name, made.written_as, made.definition.decode())
        for sequence, (at_ns, data) in enumerate(transform_messages(types, edge, first_ns)):
            spool.put(targets[edge.topic], at_ns, at_ns, sequence, data)


def _merge(edits: _Edits, copy: Copy, numbers: dict[int, int], spool: Spool) -> None:
    """Everything in the order of the file, and what was spooled at its log time."""
    later = spool.in_order()
    due, now_ns = next(later, None), 0
    for topic, count, (number, log_ns, published_ns, sequence, data) in edits.counted():
        now_ns = max(now_ns, log_ns)
        while due is not None and due[1] <= now_ns:
            copy.put(*due)
            due = next(later, None)
        edited = edits.in_place(topic, count, data)
        if edited is not None:
            copy.put(numbers[number], log_ns, published_ns, sequence, edited)
    while due is not None:
        copy.put(*due)
        due = next(later, None)


def _new_description(bag: Bag, read: Recording, edited: Recording) -> tuple[str, str] | None:
    topic, text = description_topic(bag), edited.robot_description
    if topic is None or text is None or text == read.robot_description:
        return None
    return topic, text


def _require_stamps(copy: Copy, stamps: Sequence[IntArray]) -> None:
    for stamps_ns in stamps:
        seconds = stamps_ns // 1_000_000_000
        for second in (int(seconds.min(initial=0)), int(seconds.max(initial=0))):
            if not copy.first_s <= second <= copy.last_s:
                raise SlamsimError(
                    f"a stamp of {second} s cannot be written: {copy.format} counts from "
                    f"{copy.first_s} to {copy.last_s} s"
                )


def _copied(edits: _Edits, edges: Sequence[TransformEdge], still: Sequence[str]) -> Copied:
    changed = {*edits.plans, *edits.restamped, *edits.infos, *(edge.topic for edge in edges)}
    if edits.description is not None:
        changed.add(edits.description[0])
    translated = edits.bag.source.translated
    others = [c for c in edits.bag.channels if c.topic not in changed | translated]
    return Copied(
        changed=tuple(sorted(changed)),
        unchanged=tuple((c.topic, c.type_name, c.messages) for c in others),
        restamped=tuple((topic, each.topic) for topic, each in edits.restamped.items()),
        not_restamped=tuple(still),
        lost=tuple(f"{n} messages of {topic}" for topic, n in edits.untranslated.items()),
        translated=tuple(sorted(translated)),
    )
