"""A recording as it was written: nothing sorted, repaired or left out.

The checker, the faults and ``slamsim fix`` need what the file says: every stamp and every range as
recorded, when each message was received, and the transform tree edge by edge. SLAM reads a ``Log``,
which ``cleaning`` makes of it. Units are those that the format asks for (SI in ROS), whether or not
the numbers obey. All arrays of one stream are in the order of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.survey import CameraSurvey
from slamsim.core.types import Epoch, Float32Array, FloatArray, IntArray
from slamsim.recording import schemas

MOST_ROUNDED = 0.01
"""Of an angle between beams: 1,440 beams with 0.0044 rad come to 0.9 %."""


@dataclass(frozen=True, slots=True)
class ScanLayout:
    """What the messages of a lidar declare of their beams; often the same for all of them."""

    angle_min_rad: float
    angle_max_rad: float
    angle_step_rad: float
    beam_dt_s: float
    scan_time_s: float
    range_min_m: float
    range_max_m: float

    def folds(self, beams: int) -> bool:
        """Whether so many beams make more than a turn, and one more as some drivers write it."""
        step_rad = abs(self.angle_step_rad)
        return step_rad * (beams - 1) > 2.0 * math.pi + step_rad

    def unfolded(self, beams: int) -> ScanLayout:
        """What a layout that folds was before its angle between beams was rounded to some decimal:
        of 1,800 beams 0.00349 rad are often written as 0.0035. As declared if it does not fold, if
        it is a hundredth of a turn too wide or more, which is no rounding, or if neither its ends
        nor a whole turn give an angle that rounds to the declared one."""
        widest_rad = 2.0 * math.pi * (1.0 + MOST_ROUNDED)
        if not self.folds(beams) or abs(self.angle_step_rad) * (beams - 1) > widest_rad:
            return self
        span_rad = self.angle_max_rad - self.angle_min_rad
        turn_rad = math.copysign(2.0 * math.pi, self.angle_step_rad)
        for step_rad in (span_rad / (beams - 1), turn_rad / beams, turn_rad / (beams - 1)):
            finer = replace(self, angle_step_rad=step_rad)
            if _rounds_to(step_rad, self.angle_step_rad) and not finer.folds(beams):
                return finer
        return self


def _rounds_to(exact: float, rounded: float) -> bool:
    """Whether a number is another one to 2 to 6 decimals; the latter may be of single precision."""
    return math.isfinite(exact) and any(
        math.isclose(round(exact, decimals), rounded, rel_tol=1e-6) for decimals in range(2, 7)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where in a file the rows of a stream or edge come from: a copy of the file changes there.

    topic: as the file names it. places: (n, 2) number of the message among those of the topic,
    and which of the transforms in it (0 in all other messages).
    """

    topic: str
    places: IntArray

    def __getitem__(self, rows: IntArray) -> Origin:
        return replace(self, places=self.places[rows])

    @property
    def keys(self) -> IntArray:
        """(n,) one number for each message and transform in it."""
        return np.asarray((self.places[:, 0] << 32) | self.places[:, 1])

    @classmethod
    def in_order(cls, topic: str, messages: IntArray) -> Origin:
        """Rows that are a message each."""
        return cls(topic, np.column_stack([messages, np.zeros_like(messages)]))


class _OfSchema:
    """Messages of one kind; schema: what each of them holds."""

    __slots__ = ()
    schema: ClassVar[schemas.Schema]

    def values(self, field: schemas.Field) -> Any:
        """What is held of a field: a row for each message, or one number of all; None for none."""
        return getattr(self, field.name)


@dataclass(frozen=True, slots=True, eq=False)
class RawStream(_OfSchema):
    """What every stream has.

    frame_ids: the distinct frames that its messages name, in order of appearance. stamps_ns: (n,)
    as in the messages. received_ns: (n,) when the recorder received each, None if
    the format does not say. samples: (n,) number of each among all that the sensor took, None
    where lost ones are not known. slashed: those of the frames that messages of ROS 2 write with
    a leading slash. origin: the messages of a file that these were read from.
    """

    topic: str
    frame_ids: tuple[str, ...]
    stamps_ns: IntArray
    received_ns: IntArray | None
    samples: IntArray | None = field(default=None, kw_only=True)
    slashed: tuple[str, ...] = field(default=(), kw_only=True)
    origin: Origin | None = field(default=None, kw_only=True)

    def __len__(self) -> int:
        return int(self.stamps_ns.size)


