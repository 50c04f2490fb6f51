"""Draws the transform tree of a recording."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from slamsim.recording.frame_graph import FramePlace
from slamsim.report.figures.palette import ESTIMATE, INK, NEUTRAL, WITHDRAWN

_ROW_INCHES, _COLUMN_INCHES, _MOST_INCHES = 0.42, 2.1, 100.0
"""Of a frame, of a level of the tree, and the most that an image may be."""


def write_frames(path: Path, frames: Sequence[FramePlace], picture_format: str = "svg") -> None:
    """One row for each frame, right of its parent; what moves is drawn dashed.

    picture_format: ``svg`` or ``png``.
    """
    with rc_context({"svg.hashsalt": "frames", "svg.fonttype": "none"}):
        metadata = {"Date": None} if picture_format == "svg" else {}
        figure = frames_figure(frames)
        figure.savefig(path, format=picture_format, metadata=metadata, facecolor="white", dpi=120)


def frames_figure(
    frames: Sequence[FramePlace], ink: str = INK, marked: Collection[str] = ()
) -> Figure:
    """The drawing of ``write_frames``. marked: frames in another colour."""
    depth = max((frame.depth for frame in frames), default=0)
    about = max((len(frame.about) for frame in frames), default=0)
    width = min(_COLUMN_INCHES * (depth + 1) + 0.07 * about, _MOST_INCHES)
    height = min(_ROW_INCHES * max(len(frames), 2), _MOST_INCHES)
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    axes.axis("off")
    rows = {frame.name: row for row, frame in enumerate(frames)}
    for row, frame in enumerate(frames):
        if frame.parent:
            style = "solid" if frame.is_fixed else "dashed"
            corner = frame.depth - 0.9
            x, y = [corner, corner, frame.depth - 0.05], [rows[frame.parent] + 0.3, row, row]
            axes.plot(x, y, color=NEUTRAL, linestyle=style, linewidth=1.2)
        colour = WITHDRAWN if frame.name in marked else ink if frame.is_fixed else ESTIMATE
        told = f"{frame.name}   {frame.about}".rstrip()
        axes.text(frame.depth, row, told, va="center", color=colour, fontsize=10)
    if not frames:
        axes.text(0.0, 0.5, "no transforms", va="center", color=ink)
    axes.set_xlim(-0.1, width / _COLUMN_INCHES)
    axes.set_ylim(max(len(frames), 1) - 0.5, -0.5)
    return figure
