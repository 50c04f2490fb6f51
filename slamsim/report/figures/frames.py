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
_LETTER_INCHES = 0.08
_NARROWEST_INCHES = 0.15
"""A level of a tree that is to have a certain width is not narrower."""


def write_frames(path: Path, frames: Sequence[FramePlace], picture_format: str = "svg") -> None:
    """One row for each frame, right of its parent; what moves is drawn dashed.

    picture_format: ``svg`` or ``png``.
    """
    with rc_context({"svg.hashsalt": "frames", "svg.fonttype": "none"}):
        metadata = {"Date": None} if picture_format == "svg" else {}
        figure = frames_figure(frames)
        figure.savefig(path, format=picture_format, metadata=metadata, facecolor="white", dpi=120)


def frames_figure(
    frames: Sequence[FramePlace],
    ink: str = INK,
    marked: Collection[str] = (),
    width_in: float | None = None,
) -> Figure:
    """The drawing of ``write_frames``. marked: frames in bold, on lines of another colour.
    width_in: of the drawing, as far as its letters allow; None for levels far apart."""
    depth = max((frame.depth for frame in frames), default=0)
    about = max((len(frame.about) for frame in frames), default=0)
    column, width = _COLUMN_INCHES, _COLUMN_INCHES * (depth + 1) + 0.07 * about
    if width_in is not None:
        letters = max((len(_told(frame)) for frame in frames), default=0)
        room = width_in - _LETTER_INCHES * letters
        column = min(max(room / (depth + 1), _NARROWEST_INCHES), 0.4)
        width = max(width_in, column * (depth + 1) + _LETTER_INCHES * letters)
    width = min(width, _MOST_INCHES)
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
            colour = NEUTRAL if frame.is_fixed else ESTIMATE
            colour = WITHDRAWN if frame.name in marked else colour
            axes.plot(x, y, color=colour, linestyle=style, linewidth=1.2)
        weight = "bold" if frame.name in marked else "normal"
        axes.text(
            frame.depth, row, _told(frame), va="center", color=ink, fontsize=10, weight=weight
        )
    if not frames:
        axes.text(0.0, 0.5, "no transforms", va="center", color=ink)
    axes.set_xlim(-0.1, width / column)
    axes.set_ylim(max(len(frames), 1) - 0.5, -0.5)
    return figure


def _told(frame: FramePlace) -> str:
    return f"{frame.name}   {frame.about}".rstrip()