@dataclass(frozen=True, slots=True, eq=False)
class RawScans(RawStream):
    """Scans of one lidar.

    layouts: the distinct declarations; layout_of: (n,) which one each scan makes. ranges_m: n rows
    of float32 as recorded (an array when all have as many beams, else a sequence of arrays, which
    may read the file only when asked). intensities likewise, None without any. range_is_estimated:
    the format declares no maximum, so that ``range_max_m`` is what the readings themselves say.
    in_order: False where the order in which the beams were measured is lost, or there is none.
    other_intensities: messages that hold some, but not as many as ranges. note: how the scans were
    made of other messages, in words; then they cannot be written back, and have no origin.
    """

    schema = schemas.SCANS

    layouts: tuple[ScanLayout, ...]
    layout_of: NDArray[np.int32]
    ranges_m: Sequence[Float32Array] | Float32Array
    intensities: Sequence[Float32Array] | Float32Array | None = None
    range_is_estimated: bool = field(default=False, kw_only=True)
    in_order: bool = field(default=True, kw_only=True)
    other_intensities: int = field(default=0, kw_only=True)
    note: str = field(default="", kw_only=True)

    def layout(self, scan: int) -> ScanLayout:
        return self.layouts[int(self.layout_of[scan])]

    def values(self, field: schemas.Field) -> Any:
        if field not in schemas.LASER_LAYOUT:
            return getattr(self, field.name)
        each = [getattr(layout, field.name) for layout in self.layouts]
        return np.array(each, dtype=np.float64)[self.layout_of]


@dataclass(frozen=True, slots=True, eq=False)
class RawImu(RawStream):
    """angular_velocity_rad_s, linear_acceleration_m_s2: (n, 3) in the stream's frame.

    orientation_xyzw: (n, 4), None where the messages say that they have none.
    """

    schema = schemas.IMU

    angular_velocity_rad_s: FloatArray
    linear_acceleration_m_s2: FloatArray
    orientation_xyzw: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RawOdometry(RawStream):
    """Poses (n, 3) and (n, 4) of child_frame_id in the stream's frame, twists (n, 3) in the child.

    yaws_rad: (n,) the headings, where the format has them as such: they hold as long as quats_xyzw
    is what was made of them. The ground truth of a simulation is never among the odometries of a
    ``Recording``.
    """

    schema = schemas.ODOMETRY

    child_frame_ids: tuple[str, ...]
    positions_m: FloatArray
    quats_xyzw: FloatArray
    linear_m_s: FloatArray
    angular_rad_s: FloatArray
    yaws_rad: FloatArray | None = field(default=None, kw_only=True)


@dataclass(frozen=True, slots=True, eq=False)
class RawTicks(RawStream):
    """Cumulative counts of the wheels, (n, 2) int64 as (left, right), and the driver's numbers.

    constants_change: later messages give other numbers than the first one, whose these are.
    """

    schema = schemas.TICKS

    ticks: IntArray
    ticks_per_revolution: int
    wheel_radius_m: float
    track_m: float
    constants_change: bool = field(default=False, kw_only=True)


