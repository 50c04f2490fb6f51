"""Static parts of a recording: map, true walls, paths and the pose graph."""

from __future__ import annotations

import numpy as np
import rerun as rr
from matplotlib import colormaps
from numpy.typing import NDArray

from slamsim.core.geometry import compose, inverse
from slamsim.core.layers import label_colours
from slamsim.core.result import GraphEdge
from slamsim.core.types import BoolArray, FloatArray, Grid
from slamsim.evaluate.grid import cell_centres, occupied
from slamsim.report.figures.palette import (
    ACCEPTED,
    ESTIMATE,
    NEUTRAL,
    ODOMETRY,
    TRUTH,
    WITHDRAWN,
    rgb,
)
from slamsim.report.precision import COLOURS, ellipses, held, path_and_strokes, scale_of
from slamsim.report.run_view import RunView, outline_height_m, thinned, wall_outline
from slamsim.report.viewer.stage import MAP
from slamsim.report.viewer.stage import TRUTH as TRUTH_FRAME

MAX_PATH_POINTS = 20_000
MAX_EDGES = 20_000
MAX_STROKES = 800
BELIEVED_FROM = 0.5
"""A closure of less weight than this was withdrawn by the robust estimator."""


def log_map(recording: rr.RecordingStream, entity: str, grid: Grid) -> None:
    """An occupancy grid in the map frame; nothing for one without cells."""
    rows, columns = grid.occupancy.shape
    if rows == 0 or columns == 0:
        return
    x_m, y_m = grid.origin_m
    recording.log(
        entity,
        rr.CoordinateFrame(MAP),
        rr.GridMap(
            data=occupancy_bytes(grid),
            format=rr.components.ImageFormat(
                width=columns, height=rows, color_model="L", channel_datatype="U8"
            ),
            cell_size=grid.resolution_m,
            translation=[x_m, y_m, 0.0],
            colormap=rr.components.Colormap.RvizMap,
        ),
        static=True,
    )


SEMANTIC = "layers/semantic"
"""Hidden until it is asked for: it covers the map."""


def log_layers(recording: rr.RecordingStream, view: RunView) -> None:
    """What images add to the map: obstacles as points, labels as points of their colours."""
    layers = view.layers
    if layers.obstacles is not None:
        grid = layers.obstacles.grid
        _log_cells(recording, "layers/obstacles", grid, occupied(grid), rgb(WITHDRAWN), 0.04)
    if layers.semantic is not None:
        seen = layers.semantic.labels >= 0
        colours = label_colours(layers.semantic.labels[seen])
        _log_cells(recording, SEMANTIC, layers.semantic.grid, seen, colours, 0.02)


def _log_cells(
    recording: rr.RecordingStream,
    entity: str,
    grid: Grid,
    cells: BoolArray,
    colours: tuple[int, int, int] | NDArray[np.uint8],
    height_m: float,
) -> None:
    centres = cell_centres(grid, cells)
    if len(centres):
        places = np.column_stack([centres, np.full(len(centres), height_m)])
        points = rr.Points3D(places, colors=colours, radii=0.5 * grid.resolution_m)
        recording.log(entity, rr.CoordinateFrame(MAP), points, static=True)


def occupancy_bytes(grid: Grid) -> bytes:
    """ROS' cell values (0 free, 100 occupied, 255 unknown), top row first as in an image."""
    known = np.isfinite(grid.occupancy)
    per_cent = np.where(known, np.clip(grid.occupancy, 0.0, 1.0) * 100.0, 255.0)
    return per_cent.round().astype(np.uint8)[::-1].tobytes()


def log_walls(recording: rr.RecordingStream, view: RunView) -> None:
    """The true walls: as a mesh for the view in space, and as their outline for the map."""
    if view.walls is None:
        return
    corners = view.walls.vertices_m[view.walls.triangles]
    recording.log(
        "truth/walls",
        rr.CoordinateFrame(TRUTH_FRAME),
        rr.Mesh3D(
            vertex_positions=corners.reshape(-1, 3),
            vertex_normals=np.repeat(face_normals(corners), 3, axis=0),
            albedo_factor=(*rgb(NEUTRAL), 255),
        ),
        static=True,
    )
    outline = wall_outline(view.walls, outline_height_m(view))
    if len(outline):
        log_lines(recording, "truth/outline", TRUTH_FRAME, outline, TRUTH, 0.015, 0.02)


