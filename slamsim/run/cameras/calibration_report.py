"""What ``slamsim calibrate`` tells: quantities with intervals and verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import CameraModel
from slamsim.check.findings import Measurement, decide
from slamsim.core.types import FloatArray
from slamsim.guard.quantities import as_interval, as_number
from slamsim.perception.calibrated import LATE, R_BODY_OPTICAL, READOUT
from slamsim.perception.calibration.lens import LensFit
from slamsim.perception.calibration.mount import MountFit
from slamsim.perception.calibration.projection import LENS, lens_names
from slamsim.perception.calibration.sightings import CornerMisfits

FOCAL_SHARE, CENTRE_SHARE = 0.005, 0.005
"""Of the focal length and of the image's width: 5 mm at 1 m. Healthy cameras of robots agree with
their CameraInfo within a third of that."""
PLACE_M, TURN_DEG, LATE_S = 0.01, 0.5, 0.005
"""Beyond them a depth cloud lies a cell of a map, or a wall's thickness at 5 m, beside it; at
0.5 m/s and 1 rad/s a late image is 2.5 mm and 0.3 degrees off."""
HEIGHT_WANTED = "--surveyed tags tell the height"
TILT_WANTED = "views of the board from near and far, tilted by 30 degrees and more"
TAGS_WANTED = "more tags, near and far, in all parts of the image"
PATH_WANTED = "a path that does not drift: scans of a lidar, or --trajectory"
MOTION_WANTED = "a drive with turns past more tags, near enough to be 20 px wide"

_SHOWN = {"m": (1e3, "mm"), "s": (1e3, "ms"), "deg": (1.0, "degrees")}
"""Units of tables: (how many, their name)."""
_UNTOLD = {"m": 0.5, "s": 0.5, "deg": 30.0}
"""Half an interval that is no answer any more; of a focal length it is as much as the length."""

Told = Literal["ok", "fault", "inconclusive", "measured"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A calibrated number. sigma: its standard deviation; off: what it is off the claim, both in
    ``unit``; verdict: "measured" where nothing is claimed. wanted: what would tell it."""

    name: str
    value: float
    sigma: float
    unit: str
    claimed: float | None
    off: float | None
    verdict: Told
    wanted: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return Measurement(self.value, self.sigma, self.unit).interval

    def as_dict(self) -> dict[str, object]:
        return {
            **{"name": self.name, "value": self.value, "sigma": self.sigma, "unit": self.unit},
            **{"interval": list(self.interval), "claimed": self.claimed, "off": self.off},
            **{"verdict": self.verdict, "wanted": self.wanted},
        }


def quantity(
    name: str,
    measured: tuple[float, float, str],
    claimed: float | None,
    limit: float,
    wanted: str,
    off: float | None = None,
) -> Quantity:
    """Judged by the checker's rule. measured: value, sigma, unit. limit: up to which off the claim
    all is well, and beyond which an interval tells nothing. off: less the claim by default."""
    value, sigma, unit = measured
    if claimed is None:
        told: Told = "measured" if 1.96 * sigma <= 2.0 * limit else "inconclusive"
    else:
        off = value - claimed if off is None else off
        told = decide(Measurement(off, sigma, unit), limit)
    if told != "inconclusive":
        wanted = ""
    elif 1.96 * sigma <= limit and abs(abs(off or 0.0) - limit) <= 0.98 * sigma:
        # Nor would half the interval tell, which takes four times as much to see.
        wanted = f"off by {as_number(abs(off or 0.0), 3)} {unit}, which is about what may be"
    return Quantity(name, value, sigma, unit, claimed, off, told, wanted)


@dataclass(frozen=True, slots=True, eq=False)
class CameraResult:
    """What was found of one camera. facts: about the images, as a table shows them. model: None
    where the lens was not told; mount likewise. lens: where corners of the board are; size: of the
    images."""

    topic: str
    frame: str
    facts: dict[str, str]
    quantities: tuple[Quantity, ...]
    model: CameraModel | None = None
    mount: MountFit | None = None
    base_frame: str = ""
    figures: dict[str, float | int] = field(default_factory=dict)
    lens: CornerMisfits | None = None
    size: tuple[int, int] = (0, 0)

    @property
    def name(self) -> str:
        """Of its files: the topic without what all have."""
        words = [w for w in self.topic.split("/") if w not in ("", "compressed", "image_raw")]
        return "_".join(words) or "camera"

    def as_dict(self) -> dict[str, object]:
        return {
            **{"topic": self.topic, "frame": self.frame, **self.figures},
            "quantities": [each.as_dict() for each in self.quantities],
        }


