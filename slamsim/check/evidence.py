"""Evidence that questions share, each part computed on first use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from slamsim.check.calibration.distance_unit import WrongUnit, in_metres, wrong_unit
from slamsim.check.calibration.explanation import Explanation, explain
from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.calibration.pictured import plot_of
from slamsim.check.calibration.thinned import Thinned, thinned
from slamsim.check.findings import Finding, Plot
from slamsim.check.motion.inputs import Inputs, gather_inputs
from slamsim.check.motion.laser_steps import laser_motions
from slamsim.recording import Recording
from slamsim.recording.frame_graph import FrameGraph
from slamsim.slam.laser.scan_motion import ScanMotions

Value = TypeVar("Value")


class RecordingEvidence:
    """One recording and what is derived from it.

    A part that fails fails every question that needs it with the same exception object.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._values: dict[str, object] = {}
        self._errors: dict[str, Exception] = {}

    @property
    def frames(self) -> FrameGraph:
        """The transforms as a graph."""
        return self.once("frames", lambda: FrameGraph(self.recording.transforms))

    @property
    def base(self) -> str:
        """The robot's base frame: as named, the first odometry's child, or a usual name."""
        return self.frames.base(self.recording.base_frames)

    @property
    def motions(self) -> ScanMotions | None:
        """Of the lidar with most scans, by its scans alone; None without any lidar."""
        return self.once("motions", lambda: laser_motions(self.recording))

    @property
    def inputs(self) -> Inputs:
        """The streams that the joint calibration compares."""
        return self.once("inputs", lambda: gather_inputs(self.recording, self.motions))

    @property
    def as_recorded(self) -> Calibration | None:
        """All sensors fitted together, lengths as recorded; None of fewer than two of lidar,
        gyroscope and wheels."""
        return self.once("as recorded", lambda: calibrate_inputs(self.inputs))

    @property
    def wrong_unit(self) -> WrongUnit | None:
        """Whose lengths are not metres; None if they are, or nothing can tell."""
        return self.once("wrong unit", self._wrong_unit)

    @property
    def calibration(self) -> Calibration | None:
        """As ``as_recorded``, with all lengths in metres."""
        return self.once("calibration", self._in_metres)

    @property
    def explanation(self) -> Explanation | None:
        """Which sizes of wheels, gyroscope and lidar are wrong; None without ``calibration``."""
        return self.once("explanation", self._explanation)

    @property
    def thinned(self) -> Thinned | None:
        """Which beams of its scans alone were kept; None of all, or without a lidar."""
        return self.once("thinned", self._thinned)

    def plot_of(self, check: str) -> Plot | None:
        """Of a question that rests on a calibration that was made; None of any other."""
        found = self._values.get("calibration")
        return plot_of(check, found) if isinstance(found, Calibration) else None

    @property
    def metres_per_unit(self) -> float:
        """What ranges were multiplied by before scans were matched."""
        return self.motions.metres_per_unit if self.motions else 1.0

    def once(self, name: str, compute: Callable[[], Value]) -> Value:
        """The value of a name, computed once; raises again what computing it raised."""
        if name in self._errors:
            raise self._errors[name]
        if name not in self._values:
            try:
                self._values[name] = compute()
            except Exception as error:
                self._errors[name] = error
                raise
        return self._values[name]  # type: ignore[return-value]

    def _wrong_unit(self) -> WrongUnit | None:
        found = self.as_recorded
        return None if found is None else wrong_unit(self.recording, self.motions, found)

    def _explanation(self) -> Explanation | None:
        found = self.calibration
        return None if found is None else explain(found, self.motions)

    def _thinned(self) -> Thinned | None:
        motions = self.motions
        return None if motions is None else thinned(motions, self.calibration)

    def _in_metres(self) -> Calibration | None:
        found = self.as_recorded
        if found is None:
            return None
        return in_metres(found, self.wrong_unit, self.metres_per_unit)


def of_sizes(
    check: Callable[[Calibration, Explanation], Sequence[Finding]],
) -> Callable[[RecordingEvidence], Sequence[Finding]]:
    """As ``of_calibration``, of a check that also asks which sizes are wrong."""

    def ask(evidence: RecordingEvidence) -> Sequence[Finding]:
        found, explained = evidence.calibration, evidence.explanation
        return [] if found is None or explained is None else check(found, explained)

    return ask


def of_calibration(
    check: Callable[[Calibration], Sequence[Finding]],
) -> Callable[[RecordingEvidence], Sequence[Finding]]:
    """An ``ask`` from a check of the joint calibration; without one there are no findings."""

    def ask(evidence: RecordingEvidence) -> Sequence[Finding]:
        found = evidence.calibration
        return [] if found is None else check(found)

    return ask