def face_normals(corners: FloatArray) -> FloatArray:
    """(t, 3) unit normals of triangles (t, 3, 3), zero for one without an area.

    One normal for each face and not for each vertex, so that edges of walls look sharp.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(size > 0.0, size, 1.0)
    return np.asarray(normals)


def log_paths(recording: rr.RecordingStream, view: RunView) -> None:
    """Estimate, odometry and truth; the odometry begins where the estimate does."""
    trajectory, odometry = view.result.trajectory, view.result.odometry
    if len(trajectory) < 2:
        return
    T_map_odom = compose(trajectory.poses[0], inverse(odometry.poses[0]))
    odometry_path = compose(T_map_odom, odometry.poses)
    for name, points, colour, height_m in (
        ("paths/odometry", odometry_path, ODOMETRY, 0.03),
        ("paths/estimate", trajectory.poses, ESTIMATE, 0.06),
    )[: 2 if view.mapped else 1]:
        log_lines(recording, name, MAP, [_path(points)], colour, 0.025, height_m)
    if view.truth is not None and len(view.truth) > 1:
        true_path = _path(view.truth.planar().poses)
        log_lines(recording, "paths/truth", TRUTH_FRAME, [true_path], TRUTH, 0.025, 0.05)


CLOSURES = ("graph/closures", "graph/withdrawn")
"""Hidden until they are asked for: hundreds of them cover a map."""
_HAIRLINE = -0.5
"""Half a point on the screen, however near the eye is: Rerun takes negative radii so."""


def log_graph(recording: rr.RecordingStream, view: RunView) -> None:
    """Key frames, their successive edges, and the closures: believed and withdrawn."""
    graph = view.result.graph
    points = graph.keyframes.poses[:, :2]
    if len(points) == 0:
        return
    recording.log(
        "graph/keyframes",
        rr.CoordinateFrame(MAP),
        rr.Points3D(np.column_stack([points, np.full(len(points), 0.07)]), radii=0.04),
        static=True,
    )
    chain = [edge for edge in graph.edges if edge.kind in ("odometry", "match")]
    accepted, withdrawn = closures(graph.edges)
    for name, edges, colour, radius, height_m in (
        ("graph/edges", chain, NEUTRAL, 0.015, 0.03),
        (CLOSURES[0], accepted, ACCEPTED, _HAIRLINE, 0.08),
        (CLOSURES[1], withdrawn, WITHDRAWN, _HAIRLINE, 0.09),
    ):
        shown = [edges[k] for k in thinned(len(edges), MAX_EDGES)]
        lines = [points[[edge.source, edge.target]] for edge in shown]
        if lines:
            log_lines(recording, name, MAP, lines, colour, radius, height_m)


def log_tags(recording: rr.RecordingStream, view: RunView) -> None:
    """Tags in the map: where they are, and the way they face."""
    tags = view.result.landmarks
    if not tags:
        return
    places = np.array([[*tag.T_map_tag[:2], 0.3] for tag in tags])
    yaw_rad = np.array([tag.T_map_tag[2] for tag in tags])
    facing = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(len(tags))])
    recording.log(
        "graph/tags",
        rr.CoordinateFrame(MAP),
        rr.Arrows3D(
            origins=places, vectors=0.4 * facing, labels=[f"tag {tag.number}" for tag in tags]
        ),
        static=True,
    )


def log_precision(recording: rr.RecordingStream, view: RunView) -> None:
    """What holds the robot: strokes along the direction that each scan holds least, coloured by
    how little; and the uncertainties of the key frames as enlarged ellipses."""
    found = held(view)
    if found is not None and len(view.result.trajectory) > 1:
        _, strokes = path_and_strokes(view, found, np.zeros(3))
        pick = thinned(len(strokes), MAX_STROKES)
        shades = colormaps[COLOURS](scale_of(found)(1e3 * found.worst_m[pick]), bytes=True)
        lines = [np.column_stack([stroke, np.full(2, 0.05)]) for stroke in strokes[pick]]
        recording.log(
            "precision/held",
            rr.CoordinateFrame(MAP),
            rr.LineStrips3D(lines, colors=shades, radii=0.02),
            static=True,
        )
    enlarged, outlines = ellipses(view)
    if len(outlines):
        entity = f"precision/ellipses_2_sigma_x{enlarged}"
        log_lines(recording, entity, MAP, outlines, ESTIMATE, 0.012, 0.08)


def closures(edges: tuple[GraphEdge, ...]) -> tuple[list[GraphEdge], list[GraphEdge]]:
    """The loop closures that are believed, and those that were withdrawn."""
    found = [edge for edge in edges if edge.kind == "closure"]
    believed = [edge for edge in found if edge.weight >= BELIEVED_FROM]
    return believed, [edge for edge in found if edge.weight < BELIEVED_FROM]


def _path(poses: FloatArray) -> FloatArray:
    return np.asarray(poses[thinned(len(poses), MAX_PATH_POINTS), :2])


def log_lines(
    recording: rr.RecordingStream,
    entity: str,
    frame: str,
    strips: list[FloatArray] | FloatArray,
    colour: str,
    radius_m: float,
    height_m: float,
) -> None:
    """Line strips (n, 2) in metres, so high above the floor of a frame."""
    in_space = [np.column_stack([strip, np.full(len(strip), height_m)]) for strip in strips]
    recording.log(
        entity,
        rr.CoordinateFrame(frame),
        rr.LineStrips3D(in_space, colors=rgb(colour), radii=radius_m),
        static=True,
    )
