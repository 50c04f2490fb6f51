"""What a consumer of a recording makes of it: the map by odometry, headings, and what breaks.

By the messages alone, as a simple mapper would: this measures the harm that a change does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from independent.rays import Floats
from independent.writer import Message

WINDOW_S = 10.0
"""Over so long a piece a map is compared: longer drifts are what a SLAM corrects."""

HARMFUL_M = 0.05
ARM_M = 5.0
"""A wrong heading moves what is seen so far away."""

LOST_M = 0.1
"""An end that is no more seen counts so far off: harm is done where half of them are lost."""


@dataclass
class Use:
    """ends_m: by the number of a scan among all, where its beams end in odom (n, 3). turned_rad:
    by topic, the heading that integrated turn rates give, at whole seconds. gone_m: likewise the
    path by speeds. broken: reasons why a consumer cannot go on."""

    ends_m: dict[int, Floats] = field(default_factory=dict)
    at_s: dict[int, float] = field(default_factory=dict)
    turned_rad: dict[str, Floats] = field(default_factory=dict)
    gone_m: dict[str, Floats] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)


def use_of(messages: list[tuple[int, Message]]) -> Use:
    """Of messages with their numbers, which a change keeps."""
    use = Use()
    tree = _Tree([message for _, (_, topic, message) in messages if topic.startswith("/tf")])
    stamps: dict[str, int] = {}
    for number, (received_ns, topic, message) in sorted(messages, key=lambda each: each[1][0]):
        if topic.startswith("/tf"):
            continue
        stamp_ns = _stamp_ns(message)
        if stamp_ns < stamps.get(topic, stamp_ns):
            use.broken.add(f"{topic}: stamps go backward")
        if not -0.2e9 < received_ns - stamp_ns < 1e9:
            use.broken.add(f"{topic}: stamps and receipt are apart")
        stamps[topic] = stamp_ns
        if hasattr(message, "ranges"):
            _use_scan(use, tree, number, message)
    for topic in {topic for _, (_, topic, _) in messages}:
        _use_rates(use, topic, [each for _, (_, name, each) in messages if name == topic])
    return use


def harm_m(before: Use, after: Use) -> float:
    """By how much a map is wrong, inf where a consumer breaks."""
    if after.broken - before.broken:
        return np.inf
    worst = _map_error_m(before, after)
    for topic, turned in before.turned_rad.items():
        worst = max(worst, ARM_M * _apart(turned, after.turned_rad.get(topic)))
        worst = max(worst, _apart(before.gone_m[topic], after.gone_m.get(topic)))
    return worst


def _map_error_m(before: Use, after: Use) -> float:
    """The largest mean distance of ends, over windows that are laid onto each other."""
    begin_s = min(before.at_s.values(), default=0.0)
    windows: dict[int, list[int]] = {}
    for number, at_s in before.at_s.items():
        windows.setdefault(int((at_s - begin_s) / WINDOW_S), []).append(number)
    worst = 0.0
    for numbers in windows.values():
        if 2 * sum(number in after.ends_m for number in numbers) < len(numbers):
            return np.inf
        pairs = [_finite(before.ends_m[n], after.ends_m[n]) for n in numbers if n in after.ends_m]
        one, other = (np.concatenate(each) for each in zip(*pairs, strict=True))
        if len(one) > 10:
            worst = max(worst, float(np.linalg.norm(_laid_onto(one, other) - one, axis=1).mean()))
    return worst


def _finite(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Ends that were seen before, and where they are now."""
    count = min(len(one), len(other))
    one, other = one[:count], other[:count]
    seen = np.isfinite(one).all(axis=1)
    lost = np.asarray(seen & ~np.isfinite(other).all(axis=1))
    off = np.nan_to_num(one) + np.array([0.0, 0.0, LOST_M])
    filled: Floats = np.asarray(np.where(lost[:, None], off, other))
    return one[seen], filled[seen]


