"""The Rerun recording of a run, written after the run from its data.

A recording is a picture, never the data: it is thinned to some tens of megabytes however long
the run was. It is made in memory and written at once, because Rerun's own file sink waits for
ever on a full disk.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import rerun as rr

from slamsim.cameras.frames import EncodedFrame
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.output import write_atomic
from slamsim.report.figures.palette import rgb
from slamsim.report.precision import precision_plots
from slamsim.report.run_view import RunView
from slamsim.report.viewer.blueprint import blueprint
from slamsim.report.viewer.images import (
    ShownCamera,
    camera_views,
    log_boxes,
    log_cameras,
    log_images,
)
from slamsim.report.viewer.scene import (
    log_graph,
    log_layers,
    log_map,
    log_paths,
    log_precision,
    log_tags,
    log_walls,
)
from slamsim.report.viewer.series import MAX_POINTS, plots
from slamsim.report.viewer.stage import laser_frame, log_scans, log_transforms, time_column

APPLICATION = "slamsim"


@contextmanager
def written_recording(path: Path, recording_id: str) -> Iterator[rr.RecordingStream]:
    """A recording that is written when the block ends well; raises what write_atomic raises."""
    recording = rr.RecordingStream(APPLICATION, recording_id=recording_id)
    memory = recording.memory_recording()
    strict_before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield recording
    finally:
        rr.set_strict_mode(strict_before)
    write_atomic(path, memory.drain_as_bytes())


def write_recording(
    path: Path,
    view: RunView,
    images: Iterable[EncodedFrame] = (),
    cameras: Sequence[ShownCamera] = (),
    boxes: Mapping[str, Iterable[tuple[int, IntArray, FloatArray]]] | None = None,
) -> None:
    """Write ``run.rrd``; what was under this name stays if anything fails.

    images: of cameras, of which those in ``cameras`` are drawn where they are. boxes: as
    ``log_boxes`` takes them, by topics of images. Raises what write_atomic raises.
    """
    with written_recording(path, _identity(view)) as recording:
        recording.send_recording_name(view.log.name)
        laser = laser_frame(view)
        log_transforms(recording, view, laser)
        log_map(recording, "map", view.grid)
        log_layers(recording, view)
        log_walls(recording, view)
        log_paths(recording, view)
        log_graph(recording, view)
        log_tags(recording, view)
        log_precision(recording, view)
        log_scans(recording, view, laser)
        _log_plots(recording, view)
        log_cameras(recording, cameras)
        pictures = camera_views(log_images(recording, view, images))
        for topic, things in (boxes or {}).items():
            log_boxes(recording, view, topic, things)
        recording.send_blueprint(blueprint(view, pictures))


def _identity(view: RunView) -> str:
    """The same for the same run, so that opening it twice does not show it twice."""
    poses = view.result.trajectory.poses.tobytes()
    return f"{view.log.name}-{zlib.crc32(poses):08x}"


def _log_plots(recording: rr.RecordingStream, view: RunView) -> None:
    for plot in (*plots(view), *precision_plots(view, MAX_POINTS)):
        for curve in plot.curves:
            entity = f"plots/{plot.key}/{curve.name.replace(' ', '_')}"
            style = rr.SeriesLines(colors=rgb(curve.colour), names=curve.name)
            recording.log(entity, style, static=True)
            recording.send_columns(
                entity,
                [time_column(view, curve.stamps_ns)],
                rr.Scalars.columns(scalars=curve.values),
            )
