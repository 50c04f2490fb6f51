"""Edits of what scans declare: directions and times of their beams, limits of their ranges."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.core.types import IntArray
from slamsim.recording import RawScans, ScanLayout
from slamsim.recording.edits.base import MessagesEdit, reciprocal
from slamsim.recording.edits.ranges import map_ranges

Pivot = Literal["middle", "first", "last"]
"""The beam that keeps its direction."""
Axis = Literal["zero", "middle"]
"""The direction that a mirror leaves as it is: 0, or that of the middle beam."""

_FULL_TURN = 2.0 * np.pi
"""Radians."""


@dataclass(frozen=True, slots=True)
class LayoutEdit(MessagesEdit):
    """An edit of what scans declare of their beams."""

    @abstractmethod
    def layout(self, layout: ScanLayout, beams: int, /) -> ScanLayout:
        """The declaration in the place of one; beams: how many it is of."""

    def changed(self, scans: RawScans) -> RawScans:
        beams = beam_counts(scans).tolist()
        counts = dict(zip(scans.layout_of.tolist(), beams, strict=True))
        layouts = (self.layout(one, counts.get(i, 0)) for i, one in enumerate(scans.layouts))
        return replace(scans, layouts=tuple(layouts))


@dataclass(frozen=True, slots=True)
class ChangeLayouts(LayoutEdit):
    """What scans declare, changed in a way that no other edit describes."""

    change: Callable[[ScanLayout], ScanLayout]

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        return self.change(layout)


@dataclass(frozen=True, slots=True)
class ScaleAngles(LayoutEdit):
    """The declared angle between beams times ``factor``, about one beam.

    by_beams: the last beam, and so the middle one, is where their number says, whatever angle is
    declared for it.
    """

    factor: float
    by_beams: bool = False
    pivot: Pivot = "middle"

    def inverse(self) -> ScaleAngles:
        return replace(self, factor=reciprocal(self.factor))

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        ends = with_last_angle(layout, beams) if self.by_beams else layout
        first, last = ends.angle_min_rad, ends.angle_max_rad
        kept = {"first": first, "last": last, "middle": 0.5 * (first + last)}[self.pivot]
        return replace(
            layout,
            angle_min_rad=kept + (first - kept) * self.factor,
            angle_max_rad=kept + (last - kept) * self.factor,
            angle_step_rad=layout.angle_step_rad * self.factor,
        )


@dataclass(frozen=True, slots=True)
class ConvertAngles(LayoutEdit):
    """Declared angles, whatever they are called, from radians to degrees or back.

    ends: those of the first and the last beam as well as the step between beams; None: as far as
    they are larger than a turn, which no angle in radians is.
    """

    to: Literal["degrees", "radians"]
    ends: bool | None = True

    def inverse(self) -> ConvertAngles:
        return replace(self, to="radians" if self.to == "degrees" else "degrees")

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        convert = np.degrees if self.to == "degrees" else np.radians

        def end(angle: float) -> float:
            is_converted = abs(angle) > _FULL_TURN if self.ends is None else self.ends
            return float(convert(angle)) if is_converted else angle

        return replace(
            layout,
            angle_min_rad=end(layout.angle_min_rad),
            angle_max_rad=end(layout.angle_max_rad),
            angle_step_rad=float(convert(layout.angle_step_rad)),
        )


@dataclass(frozen=True, slots=True)
class MirrorAngles(LayoutEdit):
    """What was declared to the left is declared to the right; its own inverse."""

    about: Axis = "zero"

    def inverse(self) -> MirrorAngles:
        return self

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        last = with_last_angle(layout, beams).angle_max_rad
        twice = layout.angle_min_rad + last if self.about == "middle" else 0.0
        return replace(
            layout,
            angle_min_rad=twice - layout.angle_min_rad,
            angle_max_rad=twice - layout.angle_max_rad,
            angle_step_rad=-layout.angle_step_rad,
        )


@dataclass(frozen=True, slots=True)
class ExtendAngleMax(LayoutEdit):
    """The declared angle of the last beam moved by so many steps between beams."""

    beams: int

    def inverse(self) -> ExtendAngleMax:
        return replace(self, beams=-self.beams)

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        end = layout.angle_max_rad + self.beams * layout.angle_step_rad
        return replace(layout, angle_max_rad=end)


@dataclass(frozen=True, slots=True)
class CloseAngles(LayoutEdit):
    """The last angle that follows from the first, the step and the number of beams."""

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        return with_last_angle(layout, beams)


@dataclass(frozen=True, slots=True)
class ScaleBeamTimes(LayoutEdit):
    """The declared time between beams times ``factor``."""

    factor: float

    def inverse(self) -> ScaleBeamTimes:
        return replace(self, factor=reciprocal(self.factor))

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        return replace(layout, beam_dt_s=layout.beam_dt_s * self.factor)


@dataclass(frozen=True, slots=True)
class SetSweep(LayoutEdit):
    """``sweep_s`` seconds declared from the first beam to the last."""

    sweep_s: float

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        return replace(layout, beam_dt_s=self.sweep_s / max(beams - 1, 1))


@dataclass(frozen=True, slots=True)
class SetScanTime(LayoutEdit):
    """``seconds`` declared from one scan to the next."""

    seconds: float

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        return replace(layout, scan_time_s=self.seconds)


@dataclass(frozen=True, slots=True)
class ReverseBeams(LayoutEdit):
    """Beams written in the opposite order, each with its direction; its own inverse.

    The message then says that the last beam fired first: ROS has no negative times.
    """

    def changed(self, scans: RawScans) -> RawScans:
        bright = scans.intensities
        if isinstance(bright, np.ndarray):
            bright = bright[:, ::-1]
        found = map_ranges(scans, lambda ranges_m: ranges_m[:, ::-1])
        return LayoutEdit.changed(self, replace(found, intensities=bright))

    def inverse(self) -> ReverseBeams:
        return self

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        last = with_last_angle(layout, beams).angle_max_rad
        found = replace(layout, angle_min_rad=last, angle_step_rad=-layout.angle_step_rad)
        return with_last_angle(found, beams)


@dataclass(frozen=True, slots=True)
class SetRangeLimits(LayoutEdit):
    """Other declared limits of the ranges, in metres; None leaves one as it is."""

    range_min_m: float | None = None
    range_max_m: float | None = None

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        low_m, high_m = self.range_min_m, self.range_max_m
        return replace(
            layout,
            range_min_m=layout.range_min_m if low_m is None else low_m,
            range_max_m=layout.range_max_m if high_m is None else high_m,
        )


@dataclass(frozen=True, slots=True)
class ScaleRangeLimits(LayoutEdit):
    """The declared limits of the ranges times ``factor``."""

    factor: float

    def inverse(self) -> ScaleRangeLimits:
        return replace(self, factor=reciprocal(self.factor))

    def layout(self, layout: ScanLayout, beams: int) -> ScanLayout:
        low_m, high_m = layout.range_min_m * self.factor, layout.range_max_m * self.factor
        return replace(layout, range_min_m=low_m, range_max_m=high_m)


def with_last_angle(layout: ScanLayout, beams: int) -> ScanLayout:
    """With the angle of the last of so many beams that the first and the step give."""
    last = layout.angle_min_rad + max(beams - 1, 0) * layout.angle_step_rad
    return replace(layout, angle_max_rad=last)


def beam_counts(scans: RawScans) -> IntArray:
    """(n,) number of beams of each scan."""
    if isinstance(scans.ranges_m, np.ndarray):
        return np.full(len(scans), scans.ranges_m.shape[1])
    return np.array([row.size for row in scans.ranges_m], dtype=np.int64)


def scan_durations_ns(scans: RawScans, *, either_way: bool = False) -> IntArray:
    """(n,) from the first beam to the last as declared; 0 for a declaration that is no number, and
    for beams that fire the last one first, unless either_way."""
    declared_s = np.array([layout.beam_dt_s for layout in scans.layouts])[scans.layout_of]
    declared_s = np.abs(declared_s) if either_way else declared_s
    lasts_ns = declared_s * np.maximum(beam_counts(scans) - 1, 0) * 1e9
    lasts_ns = np.nan_to_num(lasts_ns, posinf=0.0, neginf=0.0)
    return np.asarray(np.clip(lasts_ns, 0.0, 1e12), dtype=np.int64)
