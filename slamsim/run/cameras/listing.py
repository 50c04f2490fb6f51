"""``slamsim info`` of a folder of images."""

from __future__ import annotations

import shlex
from pathlib import Path

from slamsim.console.reporter import Reporter
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.run.stages import Stages


def tell_images(source: Path, reporter: Reporter) -> None:
    """Show which images are in a folder, and of which cameras. Raises as ``open_cameras``."""
    with Stages(reporter).stage("read"), open_cameras(source) as cameras:
        topics = [_facts(cameras, topic) for _, topic in sorted(cameras.topics.items())]
    command = shlex.join(["slamsim", "check", str(source)])
    reporter.say(f"{source.name} (images)")
    for each in topics:
        camera = "with its camera" if each["camera"] else "no camera matrix"
        seen = f"{each['kind']}, {each['messages']:,} images of {each['width']} x {each['height']}"
        reporter.say(f"  {each['topic']}: {seen}, {camera}")
    for topic, reason in cameras.unread.items():
        reporter.say(f"  {topic}: not read: {reason}")
    reporter.say(f"Next: {command}")
    unread = [{"topic": name, "reason": reason} for name, reason in cameras.unread.items()]
    about = {"name": source.name, "format": "images"}
    reporter.result({**about, "topics": topics, "unread": unread, "next": command})


def _facts(cameras: Cameras, topic: CameraTopic) -> dict[str, object]:
    size = {"width": topic.width, "height": topic.height}
    about = {"topic": topic.topic, "kind": topic.kind, "messages": topic.messages}
    return {**about, **size, "camera": topic.topic in cameras.infos}
