"""``slamsim calibrate``: lenses from a board, mounts and clocks of cameras from tags on a drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.console.reporter import Reporter
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.numbers import NoSolution
from slamsim.guard.output import partial_folder
from slamsim.io.cameras import open_pictures
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.perception.calibration.boards import Board, parse_board
from slamsim.perception.calibration.lens import LensFit, fit_lens, fit_pair
from slamsim.perception.calibration.mount import (
    ALL_LENS,
    USUAL_FREE,
    MountFit,
    TooFew,
    best_start,
    fit_mount,
)
from slamsim.perception.calibration.projection import lens_names
from slamsim.perception.calibration.rig import Sighting
from slamsim.perception.calibration.sightings import TagViews
from slamsim.perception.tag_families import TagKind, parse_tags
from slamsim.recording import Recording
from slamsim.recording.frames import BASE_FRAME, base_frame_of, known_mounting, tree_of
from slamsim.run.cameras import calibration_inputs as inputs
from slamsim.run.cameras import calibration_report as report
from slamsim.run.cameras.calibration_files import write_calibration
from slamsim.run.cameras.calibration_report import Calibrated, CameraResult, Quantity
from slamsim.run.naming import log_of

SAME_INSTANT_NS = 1_000_000
"""Cameras of a stereo pair are triggered together, and stamped within a millisecond."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to calibrate by. board, tags: as ``parse_board`` and ``parse_tags`` read them, empty for
    none. distortion: model to fit, empty for the claimed one. readout_s: of the shutter where it
    is known. topics: all by default."""

    board: str = ""
    tags: str = ""
    surveyed: Path | None = None
    trajectory: Path | None = None
    distortion: str = ""
    readout_s: float | None = None
    topics: tuple[str, ...] = ()


def calibrate_cameras(
    source: Path, folder: Path, wanted: Wanted, reporter: Reporter, *, overwrite: bool = False
) -> Calibrated:
    """Calibrate the cameras of a recording or a folder of images, and write what was found.

    The folder gets ``calibration.yaml``, a ROS calibration file of each lens, ``report.json``.
    Raises SlamsimError where neither board nor tags are named, where no camera can be calibrated,
    and as ``open_pictures``; BadNumbers for an unknown model of distortion.
    """
    if not (wanted.board or wanted.tags):
        raise SlamsimError(
            "nothing says what the cameras saw: name a board (--board chessboard:9x6:0.03) or tags "
            "(--tags apriltag_36h11:0.16)"
        )
    board = parse_board(wanted.board) if wanted.board else None
    kind = parse_tags(wanted.tags) if wanted.tags else None
    if wanted.distortion:
        pinhole(2, 2, 60.0, wanted.distortion)
    path = log_of(source)
    with open_pictures(path) as cameras, partial_folder(folder, overwrite) as partial:
        topics = inputs.pictures_of(cameras, wanted.topics)
        work = _Work(cameras, topics, wanted, reporter)
        if board is not None:
            work.by_board(board)
        if kind is not None:
            work.by_tags(kind)
        found = work.result()
        write_calibration(partial, found)
    return found


class _Work:
    """One calibration: lenses first, then mounts with these lenses."""

    def __init__(
        self, cameras: Cameras, topics: Sequence[CameraTopic], wanted: Wanted, reporter: Reporter
    ) -> None:
        self._cameras, self._topics, self._wanted = cameras, topics, wanted
        self._reporter = reporter
        self._results: dict[str, CameraResult] = {}
        self._lenses: dict[str, LensFit] = {}
        self._pairs: list[dict[str, object]] = []
        self._notes: list[str] = []

    def result(self) -> Calibrated:
        """Raises SlamsimError where nothing was found."""
        if not self._results:
            raise SlamsimError(f"{self._cameras.path}: {'; '.join(self._notes)}")
        results = tuple(self._results[name] for name in sorted(self._results))
        return Calibrated(results, tuple(self._pairs), tuple(self._notes))

    def by_board(self, board: Board) -> None:
        """The lens of each camera that saw the board, and where pairs of them are to each other."""
        seen = inputs.boards_seen(self._cameras, self._topics, board, self._reporter)
        for topic in self._topics:
            try:
                self._lens(topic, seen[topic.topic])
            except (TooFew, NoSolution) as error:
                self._notes.append(f"{topic.topic}: {error}")
        for first, second in combinations(sorted(self._lenses), 2):
            if self._claimed_by(first) is None or self._claimed_by(first) != self._claimed_by(
                second
            ):
                self._pair(first, second, seen)

    def _lens(self, topic: CameraTopic, seen: Mapping[int, Sighting]) -> None:
        claim = self._claim(topic)
        claimed_model = "plumb_bob" if claim is None else claim.distortion_model
        size = (topic.width, topic.height)
        with self._reporter.stage("lens"):
            fit = fit_lens(list(seen.values()), size, self._wanted.distortion or claimed_model)
        facts = {
            "board": f"seen in {len(seen)} images, {fit.views[0]} of them different",
            "coverage": f"{fit.coverage[0]:.0%} of the image",
            "residual": f"{fit.residual_px[0]:.3f} px",
        }
        figures = {
            **{"board_images": len(seen), "views": fit.views[0], "coverage": fit.coverage[0]},
            "residual_px": float(fit.residual_px[0]),
        }
        model = fit.models[0]
        if not report.is_lens_told(fit):
            sigma = float(fit.lens_sigmas(0)[0])
            words = f"the focal length is told to {1.96 * sigma:.2g} px only"
            self._notes.append(f"{topic.topic}: {words}; what would tell: {report.TILT_WANTED}")
            untold = Quantity(
                *("fx", float(model.focal_px[0]), sigma, "px", None, None, "inconclusive"),
                report.TILT_WANTED,
            )
            unknown = CameraResult(
                *(topic.topic, topic.frame_id, facts, (untold,)),
                figures=figures,
                lens=fit.misfits[0],
                size=size,
            )
            self._results[topic.topic] = unknown
            return
        told = tuple(report.lens_quantities(model, fit.lens_sigmas(0), claim))
        self._lenses[topic.topic] = fit
        self._results[topic.topic] = CameraResult(
            *(topic.topic, topic.frame_id, facts, told, model),
            figures=figures,
            lens=fit.misfits[0],
            size=size,
        )

    def _claimed_by(self, topic: str) -> str | None:
        """The CameraInfo or file that two images of one imager (raw, rectified) have in common."""
        claim = self._cameras.infos.get(topic)
        return None if claim is None else claim.source

    def _pair(self, first: str, second: str, seen: Mapping[str, Mapping[int, Sighting]]) -> None:
        """Where the second camera is, if both were exposed together."""
        stamps_ns = np.array(sorted(seen[first]), dtype=np.int64)
        sightings = [replace(seen[first][at], view=k) for k, at in enumerate(stamps_ns.tolist())]
        for at, sighting in seen[second].items():
            k = int(np.abs(stamps_ns - at).argmin())
            if abs(int(stamps_ns[k]) - at) <= SAME_INSTANT_NS:
                sightings.append(replace(sighting, view=k, camera=1))
        try:
            with self._reporter.stage("pair"):
                fit = fit_pair(sightings, [self._lenses[first], self._lenses[second]])
        except (TooFew, NoSolution) as error:
            self._notes.append(f"{first} and {second}: {error}")
            return
        T = np.linalg.inv(fit.T_camera_first[1])
        sigmas = fit.place_sigmas(1)
        self._pairs.append(
            {
                **{"first": first, "second": second, "views": fit.views[1]},
                "T_first_second": [[round(v, 7) for v in row] for row in T.tolist()],
                "baseline_m": float(np.linalg.norm(T[:3, 3])),
                "sigma_m": [float(f"{v:.3g}") for v in sigmas[:3]],
                "sigma_deg": [float(f"{v:.3g}") for v in np.degrees(sigmas[3:])],
            }
        )

    def by_tags(self, kind: TagKind) -> None:
        """Mount, clock and shutter of each camera that saw tags."""
        survey = inputs.survey_of(self._wanted.surveyed, kind)
        seen = inputs.tags_of(self._cameras, self._topics, kind, self._reporter)
        path, recording, known_by = inputs.path_of(
            self._cameras, self._wanted.trajectory, self._reporter
        )
        self._notes.append(f"the path of the robot is known by {known_by}")
        for topic in self._topics:
            if topic.topic not in seen:
                self._notes.append(f"{topic.topic}: no tag was seen")
                continue
            views, model = seen[topic.topic]
            drifts = known_by == "odometry"
            views = inputs.by_visits(views) if drifts else views
            try:
                with self._reporter.stage("mount"):
                    self._mount(topic, (views, model), path, recording, survey, drifts=drifts)
            except (TooFew, NoSolution) as error:
                self._notes.append(f"{topic.topic}: {error}")

    def _mount(
        self,
        topic: CameraTopic,
        seen: tuple[TagViews, CameraModel],
        path: PlanarTrajectory,
        recording: Recording | None,
        survey: Mapping[int, tuple[FloatArray, FloatArray]],
        *,
        drifts: bool,
    ) -> None:
        views, model = seen
        before = self._results.get(topic.topic)
        by_board = None if before is None else before.model
        base, claimed = _claimed_mount(recording, topic.frame_id)
        start = best_start(views, model, path, [] if claimed is None else [claimed])
        readout_s = self._wanted.readout_s
        free = USUAL_FREE if readout_s is None else USUAL_FREE - {"readout_s"}
        fitting = partial(
            fit_mount, views, trajectory=path, readout_s=readout_s or 0.0, survey=survey
        )
        fit = fitting(model=by_board or model, T_base_camera=start, free=free)
        if not fit.explains:
            raise NoSolution(
                f"no mount explains where its tags were seen: {fit.doubted} of {fit.sightings} "
                "sightings do not fit; is the path that of this robot, are numbers of tags unique?"
            )
        quantities: list[Quantity] = []
        if before is not None and by_board is not None:
            quantities += before.quantities
        else:
            with_lens = fitting(model=model, T_base_camera=fit.T_base_camera, free=free | ALL_LENS)
            fit, told = _chosen(fit, with_lens, self._claim(topic))
            quantities += told
        fit = inputs.unsure_by_wheels(fit) if drifts else fit
        lacking = report.PATH_WANTED if drifts else report.MOTION_WANTED
        quantities += report.mount_quantities(fit, claimed, readout_s is None, lacking)
        facts = {} if before is None else dict(before.facts)
        facts["tags"] = (
            f"{len(fit.T_map_tag)}, seen {fit.sightings:,} times, {fit.doubted} in doubt"
        )
        facts["residual of corners"] = f"{fit.residual_px:.3f} px"
        figures = {} if before is None else dict(before.figures)
        figures |= {"sightings": fit.sightings, "doubted": fit.doubted, "tags": len(fit.T_map_tag)}
        figures |= {"corner_residual_px": fit.residual_px}
        self._results[topic.topic] = CameraResult(
            *(topic.topic, topic.frame_id, facts, tuple(quantities), fit.model),
            *(fit, base, figures, None if before is None else before.lens),
            size=(topic.width, topic.height),
        )

    def _claim(self, topic: CameraTopic) -> CameraModel | None:
        """None where nothing is claimed; the claim may be wrong, but must be a camera's."""
        try:
            return self._cameras.model(topic.topic)
        except NotFound:
            return None
        except InputRefused as refusal:
            self._notes.append(str(refusal))
            return None


def _chosen(
    held: MountFit, whole: MountFit, claim: CameraModel | None
) -> tuple[MountFit, list[Quantity]]:
    """What tags tell of focal lengths and centre, and the fit to use: with the claimed ones (held)
    where these may be right, for then the mount is told better, else with all of it free (whole),
    which tells nothing where it does not explain the sightings.
    """
    if not whole.explains:
        return held, []
    model = whole.model
    sigmas = np.array([whole.sigma(name) for name in lens_names(model)])
    found = report.lens_quantities(model, sigmas, claim, report.TAGS_WANTED)
    told = list(found)[: len(ALL_LENS)]
    wrong = any(each.verdict == "fault" for each in told)
    return (whole if wrong or claim is None else held), told


def _claimed_mount(recording: Recording | None, frame: str) -> tuple[str, FloatArray | None]:
    """The robot's base frame, and T_base_camera where the transforms tell it."""
    if recording is None:
        return BASE_FRAME, None
    base = base_frame_of(recording)
    known = known_mounting(tree_of(recording.transforms), base, frame)
    return (base, None) if known is None else (known[1], known[0])
