"""The rosbridge server with the clients that people use, and with many of them."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import cbor2
import pytest
from live_data import grid, scan
from rosbridge_robot import Robot, call, serving, subscribe, told
from waiting import wait_for
from websockets.asyncio.client import connect as connect_async

from slamsim.live.hub import Message
from slamsim.live.servers.rosbridge import topics
from slamsim.live.servers.rosbridge.client import Frame, Kind

ROSLIBPY = """
import json, sys, threading, time
import roslibpy

ros = roslibpy.Ros(sys.argv[1], int(sys.argv[2]))
ros.run()
scans, arrived = [], threading.Event()

def heard(message):
    scans.append(message["ranges"][1])
    if len(scans) == 20:
        arrived.set()

topic = roslibpy.Topic(ros, "/scan", "sensor_msgs/LaserScan")
topic.subscribe(heard)
told = {
    "topics": ros.get_topics(),
    "type": ros.get_topic_type("/odom"),
    "nodes": ros.get_nodes(),
    "time": dict(ros.get_time()),
    "details": sorted(ros.get_message_details("geometry_msgs/Twist")),
    "pause": dict(roslibpy.Service(ros, "/slamsim/pause", "std_srvs/Trigger").call(
        roslibpy.ServiceRequest())),
}
print("ready", flush=True)
assert arrived.wait(60)
twists = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
twists.advertise()
for number in range(100):
    twists.publish(roslibpy.Message({"linear": {"x": number / 100}, "angular": {"z": 0.5}}))
