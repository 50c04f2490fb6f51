"""Configuration of SLAM: front end, back end, mapping."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from slamsim.config.back_end import BackEndConfig
from slamsim.config.base import Config


class LayersConfig(Config):
    """Layers that images add to the map, in cells of the same size."""

    obstacles: bool = False
    """Whether depth images are searched for what stands in the way, above or below the lidar's
    plane: written as ``obstacles.pgm`` and ``obstacles.yaml``."""

    labels: str = ""
    """Topic of label images (mono8, 8UC1, 32SC1) in whose cells they are counted, written as
    ``semantic.png`` and ``semantic.yaml``; empty for none."""

    floor_m: float | None = Field(None, ge=-10.0, le=10.0)
    """Height of the floor in the robot's base frame; by default where ``base_footprint`` is, or
    where wheels of the robot description end below; where nothing tells it, 0, with a warning."""

    lowest_m: float = Field(0.03, gt=0.0, le=10.0)
    """What rises less above the floor is no obstacle, before the errors of depth and tilt."""

    highest_m: float = Field(0.5, gt=0.0, le=10.0)
    """What is higher is out of the robot's way."""

    step_m: float = Field(0.05, gt=0.0, le=10.0)
    """Heights are told apart in steps of this: seen below a table top, the floor clears no table
    top."""

    max_depth_m: float = Field(4.0, gt=0.0, le=100.0)
    """Depths beyond are left out."""

    depth_noise_per_m: float = Field(0.003, ge=0.0, le=1.0)
    """Standard deviation of a depth of 1 m, in metres; it grows with the square of depth (the
    curve measured of a RealSense D435)."""

    tilt_deg: float = Field(0.5, ge=0.0, le=45.0)
    """By so much the camera may be tilted otherwise than claimed, or the robot pitch."""

    @model_validator(mode="after")
    def _heights_ascend(self) -> Self:
        if self.highest_m <= self.lowest_m:
            raise ValueError(
                f"highest_m ({self.highest_m}) must be above lowest_m ({self.lowest_m})"
            )
        return self


class MappingConfig(Config):
    """Log-odds occupancy grid (Moravec & Elfes 1985; Thrun, Burgard & Fox 2005, chapter 9)."""

    resolution_m: float = Field(0.05, gt=0.0, le=10.0)
    """Side of a cell."""

    max_range_m: float = Field(30.0, gt=0.0, le=1e6)
    """Returns farther than this only clear, up to this range."""

    clear_without_return_m: float = Field(8.0, ge=0.0, le=1e6)
    """A beam without return clears up to this range; 0 leaves such beams out."""

    min_travel_m: float = Field(0.06, ge=0.0, le=1e6)
    """A scan is used once the robot has travelled this far since the last one used ..."""

    min_turn_deg: float = Field(4.0, ge=0.0, le=180.0)
    """... or has turned by this much. Both 0: every scan is used."""

    hit_probability: float = Field(0.64, gt=0.5, lt=1.0)
    """Probability that a cell is occupied, given one return from it: by default one alone is not
    enough to be drawn as a wall."""

    miss_probability: float = Field(0.43, gt=0.0, lt=0.5)
    """Probability that a cell is occupied, given one beam through it."""

    min_probability: float = Field(0.02, gt=0.0, lt=0.5)
    """No cell becomes surer to be free than this."""

    max_probability: float = Field(0.98, gt=0.5, lt=1.0)
    """No cell becomes surer to be occupied than this."""

    max_cells: int = Field(200_000_000, gt=0)
    """A map that would need more cells than this is refused."""

    layers: LayersConfig = LayersConfig()
    """What images add to it."""


class MotionConfig(Config):
    """Errors of wheels and gyroscope before anything is learnt; matches teach the rest."""

    slip_m_per_sqrt_m: float = Field(0.02, gt=0.0, le=1.0)
    """Standard deviation of the wheels' path after one metre; it grows as that of a random walk."""

    slip_m_per_sqrt_rad: float = Field(0.01, ge=0.0, le=1.0)
    """Standard deviation of the wheels' position after turning by one radian."""

    turn_rad_per_sqrt_rad: float = Field(0.05, gt=0.0, le=1.0)
    """Standard deviation of the wheels' heading after turning by one radian."""

    turn_rad_per_sqrt_m: float = Field(0.01, ge=0.0, le=1.0)
    """Standard deviation of the wheels' heading after one metre."""

    gyro_rad_per_sqrt_rad: float = Field(0.003, gt=0.0, le=1.0)
    """Standard deviation of the gyroscope's heading after turning by one radian."""

    gyro_rad_per_sqrt_s: float = Field(0.0005, gt=0.0, le=0.1)
    """Standard deviation of the gyroscope's heading after one second (angle random walk)."""

    gyro_bias_walk: float = Field(0.00005, ge=0.0, le=0.1)
    """Standard deviation by which the gyroscope's bias changes in one second, in rad/s."""


