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


class SuspensionConfig(Config):
    """A spring between the body and each drive wheel, which moves straight up and down.

    The supports are rigid: while both are loaded, they hold the body level and each drive wheel
    carries the preload. The default leaves them about a third of a TurtleBot2's weight.
    """

    travel_m: float = Field(default=0.012, gt=0.0, le=0.2)
    """How far a wheel can move to either side of where it is while the robot stands level."""
    preload_n: float = Field(default=13.0, ge=0.0, le=5000.0)
    """Force of the spring while the robot stands level."""
    stiffness_n_m: float = Field(default=600.0, gt=0.0, le=1e6)
    """How much the force grows with each metre that the wheel is pushed in."""
    damping_n_s_m: float = Field(default=15.0, ge=0.0, le=1e5)
    """Force against the speed of that motion."""


class DriveWheelsConfig(Config):
    """The two driven wheels on the y axis.

    radius_m and track_m are what the robot was built for: commands are turned into wheel speeds
    with them and drivers start from them. A real one differs by its ratio and its scales.
    """

    radius_m: float = Field(default=0.0352, gt=0.005, le=1.0)
    """Rolling radius."""
    track_m: float = Field(default=0.230, gt=0.02, le=3.0)
    """Distance between the points where the two wheels touch the floor."""
    radius_ratio: float = Field(default=1.0, ge=0.5, le=2.0)
    """True radius of the right wheel over that of the left one; their mean is not changed."""
    radius_scale: float = Field(default=1.0, ge=0.5, le=2.0)
    """Mean of the two true radii over radius_m."""
    track_scale: float = Field(default=1.0, ge=0.5, le=2.0)
    """True distance of the points of contact over track_m."""
    width_m: float = Field(default=0.0206, gt=0.001, le=0.5)
    """Width of the tyre."""
    mass_kg: float = Field(default=0.1, gt=0.0, le=50.0)
    """Mass of one wheel, evenly spread over its cylinder."""
    friction: float = Field(default=1.4, ge=0.0, le=5.0)
    """Coulomb coefficient on a floor of friction 1; the two are multiplied."""
    lateral_friction_ratio: float = Field(default=1.0, ge=0.0, le=5.0)
    """Friction across the direction in which the wheel rolls, over that along it."""
    suspension: SuspensionConfig | None = None
    """Springs of the drive wheels; null for wheels that are fixed to the body."""

    @property
    def true_radii_m(self) -> tuple[float, float]:
        """Of the left and the right wheel."""
        left_m = 2.0 * self.radius_m * self.radius_scale / (1.0 + self.radius_ratio)
        return left_m, left_m * self.radius_ratio


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
    """Coulomb coefficient when it is dragged, on a floor of friction 1."""
    rolling: bool = True
    """false: the balls are stuck and dragged in every direction, as in the open-source model of
    the TurtleBot2 whose joints are fixed."""
    front_gap_m: float = Field(default=0.0, ge=0.0, le=0.01)
    """How far the front one hangs above the floor: 0.007 in that model. Refused beyond
    max_contact_gap_m."""
    rear_gap_m: float = Field(default=0.0, ge=0.0, le=0.01)
    """How far the rear one hangs above the floor: 0.009 in that model."""


class MotorConfig(Config):
    """How a wheel is made to turn at the commanded speed."""

    kind: Literal["velocity", "pid", "ideal"] = "velocity"
    """velocity: holds the speed as far as the torque reaches; pid: torque from a speed error;
    ideal: takes the speed at once, whatever torque that needs."""
    max_torque_n_m: float = Field(default=1.6, gt=0.0, le=1000.0)
    """Largest torque at one wheel, at standstill where it falls with speed (Kobuki: 33 mN m stall
    torque, gear ratio 49.6)."""
    no_load_speed_rad_s: float | None = Field(default=None, gt=0.0, le=10_000.0)
    """Wheel speed at which the largest torque has fallen to nothing, in a straight line as with
    every DC motor; null for a torque that does not fall. Not for kind ideal."""
    rotor_inertia_kg_m2: float = Field(default=0.0, ge=0.0, le=100.0)
    """Moment of inertia of the motor's rotor as each wheel feels it, through the square of the gear
    ratio (Kobuki: about 0.001, twenty times the wheel's own). With it, far fewer
    physics.solver_iterations make wheels turn as exactly as their motors hold them."""
    gear_friction_n_m: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Coulomb friction of motor and gears, felt at each wheel. Not for kind ideal."""
    gear_friction_ratio: float = Field(default=1.0, ge=0.1, le=10.0)
    """Gear friction on the right over that on the left; their mean is gear_friction_n_m."""
    battery_sag_per_min: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of the full battery's voltage that is lost in each minute of the drive: torques and
    the no-load speed fall with it. Not for kind ideal."""
    pid_proportional: float = Field(default=0.025, ge=0.0, le=100.0)
    """Torque per speed error, N m s/rad (kind pid)."""
    pid_integral: float = Field(default=0.15, ge=0.0, le=1000.0)
    """Torque per integrated speed error, N m/rad (kind pid). With 0 the wheels turn more slowly
    than commanded, by gear friction over pid_proportional."""
    pid_derivative: float = Field(default=0.0, ge=0.0, le=10.0)
    """Torque per change of the speed error, N m s^2/rad (kind pid)."""

    @property
    def gear_frictions_n_m(self) -> tuple[float, float]:
        """On the left and on the right."""
        left_n_m = 2.0 * self.gear_friction_n_m / (1.0 + self.gear_friction_ratio)
        return left_n_m, left_n_m * self.gear_friction_ratio


class VariationConfig(Config):
    """How much the robot differs from one run to the next: standard deviations, relative.

    Wear, dust, temperature, tyres that sit differently. Each quantity is multiplied with a factor
    whose logarithm is normally distributed, cut at three standard deviations.
    """

    radius: float = Field(default=0.0, ge=0.0, le=0.2)
    """Mean of the true wheel radii."""
    radius_ratio: float = Field(default=0.0, ge=0.0, le=0.2)
    """Right radius over left radius."""
    track: float = Field(default=0.0, ge=0.0, le=0.2)
    """True track."""
    gear_friction: float = Field(default=0.0, ge=0.0, le=1.0)
    """Gear friction of both sides."""
    gear_friction_ratio: float = Field(default=0.0, ge=0.0, le=0.5)
    """Gear friction on the right over that on the left."""
    motor_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    """motor.pid_proportional and motor.pid_integral together."""
    floor_friction: float = Field(default=0.0, ge=0.0, le=1.0)
    """Friction of drive and support wheels on the floor, together."""


class RobotConfig(Config):
    """A differential-drive robot with a lidar, an IMU and a camera."""

    name: str = Field(default="turtlebot2", min_length=1, max_length=64)
    """Name in the robot description."""
    urdf_file: str | None = Field(default=None, min_length=1, max_length=1000)
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
    variation: VariationConfig = VariationConfig()
    """How runs differ; scenarios that repeat a run draw from it, a simulated drive does not."""
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
