"""Twists and goals for a robot that runs elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from threading import Condition, Thread

from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_number
from slamsim.io.bag2.writer import TopicKind
from slamsim.live.controls import HOLD_S
from slamsim.live.drivers import FASTEST
from slamsim.live.published import SlamMessages
from slamsim.live.sources.source import MessageLink

_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_GOALS = ("geometry_msgs/msg/PoseStamped",)


class Teleop:
    """Safe to use from any thread, until it is closed.

    A thread of its own stops a robot that was driven when no twist follows, for its base may not do
    so itself, and a slow disk must not delay it.
    """

    def __init__(self, source: MessageLink) -> None:
        self._source, self._messages = source, SlamMessages()
        self._changed, self._is_closed = Condition(), False
        self._until_s: float | None = None
        self._thread = Thread(target=self._stop_in_time, name="teleop", daemon=True)

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """See ``Controls``. Raises SlamsimError for a robot that takes no twists."""
        require_number("the speed of a twist in m/s", speed_m_s, -FASTEST, FASTEST)
        require_number("the yaw rate of a twist in rad/s", yaw_rate_rad_s, -FASTEST, FASTEST)
        require_number("the seconds to hold a twist", hold_s, 0.0, 60.0)
        with self._open():
            is_standing = speed_m_s == 0.0 and yaw_rate_rad_s == 0.0
            self._send(speed_m_s, yaw_rate_rad_s)
            self._until_s = None if is_standing else time.monotonic() + hold_s
            if self._thread.ident is None:
                self._thread.start()
            self._changed.notify()

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None) -> None:
        """See ``Controls``. Raises SlamsimError for a robot without navigation."""
        for name, value in (("x_m", x_m), ("y_m", y_m), ("yaw_rad", yaw_rad or 0.0)):
            require_number(name, value, -1e6, 1e6)
        with self._open():
            missing = "no topic for goals, such as /goal_pose"
            topic = self._topic(("goal_pose", "goal"), _GOALS, missing)
            data = self._messages.goal(time.time_ns(), (x_m, y_m, yaw_rad or 0.0))
            self._source.publish(topic.name, topic.type_name, data)

    def close(self) -> None:
        """Stop the robot if it was driven and not told to stop yet. Nothing drives it then."""
        with self._changed:
            self._is_closed = True
            self._stop()
            self._changed.notify()

    @contextmanager
    def _open(self) -> Iterator[None]:
        with self._changed:
            if self._is_closed:
                raise SlamsimError("the live robot has ended")
            yield

    def _stop_in_time(self) -> None:
        with self._changed:
            while not self._is_closed:
                until_s = self._until_s
                left_s = None if until_s is None else until_s - time.monotonic()
                if left_s is not None and left_s <= 0.0:
                    self._stop()
                else:
                    self._changed.wait(left_s)

    def _stop(self) -> None:
        if self._until_s is not None:
            self._until_s = None
            with suppress(SlamsimError):  # its topic for twists is gone
                self._send(0.0, 0.0)

    def _send(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        topic = self._topic(("cmd_vel",), _TWISTS, "no topic for twists, such as /cmd_vel")
        is_stamped = topic.type_name == _TWISTS[1]
        data = self._messages.twist(time.time_ns(), speed_m_s, yaw_rate_rad_s, stamped=is_stamped)
        self._source.publish(topic.name, topic.type_name, data)

    def _topic(self, endings: Sequence[str], types: Sequence[str], missing: str) -> TopicKind:
        found = [one for one in self._source.topics() if one.type_name in types]
        found = [one for one in found if one.name.endswith(tuple(endings))]
        if not found:
            raise SlamsimError(f"the robot has {missing}")
        return min(found, key=lambda one: len(one.name))
