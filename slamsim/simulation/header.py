"""Parts of a simulated recording that are written once."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from slamsim import __version__
from slamsim.config.run import RunConfig
from slamsim.config.sensors import ImuConfig, InertialAxesConfig
from slamsim.core.geometry import StaticTransform
from slamsim.core.types import Epoch
from slamsim.guard.errors import SlamsimError, shown
from slamsim.sensors.base import static_frames
from slamsim.sim.engine import engine_parameters
from slamsim.sim.robot.model import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class LogHeader:
    """What a recording says once.

    robot_description: the URDF. scan_rate_hz: turns of the lidar per second. wheel_joints: names
    of the (left, right) joint. The variances are those of one IMU sample, in (rad/s)^2 and
    (m/s^2)^2, 0 for unknown. truth_rate_hz: how often the true pose is recorded, at most the
    physics rate. topics: type of the messages of each topic of the additional sensors. metadata:
    whatever else shall stand in the file, such as sensor constants and versions.
    """

    robot_description: str
    static_transforms: Sequence[StaticTransform]
    scan_rate_hz: float
    wheel_joints: tuple[str, str] = ("wheel_left_joint", "wheel_right_joint")
    imu_gyro_variance: float = 0.0
    imu_accel_variance: float = 0.0
    epoch: Epoch = "simulation"
    truth_rate_hz: float = 120.0
    odom_frame: str = "odom"
    base_frame: str = "base_footprint"
    map_frame: str = "map"
    topics: Mapping[str, str] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)


def log_header(robot: RobotModel, config: RunConfig) -> LogHeader:
    """Raises SlamsimError for a sensor whose frame the robot has already."""
    imu, additional = config.sensors.imu, config.sensors.additional
    frames = (*robot.static_transforms, *static_frames(additional))
    _require_one_parent(frames)
    return LogHeader(
        robot_description=robot.urdf,
        static_transforms=frames,
        scan_rate_hz=config.sensors.lidar.rate_hz,
        imu_gyro_variance=_sample_variance(imu.gyro, imu),
        imu_accel_variance=_sample_variance(imu.accelerometer, imu),
        topics={topic: kind for entry in additional for topic, kind in entry.topics.items()},
        metadata={
            "slamsim_version": __version__,
            "seed": str(config.seed),
            "physics": json.dumps(engine_parameters(config.drive.physics)),
            **{name: value for entry in additional for name, value in entry.custom_data.items()},
        },
    )


def _sample_variance(axes: InertialAxesConfig, imu: ImuConfig) -> float:
    """White noise of this density, sampled at the unit's rate (IEEE Std 952)."""
    return axes.noise_density**2 * imu.rate_hz


def _require_one_parent(edges: Sequence[StaticTransform]) -> None:
    counts = Counter(edge.child for edge in edges)
    twice = next((child for child, count in counts.items() if count > 1), None)
    if twice is not None:
        raise SlamsimError(
            f"sensors.additional: the robot has a frame {shown(twice)} already; "
            "give the sensor another name"
        )
