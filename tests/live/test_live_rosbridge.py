"""The operations of the rosbridge server, over raw WebSockets."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cbor2
import cv2
import numpy as np
import pytest
from live_data import grid, hub, scan
from rosbridge_robot import Robot, ask, call, complaint, serving, subscribe, told
from served_robot import NotedControls
from waiting import TIMEOUT_S
from websockets.exceptions import ConnectionClosedOK

from slamsim.io.ros.message_types import ros2_types
from slamsim.live.servers.access import Access
from slamsim.live.servers.rosbridge.server import RosbridgeServer

FAR = {"pose": {"position": {"x": 1e9}}}


@pytest.fixture
def robot() -> Iterator[Robot]:
    with serving() as served:
        yield served


def numbers(messages: list[Any]) -> list[int]:
    return [one["msg"]["header"]["stamp"]["nanosec"] // 1_000_000 for one in messages]


def test_a_scan_arrives_as_json_as_rosbridge_writes_it(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", type="sensor_msgs/msg/LaserScan")
        robot.hub.publish("/scan", 5, scan(7))
        message = told(client)
    assert message["op"] == "publish" and message["topic"] == "/scan"
    stamp = {"sec": 0, "nanosec": 7_000_000}
    assert message["msg"]["header"] == {"stamp": stamp, "frame_id": "laser"}
    ranges = message["msg"]["ranges"]
    assert ranges[0] is None and ranges[-1] is None
    assert ranges[1] == float(np.float32(7e-3))


def test_a_client_of_ros_1_finds_its_field_names_too(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", type="sensor_msgs/LaserScan")
        robot.hub.publish("/scan", 5, scan(7))
        header = told(client)["msg"]["header"]
    stamp = {"sec": 0, "nanosec": 7_000_000, "secs": 0, "nsecs": 7_000_000}
    assert header == {"seq": 0, "stamp": stamp, "frame_id": "laser"}


def test_cbor_has_typed_arrays(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", compression="cbor")
        robot.hub.publish("/scan", 5, scan(7))
        ranges = told(client)["msg"]["ranges"]
        assert isinstance(ranges, cbor2.CBORTag) and ranges.tag == 85
        values = np.frombuffer(ranges.value, "<f4")
        assert values[0] == math.inf and math.isnan(values[-1]) and values[1] == np.float32(7e-3)
        ask(client, op="unsubscribe", topic="/scan")
        subscribe(client, "/scan", compression="cbor-raw")
        robot.hub.publish("/scan", 3_000_000_004, scan(7))
        raw = told(client)["msg"]
    assert raw == {"secs": 3, "nsecs": 4, "bytes": scan(7)}


def test_png_holds_the_json(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/map", compression="png")
        robot.hub.publish("/map", 5, grid(30))
        answer = told(client)
        assert answer["op"] == "png"
        image = np.frombuffer(base64.b64decode(answer["data"]), np.uint8)
        pixels = cv2.imdecode(image, cv2.IMREAD_COLOR_RGB)
        assert pixels is not None
        message = json.loads(pixels.tobytes())
    expected: Any = ros2_types().deserialize_cdr(grid(30), "nav_msgs/msg/OccupancyGrid")
    assert message["msg"]["data"] == expected.data.tolist()


def test_fragments_join_to_the_message(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/map", fragment_size=1000)
        robot.hub.publish("/map", 5, grid(60))
        parts = [told(client)]
        assert parts[0]["op"] == "fragment" and parts[0]["total"] > 5
        parts += [told(client) for _ in range(parts[0]["total"] - 1)]
    assert len({part["id"] for part in parts}) == 1
    assert all(len(part["data"]) <= 1000 for part in parts)
    message = json.loads("".join(p["data"] for p in sorted(parts, key=lambda p: p["num"])))
    assert len(message["msg"]["data"]) == 3600


def test_fragments_of_a_client_are_joined(robot: Robot) -> None:
    text = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.25}}})
    with robot.connect() as client:
        for number in (2, 0, 1):
            data = text[number * 30 : (number + 1) * 30 if number < 2 else None]
            ask(client, op="fragment", id="f", num=number, total=3, data=data)
        call(client, "/rosapi/nodes")
    assert robot.controls.asked == [("drive", 0.25, 0.0)]


def test_a_late_client_gets_the_last_map_once(robot: Robot) -> None:
    for seed in (1, 2):
        robot.hub.publish("/map", seed, grid(5, seed))
    with robot.connect() as client, robot.connect() as another:
        for one in (client, another):
            ask(one, op="subscribe", topic="/map")
            message = told(one)
            assert message["topic"] == "/map"
            call(one, "/rosapi/nodes")
        expected: Any = ros2_types().deserialize_cdr(grid(5, 2), "nav_msgs/msg/OccupancyGrid")
        assert message["msg"]["data"] == expected.data.tolist()


@pytest.mark.parametrize(
    ("topic", "msg", "asked"),
    [
        ("/cmd_vel", {"linear": {"x": 0.5}, "angular": {"z": -1}}, ("drive", 0.5, -1.0)),
        ("/cmd_vel", {"twist": {"linear": {"x": 0.5}}}, ("drive", 0.5, 0.0)),
        (
            "/cmd_vel",
            {"header": {"seq": 4, "stamp": {"secs": 1, "nsecs": 2}}, "twist": {}},
            ("drive", 0.0, 0.0),
        ),
        (
            "/goal_pose",
            {"pose": {"position": {"x": 1}, "orientation": {"z": 1.0, "w": 0.0}}},
            ("go_to", 1.0, 0.0, pytest.approx(math.pi)),
        ),
        (
            "/move_base_simple/goal",
            {"pose": {"position": {"y": 2.0}, "orientation": {"w": 0.0}}},
            ("go_to", 0.0, 2.0, None),
        ),
    ],
)
def test_what_clients_publish_drives_the_robot(
    robot: Robot, topic: str, msg: Any, asked: tuple[Any, ...]
) -> None:
    kind = "geometry_msgs/Twist" if topic == "/cmd_vel" else "geometry_msgs/msg/PoseStamped"
    with robot.connect() as client:
        ask(client, op="advertise", topic=topic, type=kind)
        ask(client, op="publish", topic=topic, msg=msg)
        call(client, "/slamsim/resume")  # answered on the threads that drive to goals
    assert sorted(robot.controls.asked, key=str) == sorted([asked, ("pause", False)], key=str)


def test_services_ask_the_robot(robot: Robot) -> None:
    with robot.connect() as client:
        assert call(client, "/slamsim/pause") == {"success": True, "message": "time stands still"}
        assert call(client, "/slamsim/step")["success"]
        assert call(client, "/slamsim/step", seconds=0.5)["success"]
        assert call(client, "/slamsim/step", seconds=90)["success"] is False
        assert "seconds must be" in call(client, "/slamsim/step", seconds="1")["message"]
        for name in ("resume", "reset"):
            assert call(client, f"/slamsim/{name}")["success"]
        assert call(client, "/slamsim/set_rate", rate=2)["success"]
        assert call(client, "/slamsim/set_rate", rate=None)["success"]
        assert "rate must be" in call(client, "/slamsim/set_rate", rate="fast")["message"]
        assert "drive_1" in call(client, "/slamsim/record", data=True)["message"]
        refused = call(client, "/slamsim/save_map")
        assert refused == {"success": False, "message": "there is no map: SLAM is off"}
        ask(client, op="call_service", service="/slamsim/fly")
        assert told(client)["values"] == "there is no service '/slamsim/fly'"
    assert robot.controls.asked == [
        *(("pause", True), ("step", 0.1), ("step", 0.5), ("pause", False), ("reset",)),
        *(("set_rate", 2.0), ("set_rate", None), ("record", Path("drive_1"))),
    ]


def test_rosapi_tells_topics_types_and_services(robot: Robot) -> None:
    with robot.connect() as client:
        told_topics = call(client, "/rosapi/topics")
        assert dict(zip(told_topics["topics"], told_topics["types"], strict=True)) == {
            name: kind.type_name for name, kind in robot.hub.topics.items()
        }
        kind = call(client, "/rosapi/topic_type", topic="/odom")
        assert kind == {"type": "nav_msgs/msg/Odometry"}
        assert call(client, "/rosapi/topic_type", topic="/none") == {"type": ""}
        scans = call(client, "/rosapi/topics_for_type", type="sensor_msgs/LaserScan")
        assert scans == {"topics": ["/scan"]}
        assert "/slamsim" in call(client, "/rosapi/nodes")["nodes"]
        assert "/slamsim/pause" in call(client, "/rosapi/services")["services"]
        kind = call(client, "/rosapi/service_type", service="/slamsim/pause")
        assert kind == {"type": "std_srvs/srv/Trigger"}
        triggers = call(client, "/rosapi/services_for_type", type="std_srvs/Trigger")["services"]
        assert triggers == [
            f"/slamsim/{n}" for n in ("pause", "reset", "resume", "save_map", "step")
        ]
        assert call(client, "/rosapi/get_time")["time"]["sec"] == 12
        details = call(client, "/rosapi/message_details", type="sensor_msgs/LaserScan")["typedefs"]
        assert {one["type"] for one in details} == {
            *("sensor_msgs/msg/LaserScan", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"),
        }
        assert call(client, "/rosapi/node_details", node="/slamsim")["publishing"]
        raw = call(client, "/rosapi/topics_and_raw_types")["typedefs_full_text"]
        assert any("float32 angle_increment" in text for text in raw)


def test_a_topic_of_a_client_reaches_the_others(robot: Robot) -> None:
    with robot.connect() as speaker, robot.connect() as listener:
        ask(speaker, op="advertise", topic="/chatter", type="std_msgs/String")
        call(speaker, "/rosapi/nodes")
        subscribe(listener, "/chatter")
        ask(speaker, op="publish", topic="/chatter", msg={"data": "hello"})
        assert told(listener)["msg"] == {"data": "hello"}
        assert "has no field 'date'" in complaint(
            speaker, op="publish", topic="/chatter", msg={"date": ""}
        )
        ask(speaker, op="unadvertise", topic="/chatter")
        assert "not advertised" in complaint(speaker, op="publish", topic="/chatter", msg={})
        assert "/chatter" not in call(speaker, "/rosapi/topics")["topics"]


def test_a_service_of_a_client_is_called_by_the_others(robot: Robot) -> None:
    with robot.connect() as caller:
        with robot.connect() as server:
            ask(server, op="advertise_service", service="/double", type="test/Double")
            assert call(server, "/rosapi/service_type", service="/double")["type"] == "test/Double"
            ask(caller, op="call_service", service="/double", args={"value": 4}, id="mine")
            asked = told(server)
            assert (asked["op"], asked["args"]) == ("call_service", {"value": 4})
            assert "no service was called" in complaint(
                caller, op="service_response", id=asked["id"], values={}, result=True
            )
            values = {"double": 8}
            ask(server, op="service_response", id=asked["id"], values=values, result=True)
            answer = told(caller)
            assert (answer["id"], answer["values"], answer["result"]) == ("mine", values, True)
            assert "another client" in complaint(
                caller, op="advertise_service", service="/double", type="test/Double"
            )
            assert "the robot serves" in complaint(
                caller, op="advertise_service", service="/slamsim/pause", type="x/Y"
            )
            ask(caller, op="call_service", service="/double", args={}, id="lost")
            told(server)
        answer = told(caller)
        assert (answer["id"], answer["result"]) == ("lost", False)
        ask(caller, op="call_service", service="/double")
        assert told(caller)["values"] == "there is no service '/double'"


def test_no_client_speaks_for_the_robot(robot: Robot) -> None:
    with robot.connect() as client:
        ask(client, op="advertise", topic="/scan", type="sensor_msgs/LaserScan")
        assert "by the robot alone" in complaint(client, op="publish", topic="/scan", msg={})


def test_a_full_queue_drops_its_oldest(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", throttle_rate=1, queue_length=3)
        with robot.paused():
            for number in range(10):
                robot.hub.publish("/scan", number, scan(number))
        received = [told(client) for _ in range(3)]
        call(client, "/rosapi/nodes")
    assert numbers(received) == [7, 8, 9]


def test_a_rate_limit_without_a_queue_drops_what_is_between(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", throttle_rate=3_600_000)
        for number in range(10):
            robot.hub.publish("/scan", number, scan(number))
        assert numbers([told(client)]) == [0]
        call(client, "/rosapi/nodes")


def test_two_requests_of_a_client_are_one_subscription(robot: Robot) -> None:
    with robot.connect() as client:
        subscribe(client, "/scan", id="a")
        subscribe(client, "/scan", id="b")
        ask(client, op="unsubscribe", topic="/scan", id="a")
        robot.hub.publish("/scan", 1, scan(1))
        assert numbers([told(client)]) == [1]
        ask(client, op="unsubscribe", topic="/scan", id="b")
        call(client, "/rosapi/nodes")
        robot.hub.publish("/scan", 2, scan(2))
        call(client, "/rosapi/nodes")
        assert "no such subscription" in complaint(client, op="unsubscribe", topic="/scan")


@pytest.mark.parametrize(
    ("operation", "reason"),
    [
        ({"op": "fly"}, "an 'op' is needed"),
        ({"id": 3}, "an 'op' is needed"),
        ({"op": ["subscribe"]}, "an 'op' is needed"),
        ({"op": "subscribe"}, "topic is needed"),
        ({"op": "subscribe", "topic": "/none"}, "there is no topic '/none'"),
        ({"op": "subscribe", "topic": "/scan", "type": "nav_msgs/Odometry"}, "is of type sensor"),
        ({"op": "subscribe", "topic": "/scan", "type": "no/Such"}, "'no/Such' is not known"),
        ({"op": "subscribe", "topic": "/scan", "compression": "zip"}, "one of none, png"),
        ({"op": "subscribe", "topic": "/scan", "throttle_rate": -1}, "throttle_rate"),
        ({"op": "subscribe", "topic": "/scan", "queue_length": True}, "queue_length"),
        ({"op": "subscribe", "topic": "/scan", "fragment_size": 1}, "at least 100"),
        ({"op": "advertise", "topic": "/cmd_vel", "type": "std_msgs/String"}, "takes geometry"),
        ({"op": "publish", "topic": "/cmd_vel"}, "is needed, not None"),
        ({"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": "1"}}}, "linear.x"),
        (
            {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": None}}},
            "must be a number",
        ),
        (
            {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": math.nan}}},
            "must be a number",
        ),
        (
            {"op": "publish", "topic": "/goal_pose", "msg": {"pose": {"position": {"x": 1e9}}}},
            "path",
        ),
        ({"op": "set_level", "level": "loud"}, "one of none, error"),
        ({"op": "fragment", "id": "f", "num": 3, "total": 3, "data": ""}, "fragment 3 of 3"),
        ({"op": "fragment", "id": "f", "num": 0, "total": 10**9, "data": ""}, "at most"),
        ({"op": "fragment", "id": "f", "num": 0, "total": 1, "data": "{"}, "not JSON"),
    ],
)
def test_what_is_wrong_is_told(robot: Robot, operation: dict[str, Any], reason: str) -> None:
    with robot.connect() as client:
        assert reason in complaint(client, **operation)
        call(client, "/rosapi/nodes")
    assert not robot.controls.asked


def test_a_client_chooses_what_it_is_told(robot: Robot) -> None:
    with robot.connect() as client:
        ask(client, op="set_level", level="none")
        ask(client, op="fly")
        call(client, "/rosapi/nodes")
        ask(client, op="set_level", level="error")
        assert "'op'" in complaint(client, op="fly", id="x")


def test_a_server_that_stops_says_so_and_leaves_its_port() -> None:
    with ExitStack() as open_client:
        with serving() as robot:
            client = open_client.enter_context(robot.connect())
            port = robot.server.port
        with pytest.raises(ConnectionClosedOK, match="going away"):
            client.recv(timeout=TIMEOUT_S)
    with RosbridgeServer(hub(), NotedControls(), Access(), port):
        pass