@dataclass(frozen=True, slots=True, eq=False)
class RawJoints(RawStream):
    """sensor_msgs/JointState: positions_rad, velocities_rad_s: (n, joints), nan where not given."""

    schema = schemas.JOINTS

    names: tuple[str, ...]
    positions_rad: FloatArray
    velocities_rad_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RawTwists(RawStream):
    """Commands to a robot: (n, 2) forward in m/s and yaw rate in rad/s."""

    schema = schemas.TWISTS

    commands: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TransformEdge(_OfSchema):
    """All transforms published for one pair of frames on one topic.

    T_parent_child as positions_m (n, 3) and quats_xyzw (n, 4) at stamps_ns (n,); received_ns as
    and origin as for a stream. is_static: it came on a latched topic (/tf_static).
    """

    schema = schemas.TRANSFORM

    topic: str
    parent: str
    child: str
    is_static: bool
    stamps_ns: IntArray
    received_ns: IntArray | None
    positions_m: FloatArray
    quats_xyzw: FloatArray
    origin: Origin | None = None

    @property
    def name(self) -> str:
        return f"{self.parent} -> {self.child}"


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic as the file has it. damage: why some of its messages, or all, cannot be decoded."""

    topic: str
    type_name: str
    messages: int
    damage: str = ""


@dataclass(frozen=True, slots=True)
class UnreadTopic:
    """Messages that no check looks at, and why; stream: as read for what other streams lack."""

    topic: str
    type_name: str
    messages: int
    reason: str
    stream: RawStream | None = None


KINDS: tuple[type[RawStream], ...] = (RawScans, RawImu, RawOdometry, RawTicks, RawJoints)
"""What is read of recordings, in the order in which a ``Recording`` holds it."""

RecordingFormat = str
"""Such as ``mcap``, ``rosbag2``, ``rosbag1``, ``carmen``, ``parquet``, or ``memory``."""

Messages = TypeVar("Messages", bound=RawStream | TransformEdge)
_Stream = TypeVar("_Stream", bound=RawStream)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A whole recording: streams, each on its topic, and transforms.

    clock_ns: (n, 2) of (simulated time, when received) from /clock, None without it. epoch: as
    the file declares it or the size of its stamps tells. anomalies: what the reader could not
    make sense of, in words, with counts. topics: what the file holds, also of types that are not
    read; empty where that is just the streams. base_frame: of the robot, where a user names it.
    cameras: what was looked at of images; empty unless that was asked for. unread_cameras: (topic,
    why) of those of which no image can be decoded.
    """

    name: str
    format: RecordingFormat
    streams: tuple[RawStream, ...] = ()
    transforms: tuple[TransformEdge, ...] = ()
    robot_description: str | None = None
    clock_ns: IntArray | None = None
    epoch: Epoch = "unknown"
    unread: tuple[UnreadTopic, ...] = ()
    anomalies: tuple[str, ...] = ()
    topics: tuple[RecordedTopic, ...] = ()
    base_frame: str = ""
    cameras: tuple[CameraSurvey, ...] = ()
    unread_cameras: tuple[tuple[str, str], ...] = ()

    @property
    def base_frames(self) -> tuple[str, ...]:
        """The robot's own frame as the user or the odometry names it, if either does."""
        if self.base_frame:
            return (self.base_frame,)
        return self.odometries[0].child_frame_ids if self.odometries else ()

    def of(self, kind: type[_Stream]) -> tuple[_Stream, ...]:
        """Its streams of a kind."""
        return tuple(stream for stream in self.streams if isinstance(stream, kind))

    def with_streams(self, kind: type[_Stream], streams: Sequence[_Stream]) -> Recording:
        """With these in the place of all streams of a kind."""
        first = next((i for i, each in enumerate(self.streams) if isinstance(each, kind)), None)
        others = [stream for stream in self.streams if not isinstance(stream, kind)]
        at = len(others) if first is None else first
        return replace(self, streams=(*others[:at], *streams, *others[at:]))

    def changed(self, kind: type[_Stream], change: Callable[[_Stream], _Stream]) -> Recording:
        """With each stream of a kind changed."""
        streams = (change(each) if isinstance(each, kind) else each for each in self.streams)
        return replace(self, streams=tuple(streams))

    @property
    def moving(self) -> tuple[TransformEdge, ...]:
        """Its transforms that may change over time."""
        return tuple(edge for edge in self.transforms if not edge.is_static)

    @property
    def scans(self) -> tuple[RawScans, ...]:
        return self.of(RawScans)

    @property
    def imus(self) -> tuple[RawImu, ...]:
        return self.of(RawImu)

    @property
    def odometries(self) -> tuple[RawOdometry, ...]:
        return self.of(RawOdometry)

    @property
    def ticks(self) -> tuple[RawTicks, ...]:
        return self.of(RawTicks)

    @property
    def joints(self) -> tuple[RawJoints, ...]:
        return self.of(RawJoints)
