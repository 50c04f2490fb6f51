"""What the robot is: bodies, wheels, motors and where its sensors sit.

All positions are in ``base_footprint``: on the floor, midway between the drive wheels, x
forward, y left, z up. The defaults are a TurtleBot2 on a Kobuki base with one plate (Kobuki
data sheet: diameter 351.5 mm, height 124.8 mm, 2.35 kg, wheels 76 mm nominal, 70.4 mm loaded).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from slamsim.config.base import Config

Triple = Annotated[tuple[float, float, float], Field(strict=False)]
PositiveTriple = Annotated[
    tuple[
        Annotated[float, Field(gt=0.0, le=2.0)],
        Annotated[float, Field(gt=0.0, le=2.0)],
        Annotated[float, Field(gt=0.0, le=2.0)],
    ],
    Field(strict=False),
]


class MountConfig(Config):
    """``T_base_sensor`` in six degrees of freedom; rotation about fixed x, then y, then z."""

    x_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """Forward of the middle between the drive wheels."""
    y_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """To the left of the middle."""
    z_m: float = Field(default=0.0, ge=0.0, le=3.0)
    """Above the floor."""
    roll_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About x: the left side rises."""
    pitch_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About y: the front sinks."""
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About z: counter-clockwise seen from above."""


class CylinderConfig(Config):
    """A solid upright cylinder that is part of the robot's body."""

    radius_m: float = Field(gt=0.0, le=2.0)
    """Radius."""
    height_m: float = Field(gt=0.0, le=3.0)
    """Height."""
    mass_kg: float = Field(gt=0.0, le=500.0)
    """Mass, evenly spread."""
    x_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """Centre, forward of the middle."""
    y_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """Centre, left of the middle."""
    bottom_z_m: float = Field(ge=0.0, le=3.0)
    """Underside, above the floor."""


class SensorBodyConfig(Config):
    """A sensor: the frame it measures in and the cuboid that carries it."""

    mount: MountConfig
    """Pose of the sensor's measuring frame on the robot."""
    size_m: PositiveTriple
    """Extent of the body along the sensor's x, y and z."""
    mass_kg: float = Field(gt=0.0, le=50.0)
    """Mass, evenly spread over the body."""
    body_centre_m: Triple = (0.0, 0.0, 0.0)
    """Centre of the body, seen from the measuring frame."""


class DriveWheelsConfig(Config):
    """The two driven wheels on the y axis."""

    radius_m: float = Field(default=0.0352, gt=0.005, le=1.0)
    """Rolling radius."""
    track_m: float = Field(default=0.230, gt=0.02, le=3.0)
    """Distance between the points where the two wheels touch the floor."""
    width_m: float = Field(default=0.0206, gt=0.001, le=0.5)
    """Width of the tyre."""
    mass_kg: float = Field(default=0.1, gt=0.0, le=50.0)
    """Mass of one wheel, evenly spread over its cylinder."""
    friction: float = Field(default=1.4, ge=0.0, le=5.0)
    """Coulomb coefficient on a floor of friction 1; the two are multiplied."""


class SupportWheelsConfig(Config):
    """Front and rear support: low-friction balls that roll freely about y."""

    front_x_m: float = Field(default=0.115, gt=0.0, le=2.0)
    """Where the front one touches the floor."""
    rear_x_m: float = Field(default=-0.135, lt=0.0, ge=-2.0)
    """Where the rear one touches the floor."""
    radius_m: float = Field(default=0.0176, gt=0.002, le=0.5)
    """Radius; the centre lies this far above the floor."""
    mass_kg: float = Field(default=0.02, gt=0.0, le=10.0)
    """Mass of one ball."""
    friction: float = Field(default=0.02, ge=0.0, le=5.0)
    """Coulomb coefficient when it is dragged sideways, on a floor of friction 1."""


class MotorConfig(Config):
    """How a wheel is made to turn at the commanded speed."""

    kind: Literal["velocity", "pid", "ideal"] = "velocity"
    """velocity: holds the speed as far as the torque reaches; pid: torque from a speed error;
    ideal: takes the speed at once, whatever torque that needs."""
    max_torque_n_m: float = Field(default=1.6, gt=0.0, le=1000.0)
    """Largest torque at one wheel (Kobuki: 33 mN m stall torque, gear ratio 49.6)."""
    pid_proportional: float = Field(default=0.025, ge=0.0, le=100.0)
    """Torque per speed error, N m s/rad (kind pid)."""
    pid_integral: float = Field(default=0.15, ge=0.0, le=1000.0)
    """Torque per integrated speed error, N m/rad (kind pid)."""
    pid_derivative: float = Field(default=0.0, ge=0.0, le=10.0)
    """Torque per change of the speed error, N m s^2/rad (kind pid)."""


class RobotConfig(Config):
    """A differential-drive robot with a lidar, an IMU and a camera."""

    name: str = Field(default="turtlebot2", min_length=1, max_length=64)
    """Name in the robot description."""
    urdf_file: str | None = None
    """A robot description (URDF) to use instead of the bodies and mounts below; it is checked
    like our own. Friction and motor are still taken from here."""
    base: CylinderConfig = CylinderConfig(
        radius_m=0.17575, height_m=0.1098, mass_kg=2.35, bottom_z_m=0.015
    )
    """The base without its wheels."""
    plate: CylinderConfig = CylinderConfig(
        radius_m=0.159, height_m=0.0064, mass_kg=0.52, bottom_z_m=0.1306
    )
    """The one plate above the base."""
    weight: CylinderConfig = CylinderConfig(
        radius_m=0.05, height_m=0.04, mass_kg=0.5, x_m=-0.06, bottom_z_m=0.137
    )
    """Cables and fixings, as one extra weight."""
    drive_wheels: DriveWheelsConfig = DriveWheelsConfig()
    """The driven wheels."""
    support_wheels: SupportWheelsConfig = SupportWheelsConfig()
    """The wheels that keep the robot level."""
    motor: MotorConfig = MotorConfig()
    """The wheel motors."""
    lidar: SensorBodyConfig = SensorBodyConfig(
        mount=MountConfig(x_m=0.08, z_m=0.2),
        size_m=(0.060, 0.060, 0.087),
        mass_kg=0.37,
        body_centre_m=(0.0, 0.0, -0.0185),
    )
    """Hokuyo UTM-30LX; its beams leave 62 mm above its foot."""
    camera: SensorBodyConfig = SensorBodyConfig(
        mount=MountConfig(x_m=0.135, z_m=0.15),
        size_m=(0.025, 0.090, 0.025),
        mass_kg=0.072,
    )
    """RealSense D435."""
    imu: MountConfig = MountConfig(x_m=0.0, y_m=0.0, z_m=0.09)
    """Where the IMU sits inside the base."""
    body_friction: float = Field(default=0.3, ge=0.0, le=5.0)
    """Coulomb coefficient of the body against walls."""
    max_contact_gap_m: float = Field(default=1e-4, gt=0.0, le=0.01)
    """How far a wheel may be from the floor before the model is refused."""