def _laid_onto(one: Floats, other: Floats) -> Floats:
    """The other, turned about z and shifted so that it fits best."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    turn = np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (b[:, :2] * a[:, :2]).sum())
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = cos * b[:, 0] - sin * b[:, 1], sin * b[:, 0] + cos * b[:, 1]
    return np.asarray(np.column_stack([x, y, b[:, 2]]) + one.mean(axis=0))


def _apart(one: Floats, other: Floats | None) -> float:
    """The largest difference of what is gained over a window."""
    if other is None or not np.isfinite(other).all():
        return np.inf
    count, window = min(len(one), len(other)), int(WINDOW_S)
    if count < 0.8 * len(one):
        return np.inf
    gains = (one[:count] - other[:count])[window:] - (one[:count] - other[:count])[:-window]
    return float(np.abs(gains).max(initial=0.0))


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _use_scan(use: Use, tree: _Tree, number: int, scan: Any) -> None:
    beams = len(scan.ranges)
    spanned, step = scan.angle_max - scan.angle_min, scan.angle_increment
    if beams < 2 or not step or not abs(spanned / step - (beams - 1)) < 1.5:
        use.broken.add("a scan's angles do not fit its ranges")
        return
    if len(scan.intensities) not in (0, beams):
        use.broken.add("a scan's intensities do not fit its ranges")
    use.at_s[number] = 1e-9 * _stamp_ns(scan)
    if abs(scan.time_increment) * beams > 1.0:
        use.broken.add("a scan lasts longer than a second")
        return
    angles = scan.angle_min + scan.angle_increment * np.arange(beams)
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    ranges = np.where((ranges >= scan.range_min) & (ranges <= scan.range_max), ranges, np.nan)
    points = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(beams)])
    at_s = 1e-9 * (_stamp_ns(scan) - tree.begin_ns) + scan.time_increment * np.arange(beams)
    placed = tree.placed(scan.header.frame_id, at_s, points)
    if isinstance(placed, str):
        use.broken.add(placed)
    else:
        use.ends_m[number] = placed


def _use_rates(use: Use, topic: str, messages: list[Any]) -> None:
    """Headings and paths of odometry and inertial units, also by their poses."""
    first = messages[0]
    if hasattr(first, "twist"):
        rates = np.array([[m.twist.twist.angular.z, m.twist.twist.linear.x] for m in messages])
        turn = np.array([_xyzw(m.pose.pose.orientation) for m in messages])
        place = np.array([[m.pose.pose.position.x, m.pose.pose.position.y] for m in messages])
        if not (np.isfinite(place).all() and _are_turns(turn)):
            use.broken.add(f"{topic}: poses are none")
        elif len(place) > 1:
            yaw = np.unwrap(2.0 * np.arctan2(turn[:, 2], turn[:, 3]))
            steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
            at_s = _seconds(messages)
            use.turned_rad[f"{topic} pose"] = _by_second(at_s, yaw)
            use.gone_m[f"{topic} pose"] = _by_second(at_s, np.concatenate([[0.0], steps.cumsum()]))
    elif hasattr(first, "angular_velocity"):
        rates = np.array([[m.angular_velocity.z, 0.0] for m in messages])
        felt = np.array([[m.linear_acceleration.x, m.linear_acceleration.z] for m in messages])
        given = [m.orientation for m in messages if m.orientation_covariance[0] >= 0.0]
        if given and not _are_turns(np.array([_xyzw(each) for each in given])):
            use.broken.add(f"{topic}: orientations are none")
        if not np.isfinite(felt).all() or abs(np.median(felt[:, 1]) - 9.8) > 1.0:
            use.broken.add(f"{topic}: no gravity")
    else:
        return
    at_s = _seconds(messages)
    if len(at_s) < 2 or np.diff(np.sort(at_s)).max() > 2.0:
        use.broken.add(f"{topic}: a gap of seconds")
        return
    steps = rates * np.gradient(at_s)[:, None]
    use.turned_rad[topic] = _by_second(at_s, steps[:, 0].cumsum())
    use.gone_m[topic] = _by_second(at_s, steps[:, 1].cumsum())


def _seconds(messages: list[Any]) -> Floats:
    return np.array([1e-9 * (_stamp_ns(message) % 10**13) for message in messages])


def _by_second(at_s: Floats, values: Floats) -> Floats:
    return np.asarray(np.interp(np.arange(at_s[0], at_s[-1], 1.0), at_s, values))


def _xyzw(quaternion: Any) -> list[float]:
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]


def _are_turns(quaternions: Floats) -> bool:
    return bool((np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) < 0.01).all())


class _Tree:
    """Transforms by child frame, to be looked up at any instant."""

    def __init__(self, messages: list[Any]) -> None:
        rows: dict[str, list[tuple[int, str, list[float]]]] = {}
        for message in messages:
            for each in message.transforms:
                place = each.transform.translation
                row = [place.x, place.y, place.z, *_xyzw(each.transform.rotation)]
                rows.setdefault(each.child_frame_id, []).append(
                    (_stamp_ns(each), each.header.frame_id, row)
                )
        every = [stamp for known in rows.values() if len(known) > 1 for stamp, _, _ in known]
        self.begin_ns = min(every, default=0)
        self.edges = {
            child: (
                {parent for _, parent, _ in known},
                np.array([1e-9 * (stamp - self.begin_ns) for stamp, _, _ in known]),
                np.array([row for _, _, row in known]),
            )
            for child, known in rows.items()
        }

    def placed(self, frame: str, at_s: Floats, points: Floats) -> Floats | str:
        """The points (n, 3) in odom, or why not."""
        for _ in range(8):
            if frame == "odom":
                return points
            if frame not in self.edges:
                return f"no transform of {frame}"
            parents, known_s, rows = self.edges[frame]
            if len(parents) > 1:
                return f"{frame} has two parents"
            order = np.argsort(known_s, kind="stable")
            if len(known_s) > 1 and not (known_s.min() - 0.2 < at_s[0] < known_s.max() + 0.2):
                return f"no transform of {frame} at a scan"
            row = np.column_stack([np.interp(at_s, known_s[order], c[order]) for c in rows.T])
            turn = row[:, 3:]
            norm = np.linalg.norm(turn, axis=1, keepdims=True)
            if not (np.isfinite(row).all() and (norm > 0.01).all()):
                return f"the transform of {frame} is none"
            turn = turn / norm
            cross = 2.0 * np.cross(turn[:, :3], points)
            points = points + turn[:, 3:] * cross + np.cross(turn[:, :3], cross) + row[:, :3]
            frame = next(iter(parents))
        return "transforms run in a circle"
