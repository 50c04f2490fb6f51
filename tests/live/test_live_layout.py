"""The layout for Foxglove and Lichtblick: its form, and that it shows what there is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from served_robot import LIVE_TOPICS

from slamsim.config.bundled import bundled_folder
from slamsim.config.drive import LimitsConfig
from slamsim.io.ros.message_types import ros2_types
from slamsim.live.controls import HOLD_S
from slamsim.live.requests import SERVICES, SUBSCRIBED

LAYOUT: dict[str, Any] = json.loads(
    Path(bundled_folder("configs"), "foxglove_layout.json").read_text()
)
PANELS: dict[str, dict[str, Any]] = LAYOUT["configById"]


def placed(tree: Any) -> Iterator[str]:
    """The panels of a mosaic: a name, or two parts with a direction."""
    if isinstance(tree, str):
        yield tree
    else:
        assert tree.keys() == {"direction", "splitPercentage", "first", "second"}
        assert tree["direction"] in ("row", "column")
        yield from (*placed(tree["first"]), *placed(tree["second"]))


def panel(kind: str) -> dict[str, Any]:
    return next(config for name, config in PANELS.items() if name.startswith(f"{kind}!"))


def test_it_has_the_keys_of_the_format_and_each_panel_once() -> None:
    needed = {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert needed == LAYOUT.keys()
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)


def test_its_topics_are_those_of_a_live_robot() -> None:
    assert panel("3D")["topics"].keys() <= LIVE_TOPICS.keys()
    assert panel("DiagnosticSummary")["topicToRender"] in LIVE_TOPICS
    assert panel("3D")["publish"]["poseTopic"] in SUBSCRIBED
    assert panel("CallService")["serviceName"] in SERVICES


@pytest.mark.parametrize(
    "path",
    [p["value"] for name, c in PANELS.items() if name.startswith("Plot!") for p in c["paths"]],
)
def test_a_plotted_number_is_a_field_of_its_message(path: str) -> None:
    topic = next(name for name in LIVE_TOPICS if path.startswith(f"{name}."))
    definitions, kind = ros2_types().fielddefs, LIVE_TOPICS[topic]
    for name in path.removeprefix(f"{topic}.").split("."):
        kind = dict(definitions[kind][1])[name][1]  # type: ignore[assignment]
    assert kind[0] == "float64"


def test_the_joystick_holds_the_robot_within_its_limits_and_in_motion() -> None:
    """Each twist arrives before the last one runs out, and asks for nothing that is cut off."""
    teleop, limits = panel("Teleop"), LimitsConfig()
    assert teleop["topic"] in SUBSCRIBED
    assert 1.0 / teleop["publishRate"] < HOLD_S
    most = {"linear-x": limits.max_speed_m_s, "angular-z": limits.max_yaw_rate_rad_s}
    for button in ("upButton", "downButton", "leftButton", "rightButton"):
        assert abs(teleop[button]["value"]) <= most[teleop[button]["field"]]
