"""``slamsim info``: what is in a recording, what is read of it, what is missing."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from slamsim.console.reporter import Reporter, aligned
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.io.formats import Survey, TopicFacts
from slamsim.io.formats.ros import is_ros
from slamsim.io.open import holds_something, survey_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.recording import RawScans, Recording
from slamsim.recording.choice import Choice, choices, in_words, topics_of, without_scans
from slamsim.recording.frame_graph import FrameGraph, FramePlace, drawn, outline
from slamsim.report.figures.frames import write_frames
from slamsim.run.naming import log_of
from slamsim.run.stages import Stages

_NOTHING = "nothing"
_PUBLISH = (
    "record /tf_static, or publish it: ros2 run tf2_ros static_transform_publisher --frame-id {} "
    "--child-frame-id {} --x 0"
)


@dataclass(frozen=True, slots=True)
class Missing:
    """What a recording lacks, and what it would buy."""

    what: str
    worth: str

    def __str__(self) -> str:
        return f"{self.what}: {self.worth}"


def tell_info(
    source: Path,
    reporter: Reporter,
    *,
    wanted: Selection = EVERYTHING,
    options: Sequence[str] = (),
    picture: Path | None = None,
    picture_format: str = "svg",
) -> None:
    """Show what is in a recording. options: as typed, for the next command; picture: where to
    draw the transform tree. Raises NotFound, InputRefused and OverrideRefused."""
    if source.is_dir() and is_image_folder(source):
        _tell_image_folder(source, reporter)
        return
    path = log_of(source)
    with Stages(reporter).stage("read"):
        survey = survey_recording(path, wanted)
        images = _recorded_images(path)
    recording = survey.sample
    by_camera = _maps_by_camera(images)
    found, lacking = choices(recording), missing(survey, by_camera=by_camera)
    frames = outline(recording.transforms)
    is_useful = by_camera or holds_something(recording)
    command = next_command(source, found, options, by_camera=by_camera) if is_useful else ""
    if picture is not None:
        write_frames(picture, frames, picture_format)
    for line in (*_lines(survey, found, frames), *map("Images: {}".format, _image_lines(images))):
        reporter.say(line)
    for each in lacking:
        reporter.say(f"Missing: {each}")
    if command:
        reporter.say(f"Next: {command}")
    reporter.result(
        {
            "name": recording.name,
            "format": recording.format,
            **_times(survey),
            "messages": _messages(survey),
            "topics": [_facts(topic, found) for topic in survey.topics],
            "images": images["topics"],
            "unread_images": images["unread"],
            "transforms": [asdict(frame) for frame in frames],
            "reads": [asdict(choice) for choice in found],
            "missing": [asdict(each) for each in lacking],
            "anomalies": list(recording.anomalies),
            "next": command,
        }
    )


def _tell_image_folder(source: Path, reporter: Reporter) -> None:
    """Show which images are in a folder, and of which cameras. Raises as ``open_cameras``."""
    with Stages(reporter).stage("read"), open_cameras(source) as cameras:
        images = _images(cameras)
    command = shlex.join(["slamsim", "check", str(source)])
    reporter.say(f"{source.name} (images)")
    for line in _image_lines(images):
        reporter.say(f"  {line}")
    reporter.say(f"Next: {command}")
    reporter.result({"name": source.name, "format": "images", **images, "next": command})


def _recorded_images(path: Path) -> dict[str, list[dict[str, object]]]:
    """As ``_images``, of a recording; empty for formats without."""
    if not is_ros(path):
        return {"topics": [], "unread": []}
    with open_cameras(path) as cameras:
        return _images(cameras)


def _images(cameras: Cameras) -> dict[str, list[dict[str, object]]]:
    unread: list[dict[str, object]] = [
        {"topic": name, "reason": reason} for name, reason in cameras.unread.items()
    ]
    topics = [_image_facts(cameras, topic) for _, topic in sorted(cameras.topics.items())]
    return {"topics": topics, "unread": unread}


def _image_lines(images: Mapping[str, Sequence[Mapping[str, object]]]) -> Iterator[str]:
    for each in images["topics"]:
        camera = "with its camera" if each["camera"] else "no camera matrix"
        seen = f"{each['kind']}, {each['messages']:,} images of {each['width']} x {each['height']}"
        yield f"{each['topic']}: {seen}, {camera}"
    for each in images["unread"]:
        yield f"{each['topic']}: not read: {each['reason']}"


def _image_facts(cameras: Cameras, topic: CameraTopic) -> dict[str, object]:
    size = {"width": topic.width, "height": topic.height}
    about = {"topic": topic.topic, "kind": topic.kind, "messages": topic.messages}
    return {**about, **size, "camera": topic.topic in cameras.infos}


def _maps_by_camera(images: Mapping[str, Sequence[Mapping[str, object]]]) -> bool:
    """Whether ``map`` can do without scans: by depth and pictures."""
    kinds = {each["kind"] for each in images["topics"]}
    return "depth" in kinds and bool(kinds - {"depth"})


def missing(survey: Survey, *, by_camera: bool = False) -> list[Missing]:
    """What would make a better map of the next recording, the most valuable first. by_camera:
    whether it can be mapped without scans."""
    recording = survey.sample
    kinds = {choice.what for choice in choices(recording)}
    found = []
    if "scans" not in kinds:
        needed = f"without {RawScans.schema.type_name} there is nothing to map"
        worth = needed + without_scans(topics_of(recording))
        if by_camera:
            worth = "the depth camera maps in their place; it sees less far and less exactly"
        found.append(Missing("no scans", worth))
    if "odometry" not in kinds:
        worth = (
            "scans alone carry the map; it slides along corridors and tears where the robot "
            "turns fast"
        )
        found.append(Missing("no odometry", worth))
    if "IMU readings" not in kinds:
        worth = "its gyroscope measures turns that wheels get wrong by slip"
        found.append(Missing("no IMU", worth))
    return [*found, *_missing_frames(recording)]


def _missing_frames(recording: Recording) -> Iterator[Missing]:
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.base_frames)
    for scans in recording.scans[:1]:
        for frame in scans.frame_ids[:1]:
            if frame != base and not graph.connects(base, frame):
                yield Missing(
                    f"no transform from {base} to {frame}" if frame else "no frame in the scans",
                    "the laser is taken to sit at the base; if it does not, odometry and scans "
                    "disagree at every turn; "
                    + (_PUBLISH.format(base, frame) if frame else "give its driver a frame_id"),
                )
    if recording.scans and all(layout.beam_dt_s == 0.0 for layout in recording.scans[0].layouts):
        yield Missing(
            "no time_increment in the scans",
            "walls smear while the robot turns; slamsim estimates the sweep from the scans",
        )


def next_command(
    source: Path, found: Sequence[Choice], options: Sequence[str], *, by_camera: bool
) -> str:
    """What to type next."""
    can_map = by_camera or any(choice.what == "scans" for choice in found)
    return shlex.join(["slamsim", "map" if can_map else "check", str(source), *options])


def _lines(survey: Survey, found: Sequence[Choice], frames: Sequence[FramePlace]) -> Iterator[str]:
    recording = survey.sample
    yield f"{recording.name} ({recording.format}): {_span(survey)}"
    head: tuple[str, ...] = ("topic", "type", "messages", "rate", "frame", "")
    yield from aligned([head, *(_row(topic, found) for topic in survey.topics)])
    yield "Transforms" if frames else "Transforms: none"
    for line in drawn(frames):
        yield f"  {line}"
    yield in_words(found) or f"Reading {_NOTHING}"
    for words in recording.anomalies:
        yield f"Odd: {words}"


def _row(topic: TopicFacts, found: Sequence[Choice]) -> tuple[str, ...]:
    rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.3g} Hz"
    frame = ", ".join(topic.frames[:3])
    is_read = any(topic.topic in choice.topics for choice in found)
    counts = f"{topic.messages:,}"
    return topic.topic, topic.type_name, counts, rate, frame, "read" if is_read else ""


def _facts(topic: TopicFacts, found: Sequence[Choice]) -> dict[str, object]:
    is_read = any(topic.topic in choice.topics for choice in found)
    return {**asdict(topic), "rate_hz": topic.rate_hz, "is_read": is_read}


def _instants_ns(survey: Survey) -> tuple[int, int] | None:
    firsts = [topic.first_ns for topic in survey.topics if topic.first_ns is not None]
    lasts = [topic.last_ns for topic in survey.topics if topic.last_ns is not None]
    return (min(firsts), max(lasts)) if firsts and lasts else None


def _times(survey: Survey) -> dict[str, object]:
    instants = _instants_ns(survey)
    if instants is None:
        return {"start_ns": None, "duration_s": None, "epoch": survey.sample.epoch}
    first_ns, last_ns = instants
    duration_s = 1e-9 * (last_ns - first_ns)
    return {"start_ns": first_ns, "duration_s": duration_s, "epoch": survey.sample.epoch}


def _span(survey: Survey) -> str:
    instants = _instants_ns(survey)
    if instants is None:
        return "no messages with a time"
    begin = ""
    if survey.sample.epoch == "unix":
        begin = f" from {datetime.fromtimestamp(instants[0] // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    elif survey.sample.epoch == "simulation":
        begin = " of simulated time"
    return f"{_messages(survey):,} messages in {1e-9 * (instants[1] - instants[0]):.1f} s{begin}"


def _messages(survey: Survey) -> int:
    return sum(topic.messages for topic in survey.topics)
