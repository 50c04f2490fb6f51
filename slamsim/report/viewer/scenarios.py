"""The Rerun recording of a scenario: selected trials side by side, over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from slamsim.core.types import FloatArray
from slamsim.report.figures.palette import ACCEPTED, ESTIMATE, NEUTRAL, ODOMETRY, SCAN, TRUTH, rgb
from slamsim.report.viewer.run import written_recording
from slamsim.scenarios.base import BodyMotion, ScenarioResult, Solid, TrialScene

_LOOSE = (ODOMETRY, SCAN, ACCEPTED, TRUTH)
"""Bodies that move without being robots take turns, so that neighbours can be told apart."""
_MOST_SCENES = 9
_FEW = 3
"""So many moving bodies have their paths shown; robots always."""
_LINE, _DOT = 1.5, 4.0
"""Radii on the screen, in its points."""
_EYE = np.array([-0.45, -1.0, 0.55])
"""From where a scene is seen: aside, from behind and above."""
_SINE_OF_VIEW = 0.42
"""Of half the angle that the eye sees in: a ball of that radius in 1 m distance is seen whole."""


def write_scenes(path: Path, result: ScenarioResult) -> None:
    """Write the recording of a scenario that has scenes; raises what write_atomic raises."""
    scenes = result.scenes[:_MOST_SCENES]
    with written_recording(path, f"scenario-{result.name}") as recording:
        recording.send_recording_name(result.title)
        for k, scene in enumerate(scenes):
            _log_scene(recording, f"scene_{k}", scene)
        recording.send_blueprint(_side_by_side(scenes))


def _log_scene(recording: rr.RecordingStream, root: str, scene: TrialScene) -> None:
    colours, movers = cycle(_LOOSE), sum(len(motion.T_map_body) > 1 for motion in scene.motions)
    _log_fixed_boxes(recording, f"{root}/fixed", [m for m in scene.motions if _is_fixed_box(m)])
    for k, motion in enumerate(scene.motions):
        if _is_fixed_box(motion):
            continue
        entity = f"{root}/{rr.escape_entity_path_part(f'{k} {motion.name}')}"
        if len(motion.T_map_body) < 2:
            colour = NEUTRAL
        elif motion.solid.kind == "robot":
            colour = ESTIMATE
        else:
            colour = next(colours)
        if len(motion.T_map_body) > 1 and (motion.solid.kind == "robot" or movers <= _FEW):
            _log_path(recording, f"{root}/path_{k}", motion, colour)
            recording.log(f"{entity}/middle", _dot(motion.solid, colour), static=True)
        recording.log(entity, *_shape(motion.solid, colour), static=True)
        _log_motion(recording, entity, motion)


def _is_fixed_box(motion: BodyMotion) -> bool:
    return motion.solid.kind == "box" and len(motion.T_map_body) == 1


def _log_fixed_boxes(
    recording: rr.RecordingStream, entity: str, boxes: Sequence[BodyMotion]
) -> None:
    """Walls and floors, which may be hundreds, as one."""
    if not boxes:
        return
    shown = rr.Boxes3D(
        centers=[box.T_map_body.positions_m[0] for box in boxes],
        half_sizes=[0.5 * np.array(box.solid.size_m) for box in boxes],
        quaternions=[rr.Quaternion(xyzw=box.T_map_body.quats_xyzw[0]) for box in boxes],
        colors=rgb(NEUTRAL),
        fill_mode=rr.components.FillMode.Solid,
    )
    recording.log(entity, shown, static=True)


def _shape(solid: Solid, colour: str) -> list[rr.AsComponents]:
    fill = rr.components.FillMode.Solid
    if solid.kind == "box":
        half = [0.5 * size for size in solid.size_m]
        return [rr.Boxes3D(half_sizes=[half], colors=rgb(colour), fill_mode=fill)]
    if solid.kind == "sphere":
        radii = [solid.size_m[0]] * 3
        return [rr.Ellipsoids3D(half_sizes=[radii], colors=rgb(colour), fill_mode=fill)]
    radius, height = solid.size_m
    body = rr.Cylinders3D(
        lengths=[height],
        radii=[radius],
        centers=[[0.0, 0.0, 0.5 * height]],
        colors=rgb(colour),
        fill_mode=fill,
    )
    ahead = rr.Arrows3D(
        origins=[[0.0, 0.0, 1.05 * height]],
        vectors=[[1.6 * radius, 0.0, 0.0]],
        radii=0.1 * radius,
        colors=rgb(ODOMETRY),
    )
    return [body, ahead]


def _log_motion(recording: rr.RecordingStream, entity: str, motion: BodyMotion) -> None:
    """Over the time since its first pose; fixed in place for a single one."""
    poses = motion.T_map_body
    if len(poses) == 1:
        place = rr.Transform3D(
            translation=poses.positions_m[0], quaternion=rr.Quaternion(xyzw=poses.quats_xyzw[0])
        )
        recording.log(entity, place, static=True)
        return
    since = (poses.stamps_ns - poses.stamps_ns[0]).astype("timedelta64[ns]")
    recording.send_columns(
        entity,
        [rr.TimeColumn("sim_time", duration=since)],
        rr.Transform3D.columns(translation=poses.positions_m, quaternion=poses.quats_xyzw),
    )


def _log_path(recording: rr.RecordingStream, entity: str, motion: BodyMotion, colour: str) -> None:
    strip = np.add(motion.T_map_body.positions_m, (0.0, 0.0, 0.005))
    width = rr.Radius.ui_points(_LINE)
    recording.log(entity, rr.LineStrips3D([strip], colors=rgb(colour), radii=width), static=True)


def _dot(solid: Solid, colour: str) -> rr.Points3D:
    """Seen from any distance, which a ball of 1 m that falls 500 m is not."""
    height_m = 0.5 * solid.size_m[1] if solid.kind == "robot" else 0.0
    return rr.Points3D([[0.0, 0.0, height_m]], colors=rgb(colour), radii=rr.Radius.ui_points(_DOT))


def _side_by_side(scenes: Sequence[TrialScene]) -> rrb.Blueprint:
    views = [
        rrb.Spatial3DView(
            origin=f"scene_{k}",
            name=scene.title,
            line_grid=rrb.LineGrid3D(visible=True, color=[*rgb(NEUTRAL), 90]),
            background=[250, 250, 250],
            eye_controls=_eye(scene),
        )
        for k, scene in enumerate(scenes)
    ]
    columns = len(views) if len(views) <= 3 else math.ceil(math.sqrt(len(views)))
    return rrb.Blueprint(
        rrb.Grid(*views, grid_columns=columns),
        rrb.TimePanel(timeline="sim_time", state="collapsed", play_state="playing"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _eye(scene: TrialScene) -> rrb.EyeControls3D:
    """Sees all that moves, with the bodies at rest among it."""
    low, high = _extent(scene)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    away = _EYE / np.linalg.norm(_EYE) * radius / _SINE_OF_VIEW
    return rrb.EyeControls3D(
        position=middle + away, look_target=middle, eye_up=(0.0, 0.0, 1.0), tracking_entity=None
    )


def _extent(scene: TrialScene) -> tuple[FloatArray, FloatArray]:
    """(3,) low and high corner of a box around all that moves, or of all if nothing does."""
    moving = [m for m in scene.motions if len(m.T_map_body) > 1] or list(scene.motions)
    reach = [(motion.T_map_body.positions_m, 0.5 * _size(motion.solid)) for motion in moving]
    low = np.min([places.min(axis=0) - size for places, size in reach], axis=0)
    high = np.max([places.max(axis=0) + size for places, size in reach], axis=0)
    return low, high


def _size(solid: Solid) -> float:
    return 2.0 * solid.size_m[0] if solid.kind != "box" else max(solid.size_m)
