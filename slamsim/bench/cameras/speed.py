"""How much processor time cameras take, in a drive through the configured world.

Processor time, not wall time: what other programs do beside does not count. One thread casts; that
of packing images in threads beside is left out of the depth, whose images are not packed.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import Drive, Float32Array
from slamsim.sensors.base import Site
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.motion import Motion
from slamsim.sensors.scene import Scene
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import drive
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.appearance import appearance_of, in_pieces
from slamsim.world.build import build_world
from slamsim.world.model import World

Figures = dict[str, object]

CORES = 2
"""For which ``rgbd_realtime_factor`` is told, all work being shared among them evenly."""
_ROUNDS = 3
"""Of each measurement, of which the least counts: other work only adds."""
_VGA = {"width": 640, "height": 480, "horizontal_fov_deg": 75.0}
_SMALL = {"width": 424, "height": 240, "horizontal_fov_deg": 69.0}
_MOUNT = {"x_m": 0.1, "z_m": 0.4}
_CAST_FRAMES = 10


def measure_speed(config: RunConfig, reporter: Reporter) -> Figures:
    """Real-time factors, and the time of a depth image beside that of its rays alone."""
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    route = plan_route(world, robot, config.drive)
    windows = list(drive(world, robot, route, config.drive))
    depth = {"kind": "depth", "encoding": "raw", "lens": _VGA}
    exact = {**depth, "depth": {"is_exact": True}}
    rgbd = {
        "color": {"lens": _SMALL},
        "depth": {"kind": "depth", "encoding": "png", "lens": _SMALL},
        "infra": {"kind": "infrared", "lens": _SMALL},
    }
    with reporter.stage("cameras", "measurements") as progress:
        noisy_s = _cpu_per_second(config, world, windows, 30.0, {"depth": depth})
        progress(1, 4)
        exact_s = _cpu_per_second(config, world, windows, 30.0, {"depth": exact})
        progress(2, 4)
        rgbd_s = _cpu_per_second(config, world, windows, 15.0, rgbd)
        progress(3, 4)
        over_bare = _time_over_bare_cast(world, windows)
        progress(4, 4)
    return {
        "depth_realtime_factor": 1.0 / noisy_s,
        "exact_depth_realtime_factor": 1.0 / exact_s,
        "rgbd_realtime_factor": CORES / rgbd_s,
        "rgbd_cpu_s_per_s": rgbd_s,
        "time_over_bare_cast": over_bare,
    }


def _cpu_per_second(
    config: RunConfig, world: World, windows: list[Drive], rate_hz: float, imagers: Any
) -> float:
    """Seconds of processor time for a second of the drive, messages included."""
    entry = {"type": "camera", "name": "camera", "rate_hz": rate_hz, "mount": _MOUNT}
    sensors = SensorsConfig.model_validate({"additional": [{**entry, "imagers": imagers}]})
    site_of = appearance_of(world, config.world.looks)
    start_ns = int(windows[0].stamps_ns[0])
    seconds = (int(windows[-1].stamps_ns[-1]) - start_ns) * 1e-9
    motions = [Motion(piece) for window in windows for piece in in_pieces(window, sensors)]

    def sense_all() -> None:
        camera = sensors.additional[0].build(
            Site(world.mesh, config.seed, start_ns, appearance=site_of)
        )
        for motion in motions:
            camera.sense(motion).streams()

    return min(_cpu_s(sense_all) for _ in range(_ROUNDS)) / seconds


def _cpu_s(work: Any) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def _time_over_bare_cast(world: World, windows: list[Drive]) -> float:
    """True depth images, from poses to metres, beside the caster on rays that are there."""
    sensors = SensorsConfig.model_validate(
        {"additional": [{"type": "camera", "name": "camera", "mount": _MOUNT}]}
    )
    entry = sensors.additional[0]
    assert isinstance(entry, CameraEntry)
    imager = entry.imagers["color"]
    scene = Scene(world.mesh, floor_reach_m=30.0)
    view = View(scene, imager.lens.model(), entry.T_base_imager(imager), 0.0)
    motion = Motion(windows[-1])
    every = motion.drive.stamps_ns
    instants = every[np.linspace(0, every.size - 1, _CAST_FRAMES).astype(np.int64)]
    rays = [view.aimed(view.poses(motion, int(at), 0)) for at in instants]

    def whole() -> list[Float32Array]:
        return [view.sight(view.poses(motion, int(at), 0)).depths_m for at in instants]

    bare_s = min(_cpu_s(lambda: [scene.answer(each) for each in rays]) for _ in range(_ROUNDS))
    return min(_cpu_s(whole) for _ in range(_ROUNDS)) / bare_s
