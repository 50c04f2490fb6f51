"""What slamsim uses of rclpy (Jazzy), with the graph in this process instead of a network.

It behaves as https://github.com/ros2/rclpy does where that matters here: endpoints find each other
after a while and only with compatible quality of service, callbacks run in the thread that spins,
and a node that was destroyed publishes nothing.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module

from rclpy.context import Context, default_context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

ROBOT = "SLAMSIM_TEST_ROBOT"
"""Module with a ``start()`` that is called once ROS runs, for tests of the whole process."""


def init(
    *,
    args: Sequence[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> None:
    assert signal_handler_options is SignalHandlerOptions.NO, "Ctrl-C would end ROS at once"
    (context or default_context()).init(list(args or ()))
    if ROBOT in os.environ:
        import_module(os.environ[ROBOT]).start()


def create_node(node_name: str, *, context: Context | None = None, namespace: str = "") -> Node:
    return Node(node_name, context=context, namespace=namespace)


def try_shutdown(*, context: Context | None = None) -> None:
    (context or default_context()).shutdown()
