"""``slamsim map --obstacles --labels TOPIC``: layers of the map from images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.cameras.frames import EncodedFrame
from slamsim.cameras.lens import CameraModel
from slamsim.config.slam import LayersConfig, MappingConfig
from slamsim.core.geometry import se3_from_se2, wrap_angle
from slamsim.core.layers import MapLayers, ObstacleLayer, SemanticLayer, label_colours
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray, Grid, Log, PlanarTrajectory
from slamsim.evaluate.obstacles import score_obstacles
from slamsim.guard.output import write_atomic
from slamsim.io.cameras import open_cameras
from slamsim.perception.calibrated import CalibratedCameras, CameraClock
from slamsim.perception.layers.labels import (
    LabelTopic,
    LabelVotes,
    label_topic,
    labelled,
    true_clock,
)
from slamsim.perception.layers.obstacles import ObstacleGrid
from slamsim.perception.recorded import UsedCamera, mount_of
from slamsim.recording import Recording
from slamsim.report.run_view import RunView
from slamsim.run.cameras.floor import floor_of
from slamsim.run.stages import Stages
from slamsim.slam.backend.correction import densify
from slamsim.slam.failures import Failures
from slamsim.slam.mapping.map_files import map_files
from slamsim.slam.session import motion_of
from slamsim.world.looks.finishes import MATERIALS
from slamsim.world.model import World

OBSTACLES, SEMANTIC = "obstacles", "semantic"


@dataclass(frozen=True, slots=True, eq=False)
class LayerSources:
    """The topics that layers are made of, and their cameras, on a robot whose base is on the floor.

    None for a layer that was not asked for. told: what is not known of them.
    """

    path: Path
    depth: tuple[str, UsedCamera] | None = None
    labels: tuple[LabelTopic, UsedCamera] | None = None
    told: tuple[str, ...] = ()


def layer_sources(
    path: Path, recording: Recording, config: LayersConfig, calibrated: CalibratedCameras
) -> LayerSources:
    """What a configuration asks for, looked up before anything is mapped.

    Raises InputRefused for a recording without depth images, or with a camera whose place on the
    robot is unknown, NotFound without CameraInfo, and what ``label_topic`` raises.
    """
    depth = labels = None
    if not (config.obstacles or config.labels):
        return LayerSources(path)
    floor_m, told = floor_of(recording, config)

    def camera(topic: str, frame: str, model: CameraModel, clock: CameraClock | None) -> UsedCamera:
        known = calibrated.of(topic, frame)
        T_base_camera = mount_of(path, topic, frame, recording, known).copy()
        T_base_camera[2, 3] -= floor_m
        return UsedCamera(known.model or model, T_base_camera, clock or known.clock)

    if config.obstacles:
        with open_cameras(path) as cameras:
            depths = cameras.of_kind("depth")
            if not depths:
                raise cameras.refused("holds no depth images in which obstacles could be seen")
            # what is aligned to the pixels of another imager has a part of them alone
            first = min(depths, key=lambda each: ("aligned" in each.topic, -each.messages))
            depth = (
                first.topic,
                camera(first.topic, first.frame_id, cameras.model(first.topic), None),
            )
    if config.labels:
        with open_cameras(path, "with") as cameras:
            topic = label_topic(path, config.labels, cameras)
            clock = true_clock(path, topic.topic)
            labels = topic, camera(topic.topic, topic.frame_id, cameras.model(topic.depth), clock)
    return LayerSources(path, depth, labels, told)


def map_layers(
    sources: LayerSources,
    log: Log,
    result: SlamResult,
    grid: Grid,
    config: MappingConfig,
    stages: Stages,
    failures: Failures,
) -> MapLayers:
    """grid: the map of the result, which gives the cells. A layer that cannot be made is left out,
    and told by failures."""
    motion, last = motion_of(log, result.calibration), len(result.graph.keyframes) - 1
    fine = result.trajectory if motion is None else densify(result.trajectory, motion)
    obstacles = semantic = None
    with failures.caught(OBSTACLES, last):
        obstacles = _obstacles(sources, fine, grid, config, stages)
    with failures.caught(SEMANTIC, last):
        semantic = _semantic(sources, fine, grid, config, stages)
    return MapLayers(obstacles, semantic)


def write_layers(folder: Path, layers: MapLayers, world: World | None) -> None:
    """``obstacles.pgm``, ``.yaml``, ``.png`` as ROS map_server reads them; ``semantic.png`` with
    its legend ``semantic.yaml``. world: where it is known."""
    if layers.obstacles is not None:
        for name, data in map_files(layers.obstacles.grid).items():
            text = data.replace(b"map.pgm", b"obstacles.pgm") if name.endswith("yaml") else data
            write_atomic(folder / name.replace("map.", f"{OBSTACLES}."), text)
    if layers.semantic is not None:
        rgb = label_colours(layers.semantic.labels)
        write_atomic(folder / f"{SEMANTIC}.png", encode_png(np.ascontiguousarray(rgb[::-1])))
        names = label_names(layers.semantic.topic, world)
        legend = yaml.safe_dump(_legend(layers.semantic, names), sort_keys=False)
        write_atomic(folder / f"{SEMANTIC}.yaml", legend.encode())


def label_names(topic: str, world: World | None) -> Mapping[int, str]:
    """What the labels of a simulated camera mean; nothing for others."""
    if not topic.startswith("/ground_truth/") or world is None:
        return {}
    if topic.endswith("/materials"):
        return {number: each.name for number, each in enumerate(MATERIALS)}
    return dict(enumerate(world.parts.kinds)) if topic.endswith("/instances") else {}


def with_layers(
    view: RunView,
    layers: MapLayers,
    world: World | None,
    config: LayersConfig,
) -> RunView:
    """The run with its layers, and how true its obstacles are where the world is known."""
    scores, errors, plane = None, view.scores.trajectory, view.truth_grid
    names = {} if layers.semantic is None else label_names(layers.semantic.topic, world)
    if not (layers.obstacles is None or world is None or errors is None or plane is None):
        body = world.obstacle_grid(plane.resolution_m, config.lowest_m, config.highest_m)
        scores = score_obstacles(layers.obstacles, view.grid, body, plane, errors.T_truth_estimate)
    return replace(view, layers=layers, obstacles=scores, label_names=names)


def _obstacles(
    sources: LayerSources,
    fine: PlanarTrajectory,
    grid: Grid,
    config: MappingConfig,
    stages: Stages,
) -> ObstacleLayer | None:
    if sources.depth is None:
        return None
    topic, camera = sources.depth
    found = ObstacleGrid(grid, config)
    with open_cameras(sources.path) as cameras, stages.stage(OBSTACLES, "images/s") as progress:
        total = cameras.topics[topic].messages
        frames = _used(((each,) for each in cameras.encoded({topic})), camera, fine, config)
        for (frame,), T_map_camera in frames:
            middle = T_map_camera[len(T_map_camera) // 2]
            found.draw(frame.decoded().pixels, camera.model.K, middle)
            progress(frame.number + 1, total)
    return found.layer()


def _semantic(
    sources: LayerSources,
    fine: PlanarTrajectory,
    grid: Grid,
    config: MappingConfig,
    stages: Stages,
) -> SemanticLayer | None:
    if sources.labels is None:
        return None
    topic, camera = sources.labels
    votes = LabelVotes(grid, config.layers.max_depth_m, config.layers.highest_m)
    with stages.stage(SEMANTIC, "images/s") as progress:
        for (seen, depth), T_map_camera in _used(
            labelled(sources.path, topic), camera, fine, config
        ):
            depth_m, rows = depth.decoded().pixels, T_map_camera
            votes.draw(
                seen.stored()[1], depth_m, camera.model.K, rows if len(rows) > 1 else rows[0]
            )
            progress(seen.number + 1, topic.images)
    return votes.layer(topic.topic)


def _used(
    images: Iterable[tuple[EncodedFrame, ...]],
    camera: UsedCamera,
    fine: PlanarTrajectory,
    config: MappingConfig,
) -> Iterator[tuple[tuple[EncodedFrame, ...], FloatArray]]:
    """Images during the mapped drive at which the robot had moved as much as for scans, and
    ``T_map_camera`` (rows, 4, 4) when each row of the first was exposed; (1, 4, 4) of a global
    shutter."""
    last = None
    for image in images:
        rows_ns = camera.clock.of_rows(image[0].stamp_ns, camera.model.height)
        if fine.stamps_ns[0] <= rows_ns.min() and rows_ns.max() <= fine.stamps_ns[-1]:
            poses = fine.at(rows_ns)
            if last is None or _moved(last, poses[len(poses) // 2], config) >= 1.0:
                last = poses[len(poses) // 2]
                yield image, se3_from_se2(poses) @ camera.T_base_camera


def _moved(last: FloatArray, pose: FloatArray, config: MappingConfig) -> float:
    """How far, in units of what makes another image worth using; without such units always."""
    far = np.hypot(*(pose[:2] - last[:2])) / max(config.min_travel_m, 1e-9)
    turned = abs(wrap_angle(pose[2] - last[2])) / max(np.radians(config.min_turn_deg), 1e-9)
    return 1.0 if config.min_travel_m == config.min_turn_deg == 0.0 else float(far + turned)


def _legend(layer: SemanticLayer, names: Mapping[int, str]) -> dict[str, object]:
    """resolution and origin as in map.yaml; of each label its colour, cells and name."""
    labels, counts = np.unique(layer.labels[layer.labels >= 0], return_counts=True)
    told = [
        {
            "label": int(label),
            **({"name": names[int(label)]} if int(label) in names else {}),
            "rgb": label_colours(np.array([label]))[0].tolist(),
            "cells": int(count),
        }
        for label, count in zip(labels, counts, strict=True)
    ]
    x_m, y_m = (float(value) for value in layer.grid.origin_m)
    return {
        "image": f"{SEMANTIC}.png",
        "resolution": float(layer.grid.resolution_m),
        "origin": [x_m, y_m, 0.0],
        "topic": layer.topic,
        "images": layer.images,
        "labels": told,
    }