goal = roslibpy.Topic(ros, "/goal_pose", "geometry_msgs/PoseStamped")
goal.publish(roslibpy.Message({
    "header": roslibpy.Header(1, roslibpy.Time(1, 2), "map"),
    "pose": {"position": {"x": 1.0, "y": 2.0, "z": 0.0},
             "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
}))
roslibpy.Service(ros, "/slamsim/resume", "std_srvs/Trigger").call(roslibpy.ServiceRequest())
print(json.dumps({**told, "scans": scans}), flush=True)
ros.terminate()
"""

ROSLIB_JS = """
const [root, url] = process.argv.slice(2);
const { Ros, Topic, Service } = await import(root + "/roslib/dist/RosLib.js");
const ros = new Ros({ url });
await new Promise((ready, failed) => { ros.on("connection", ready); ros.on("error", failed); });
const got = {}, waiting = [];
for (const compression of ["none", "png", "cbor"])
  for (const name of ["/scan", "/map"]) {
    const messageType = name === "/scan" ? "sensor_msgs/LaserScan" : "nav_msgs/OccupancyGrid";
    // each on a connection of its own: a client has one compression for a topic
    const own = new Ros({ url });
    await new Promise((ready, failed) => { own.on("connection", ready); own.on("error", failed); });
    const topic = new Topic({ ros: own, name, messageType, compression });
    waiting.push(new Promise((done) => topic.subscribe((message) => {
      const values = Array.from(name === "/scan" ? message.ranges : message.data);
      got[name + " " + compression] = values.map((v) => Number.isFinite(v) ? v : null);
      topic.unsubscribe(); own.close(); done();
    })));
    await new Promise((ready, failed) => own.getTopics(ready, failed));
  }
const topics = await new Promise((ready, failed) => ros.getTopics(ready, failed));
const service = new Service({ ros, name: "/slamsim/pause", serviceType: "std_srvs/Trigger" });
const paused = await new Promise((ready, failed) => service.callService({}, ready, failed));
console.log("ready");
await Promise.all(waiting);
const twists = new Topic({ ros, name: "/cmd_vel", messageType: "geometry_msgs/Twist" });
for (let n = 0; n < 100; n++)
  twists.publish({ linear: { x: n / 100, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0.5 } });
await new Promise((ready, failed) => service.callService({}, ready, failed));
console.log(JSON.stringify({ got, topics, paused }));
process.exit(0);
"""


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[str]]:
    """A client in a process of its own that has said that it is ready."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def answer_of(process: subprocess.Popen[str]) -> Any:
    assert process.stdout is not None
    return json.loads(process.stdout.readline())


def test_roslibpy_listens_asks_and_drives() -> None:
    pytest.importorskip("roslibpy", reason="the package roslibpy is not installed")
    with serving() as robot:
        arguments = ("127.0.0.1", str(robot.server.port))
        with started(sys.executable, "-c", ROSLIBPY, *arguments) as process:
            for number in range(20):
                robot.hub.publish("/scan", number, scan(number))
            told_by = answer_of(process)
        asked = robot.controls.asked
    assert told_by["topics"] == sorted(robot.hub.topics)
    assert told_by["type"] == "nav_msgs/msg/Odometry"
    assert "/slamsim" in told_by["nodes"]
    assert told_by["time"] == {"secs": 12, "nsecs": 34} | told_by["time"]
    assert told_by["pause"]["success"] is True
    assert told_by["scans"] == pytest.approx([number * 1e-3 for number in range(20)], abs=1e-9)
    assert [one for one in asked if one[0] == "drive"] == [
        ("drive", number / 100, 0.5) for number in range(100)
    ]
    assert ("go_to", 1.0, 2.0, 0.0) in asked


def roslib_js() -> tuple[str, str]:
    """node, and the folder that npm installed roslib in (SLAMSIM_NODE_MODULES, or the global)."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("node and npm are not installed")
    root = os.environ.get("SLAMSIM_NODE_MODULES")
    if root is None:
        done = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=False)
        root = done.stdout.strip()
    if not (Path(root) / "roslib" / "dist" / "RosLib.js").is_file():
        pytest.skip(f"the npm package roslib is not installed in {root} (SLAMSIM_NODE_MODULES)")
    return node, root


def test_roslib_js_reads_json_png_and_cbor(tmp_path: Path) -> None:
    node, root = roslib_js()
    script = tmp_path / "client.mjs"
    script.write_text(ROSLIB_JS)
    with serving() as robot:
        with started(node, str(script), root, robot.server.address) as process:
            robot.hub.publish("/scan", 1, scan(7))
            robot.hub.publish("/map", 2, grid(50))
            answer = answer_of(process)
        asked = robot.controls.asked
    assert sorted(answer["topics"]["topics"]) == sorted(robot.hub.topics)
    assert answer["paused"]["success"] is True
    scans = [answer["got"][f"/scan {name}"] for name in ("none", "png", "cbor")]
    assert scans[0] == scans[1] == scans[2] and scans[0][1] == pytest.approx(7e-3)
    maps = [answer["got"][f"/map {name}"] for name in ("none", "png", "cbor")]
    assert maps[0] == maps[1] == maps[2] and len(maps[0]) == 2500
    assert [one for one in asked if one[0] == "drive"] == [
        ("drive", number / 100, 0.5) for number in range(100)
    ]


@pytest.mark.parametrize("times", [50, pytest.param(1000, marks=pytest.mark.slow)])
def test_reconnects_leave_nothing_behind(times: int) -> None:
    async def come_and_go(robot: Robot) -> None:
        for number in range(times):
            async with connect_async(robot.server.address, proxy=None) as client:
                await client.send(json.dumps({"op": "subscribe", "topic": "/map", "id": number}))
                assert json.loads(await client.recv())["topic"] == "/map"

    with serving() as robot:
        robot.hub.publish("/map", 1, grid(10))
        asyncio.run(come_and_go(robot))
        wait_for(lambda: not robot.server._clients)
        assert robot.server._topics.subscribers("/map") == 0
        assert not robot.server._topics._last


def test_fifty_clients_get_every_scan() -> None:
    async def listen(robot: Robot, number: int, ready: asyncio.Barrier) -> list[int]:
        compression = ("none", "cbor", "png")[number % 3]
        async with connect_async(robot.server.address, proxy=None) as client:
            about = {"op": "subscribe", "topic": "/scan", "compression": compression}
            await client.send(json.dumps(about))
            await client.send(json.dumps({"op": "call_service", "service": "/rosapi/nodes"}))
            await client.recv()
            await ready.wait()
            if number == 0:
                for one in range(100):
                    robot.hub.publish("/scan", one, scan(one, beams=100))
            frames = [await client.recv() for _ in range(100)]
        if compression == "png":
            return [len(frames)]
        parsed = [json.loads(f) if isinstance(f, str) else cbor2.loads(f) for f in frames]
        return [one["msg"]["header"]["stamp"]["nanosec"] // 10**6 for one in parsed]

    async def all_of_them(robot: Robot) -> list[list[int]]:
        ready = asyncio.Barrier(50)
        return await asyncio.gather(*(listen(robot, number, ready) for number in range(50)))

    with serving() as robot:
        received = asyncio.run(all_of_them(robot))
    for number, scans in enumerate(received):
        assert scans == ([100] if number % 3 == 2 else list(range(100)))


def test_a_map_that_is_being_encoded_delays_no_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scans arrive though the encoding of the map does not end before; only the newest of the
    maps that came meanwhile follows."""
    begun, go_on = Event(), Event()
    encode = topics.encoded

    def slowly(message: Message, kind: Kind) -> Frame:
        if message.topic.name == "/map":
            begun.set()
            go_on.wait()
        return encode(message, kind)

    monkeypatch.setattr(topics, "encoded", slowly)
    with serving() as robot, robot.connect() as client:
        try:
            subscribe(client, "/map")
            subscribe(client, "/scan")
            for number in range(4):
                robot.hub.publish("/map", number, grid(400, seed=number))
            assert begun.wait(60.0)
            for number in range(10):
                robot.hub.publish("/scan", number, scan(number))
                assert told(client)["topic"] == "/scan"
            call(client, "/rosapi/nodes")
        finally:
            go_on.set()
        first, last = told(client), told(client)
        call(client, "/rosapi/nodes")
    expected = [json.loads(encode(_map(seed), Kind()).data)["msg"]["data"] for seed in (0, 3)]
    assert [one["msg"]["data"] for one in (first, last)] == expected


def test_scans_go_between_the_fragments_of_a_map() -> None:
    """No more of the map is on its way than the client has read, and 64 KB."""
    with serving() as robot, robot.connect() as client:
        subscribe(client, "/map", fragment_size=1000)
        subscribe(client, "/scan")
        robot.hub.publish("/map", 1, grid(700))
        got = [told(client)]
        total = got[0]["total"]
        for number in range(10):
            robot.hub.publish("/scan", number, scan(number))
        got += [told(client) for _ in range(total - 1 + 10)]
    order = [one["op"] for one in got]
    assert order.count("fragment") == total > 1000
    assert max(n for n, op in enumerate(order) if op == "publish") < 150
    text = "".join(one["data"] for one in got if one["op"] == "fragment")
    assert json.loads(text)["msg"]["info"]["width"] == 700


def _map(seed: int) -> Message:
    from live_data import MAP

    return Message(MAP, 0, grid(400, seed=seed))