def lens_quantities(
    model: CameraModel, sigmas: FloatArray, claim: CameraModel | None, wanted: str = TILT_WANTED
) -> Iterator[Quantity]:
    """Focal lengths, centre and coefficients; sigmas (l,) as ``lens_names``. wanted: what would
    tell them."""
    limits = [FOCAL_SHARE * float(model.focal_px.mean())] * 2 + [CENTRE_SHARE * model.width] * 2
    for k, name in enumerate(lens_names(model)):
        value, said = _lens_number(model, k), None if claim is None else _lens_number(claim, k)
        measured = (value, float(sigmas[k]), "px" if k < len(LENS) else "")
        if k < len(LENS):
            yield quantity(name.removesuffix("_px"), measured, said, limits[k], wanted)
        else:
            same = claim is not None and claim.distortion_model == model.distortion_model
            yield Quantity(name, *measured, said if same else None, None, "measured")


def _lens_number(model: CameraModel, k: int) -> float:
    if k < len(LENS):
        return float(model.K[(0, 1, 0, 1)[k], (0, 1, 2, 2)[k]])
    place = k - len(LENS)
    return float(model.coefficients[place]) if place < len(model.coefficients) else 0.0


def is_lens_told(fit: LensFit) -> bool:
    """Whether views of the first camera tell the focal length within some per cent."""
    focal_px = fit.models[0].focal_px
    share = float((fit.lens_sigmas(0)[:2] / np.abs(focal_px)).max())
    return share < 0.03 and float(focal_px.max()) < 20.0 * fit.models[0].width


def mount_quantities(
    fit: MountFit,
    T_base_claimed: FloatArray | None,
    readout_is_free: bool,
    wanted: str = MOTION_WANTED,
) -> Iterator[Quantity]:
    """Where the camera sits, looking along x, and its clock. wanted: what would tell the mount.

    T_base_claimed: (4, 4).
    """
    values, said = mount_numbers(fit.T_base_camera), None
    off: list[float | None] = [None] * 6
    if T_base_claimed is not None:
        said = mount_numbers(T_base_claimed)
        step = fit.moved_from(T_base_claimed)
        off = [*step[:3].tolist(), *np.degrees(step[3:]).tolist()]
    for k, name in enumerate(("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")):
        is_turn = k > 2
        sigma = float(np.degrees(fit.sigma(name))) if is_turn else fit.sigma(name)
        yield quantity(
            name.split("_")[0],
            (float(values[k]), sigma, "deg" if is_turn else "m"),
            None if said is None else float(said[k]),
            TURN_DEG if is_turn else PLACE_M,
            HEIGHT_WANTED if name == "z_m" else wanted,
            off[k],
        )
    late = (fit.late_s, fit.sigma("late_s"), "s")
    yield quantity(LATE, late, 0.0, LATE_S, MOTION_WANTED)
    if readout_is_free:
        readout = (fit.readout_s, fit.sigma("readout_s"), "s")
        yield quantity(READOUT, readout, None, LATE_S, MOTION_WANTED)


def mount_numbers(T_base_camera: FloatArray) -> FloatArray:
    """(6,) x, y, z in metres and roll, pitch, yaw in degrees of the body that looks along x."""
    turn = Rotation.from_matrix(T_base_camera[:3, :3] @ R_BODY_OPTICAL.T)
    numbers = np.concatenate([T_base_camera[:3, 3], turn.as_euler("xyz", degrees=True)])
    return np.round(numbers, 9) + 0.0  # no -0, nor what rounding leaves of it


def table_rows(result: CameraResult) -> dict[str, str]:
    """As a table shows them."""
    rows = dict(result.facts)
    for name, shown, claimed, verdict, wanted in map(quantity_row, result.quantities):
        said = f", claimed {claimed}" if claimed else ""
        rows[name] = f"{shown}{said}: {verdict}" + (f" ({wanted})" if wanted else "")
    return rows


def quantity_row(each: Quantity) -> tuple[str, str, str, str, str]:
    """Name, value with its interval, claim, verdict, and what would tell more; empty for none."""
    factor, unit = _SHOWN.get(each.unit, (1.0, each.unit))
    half = 1.96 * each.sigma
    untold = half > _UNTOLD.get(each.unit, abs(each.value) + 1e-9) and each.unit != ""
    shown = "not told" if untold else as_interval(factor * each.value, factor * half)
    shown += "" if untold or not unit else f" {unit}"
    said = "" if each.claimed is None else str(as_number(factor * each.claimed))
    return each.name, shown, said, each.verdict, each.wanted


def pair_rows(pair: Mapping[str, Any]) -> dict[str, str]:
    """What a table shows of two cameras."""
    sigma_m = float(np.linalg.norm(pair["sigma_m"]))
    turn_deg = float(np.linalg.norm(pair["sigma_deg"]))
    return {
        "views": str(pair["views"]),
        "apart": f"{as_interval(1e3 * pair['baseline_m'], 1.96e3 * sigma_m)} mm",
        "turned": f"± {as_number(1.96 * turn_deg, 2)} degrees",
    }


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """cameras: what was found of each; pairs: of each two that saw the board together. notes: why
    something was not found, and by what the path was known."""

    cameras: tuple[CameraResult, ...]
    pairs: tuple[dict[str, object], ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        return {
            "cameras": [each.as_dict() for each in self.cameras],
            "pairs": list(self.pairs),
            "notes": list(self.notes),
        }
