from __future__ import annotations

import time
from threading import Lock

from rclpy import graph
from rclpy.context import Context, default_context
from rclpy.graph import Subscription
from rclpy.node import Node


class ExternalShutdownException(Exception):
    pass


class ShutdownException(Exception):
    pass


class SingleThreadedExecutor:
    def __init__(self, *, context: Context | None = None) -> None:
        self._context = context or default_context()
        self._nodes: list[Node] = []
        self._spinning = Lock()
        self._woken = self._is_shutdown = False

    def add_node(self, node: Node) -> bool:
        self._nodes.append(node)
        return True

    def remove_node(self, node: Node) -> None:
        self._nodes.remove(node)

    def wake(self) -> None:
        with graph.changed:
            self._woken = True
            graph.changed.notify_all()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        self._is_shutdown = True
        self.wake()
        return True

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """One callback, in the thread that calls this."""
        if not self._spinning.acquire(blocking=False):
            raise RuntimeError("Executor is already spinning")
        try:
            data, ready = self._wait(timeout_sec)
        finally:
            self._spinning.release()
        if ready is not None:
            ready.callback(data)

    def _wait(self, timeout_sec: float | None) -> tuple[bytes, Subscription | None]:
        end_s = time.monotonic() + (1e9 if timeout_sec is None else timeout_sec)
        with graph.changed:
            while True:
                if not self._context.ok():
                    raise ExternalShutdownException
                if self._is_shutdown:
                    raise ShutdownException
                graph.match_all()
                for one in graph.subscriptions:
                    if one.queue and one.node in self._nodes and not one.is_destroyed:
                        return one.queue.popleft(), one
                left_s = end_s - time.monotonic()
                if left_s <= 0 or self._woken:
                    self._woken = False
                    return b"", None
                graph.changed.wait(min(left_s, 0.01))