class LocalMapConfig(Config):
    """The surfaces around the robot that a scan is matched against."""

    cell_m: float = Field(0.25, ge=0.05, le=2.0)
    """Edge of the square cells in which neighbouring surface pieces are merged."""

    window_m: float = Field(30.0, ge=2.0, le=1000.0)
    """Surfaces not seen again on this much path are forgotten."""

    keyscan_distance_m: float = Field(0.15, ge=0.0, le=5.0)
    """A scan enters the local map when the robot has moved this far since the last that did."""

    keyscan_turn_deg: float = Field(8.0, ge=0.0, le=180.0)
    """A scan enters the local map when the robot has turned this far since the last that did."""


class MatchingConfig(Config):
    """How a scan is laid onto the local map."""

    max_iterations: int = Field(30, ge=1, le=200)
    """Gauss-Newton steps before a match is given up."""

    gate_m: float = Field(0.5, gt=0.0, le=5.0)
    """Largest distance between a surface piece of the scan and its partner in the map."""

    min_inlier_ratio: float = Field(0.55, gt=0.0, le=1.0)
    """Share of the scan, where the map covers it, that must lie on it for a match to count."""

    weak_direction_share: float = Field(0.02, ge=0.0, le=0.5)
    """A direction that holds less than this share of the surfaces' grip is left to odometry."""

    search_distance_m: float = Field(0.8, ge=0.0, le=5.0)
    """How far around the prediction a lost scan is searched for."""

    search_turn_deg: float = Field(30.0, ge=0.0, le=180.0)
    """How far to either side of the predicted heading a lost scan is searched for."""


class FrontEndConfig(Config):
    """From raw scans to a trajectory, scan by scan."""

    matcher: Literal["line", "kiss"] = "line"
    """The scan matcher: line (surfaces with normals) or kiss (kiss-icp's point registration)."""

    max_range_m: float = Field(60.0, gt=0.1, le=1000.0)
    """Returns beyond this range are not matched; the lidar's own limit holds as well."""

    motion: MotionConfig = MotionConfig()
    """Noise of wheels and gyroscope."""

    local_map: LocalMapConfig = LocalMapConfig()
    """The local map."""

    matching: MatchingConfig = MatchingConfig()
    """Scan matching."""


class LandmarksConfig(Config):
    """Square tags in the images of a recording, as landmarks of the map."""

    tags: str = ""
    """Which are looked for, as FAMILY:SIZE_M (apriltag_36h11:0.2); empty: no image is looked at."""

    surveyed: str = ""
    """A YAML file with the places of tags that were surveyed; the map is then in their frame."""

    least_sigma_m: float = Field(0.004, gt=0.0, le=10.0)
    """Least standard deviation of where a key frame sees a tag: what lens and mounting leave."""

    least_sigma_deg: float = Field(0.3, gt=0.0, le=90.0)
    """Least standard deviation of which way a key frame sees a tag face."""


class SurveyedTag(Config):
    """Where one tag hangs, as ``tags.yaml`` beside a simulated world has it."""

    id: int = Field(ge=0, le=100_000)
    """Its number within its family."""

    family: str = ""
    """Its family; tags of another than ``tags`` asks for are left out."""

    size_m: float | None = Field(None, gt=0.0, le=10.0)
    """Side of its black square."""

    position_m: tuple[float, float, float] = Field(strict=False)
    """Its middle, in the frame of the survey."""

    quat_xyzw: tuple[float, float, float, float] = Field(strict=False)
    """How its frame is turned: x to the right and y up as it is read, z out of the wall."""

    sigma_m: float = Field(0.002, gt=0.0, le=10.0)
    """Standard deviation of x and y."""

    sigma_deg: float = Field(0.5, gt=0.0, le=90.0)
    """Standard deviation of the way that it faces."""


class SurveyedTags(Config):
    """The tags of a survey."""

    tags: tuple[SurveyedTag, ...] = Field(strict=False)
    """Each with its number and place."""


class SlamConfig(Config):
    """All of SLAM."""

    calibrate_laser: bool = True
    """Whether angle step, range offset, sweep, mount and stamps of a laser are corrected where the
    log contradicts them, and what turns the wrong way is turned round."""

    front_end: FrontEndConfig = FrontEndConfig()
    """Deskew, motion prediction, scan matching."""

    back_end: BackEndConfig = BackEndConfig()
    """Loop closure and pose graph."""

    landmarks: LandmarksConfig = LandmarksConfig()
    """Tags in the recording's images."""

    camera_calibration: str = ""
    """The ``calibration.yaml`` that ``slamsim calibrate`` wrote: its lenses, mounts, clocks and
    shutters count before what the recording claims of these cameras."""
