"""What SLAM knows of a live robot by now: fed with its streams, told as messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from slamsim.core.geometry import compose, inverse
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.live.controls import Status, Tracking
from slamsim.live.drivers import require_map
from slamsim.live.mapping import Begin, MapNews, MappingProcess, Placed
from slamsim.live.published import DIAGNOSTICS, MAP, PATH, SlamMessages
from slamsim.live.slam_feed import Arrived
from slamsim.recording import RawOdometry, RawScans
from slamsim.recording.cleaning.streams import odometry_of
from slamsim.slam.mapping.map_files import map_files

DIAGNOSED_NS = 1_000_000_000
REMEMBERED_NS = 30_000_000_000
"""How far SLAM may be behind with a scan for its pose to be set beside the odometry."""
TWIST_NS = 200_000_000
"""Over which the speed is taken: a few poses of any odometry."""
MOST_LAG_S, CAUGHT_UP_S = 30.0, 1.0
"""A SLAM that lags so far behind gets no more scans until it has caught up, lest memory grows for
hours; by then its poses are of little use to the robot anyway."""
NO_ODOMETRY = PlanarTrajectory(np.zeros(0, np.int64), np.zeros((0, 3)))

Post = Callable[[str, int, bytes], None]
"""Takes a message's topic, time of arrival (ns) and CDR bytes."""


class LiveMap:
    """The SLAM of one live robot; without a process it knows nothing."""

    def __init__(self, process: MappingProcess | None, odom_frame: str = "odom") -> None:
        self._process, self._messages = process, SlamMessages(odom_frame)
        self.grid: Grid | None = None
        self._saved = self.placed = 0
        self.version = 0
        """Grows with each new map."""
        self.path: FloatArray = np.zeros((0, 3))
        self.events: deque[str] = deque(maxlen=1000)
        """What SLAM had to tell, until it is taken."""
        self._last: Placed | None = None
        self._T_map_odom: FloatArray | None = None
        self._odometry = NO_ODOMETRY
        self._diagnosed_ns, self._lag = 0, _Lag()

    def begin(self, begin: Begin) -> None:
        """A new map; what comes until SLAM is ready waits for it."""
        self._T_map_odom = self.grid = self._last = None
        self._odometry, self._diagnosed_ns = NO_ODOMETRY, 0
        if self._process is not None:
            self._process.begin(begin)

    def await_ready(self) -> None:
        """Wait until SLAM is ready for scans."""
        while self._process is not None and not self._process.is_ready:
            self._process.wait()
            self._process.answers()

    @property
    def behind(self) -> int:
        """Scans that SLAM has not dealt with yet."""
        return 0 if self._process is None else self._process.behind

    def take(self, streams: Sequence[Arrived]) -> None:
        """Hand on what SLAM may see of what arrived, of one topic of each kind. Scans are left out,
        which is told, while SLAM has to catch up."""
        for stream in streams:
            path = odometry_of(stream)[0] if isinstance(stream, RawOdometry) else stream
            if isinstance(path, PlanarTrajectory) and len(path):
                self._odometry = _later(self._odometry, path)
        if self._process is not None:
            self.events.extend(self._lag.news(self._process.lag_s))
            is_late = self._lag.is_on
            self._process.take([s for s in streams if not (is_late and isinstance(s, RawScans))])

    def heed(self, now_ns: int, post: Post) -> None:
        """Take in all that SLAM said since the last call, and post it on."""
        if self._process is None:
            return
        for answer in self._process.answers():
            if isinstance(answer, Placed):
                self._see(answer, now_ns, post)
            elif isinstance(answer, MapNews):
                self.grid, self.path = answer.grid, answer.path
                self.version += 1
                post(MAP, now_ns, self._messages.grid(answer.stamp_ns, answer.grid))
                post(PATH, now_ns, self._messages.path(answer.stamp_ns, answer.path))

    def wait(self) -> None:
        """Until SLAM may have said something."""
        if self._process is not None:
            self._process.wait()

    def pose(self) -> FloatArray | None:
        """(3,) T_map_base as the robot believes it now; None while it does not know."""
        T_map_odom, poses = self._T_map_odom, self._odometry.poses
        if T_map_odom is None or not len(poses):  # other threads may ask while a map is begun
            return None
        return compose(T_map_odom, poses[-1])

    def twist(self) -> tuple[float, float]:
        """(speed in m/s, yaw rate in rad/s) by the newest odometry; zero without."""
        stamps_ns, poses = self._odometry.stamps_ns, self._odometry.poses
        since = np.searchsorted(stamps_ns, stamps_ns[-1:] - TWIST_NS)
        if not len(stamps_ns) or since[0] == len(stamps_ns) - 1:
            return 0.0, 0.0
        moved = compose(inverse(poses[since[0]]), poses[-1])
        seconds = (stamps_ns[-1] - stamps_ns[since[0]]) * 1e-9
        return float(moved[0] / seconds), float(moved[2] / seconds)

    @property
    def tracking(self) -> Tracking:
        """As ``Status.tracking``."""
        if self._process is None:
            return "off"
        return "waiting" if self._last is None or self._last.status is None else self._last.status

    @property
    def counts(self) -> tuple[int, int]:
        """Key frames and closures so far."""
        return (0, 0) if self._last is None else (self._last.keyframes, self._last.closures)

    def save(self, parent: Path, name: str = "") -> Path:
        """Write the map as it is known by now into a new folder, numbered where it gets no name.

        Raises SlamsimError without a map.
        """
        grid, path = require_map(self.grid), self.path
        self._saved += not name
        folder = parent / (name or f"map_{self._saved}")
        parent.mkdir(parents=True, exist_ok=True)
        with partial_folder(folder) as partial:
            for file, data in map_files(grid).items():
                write_atomic(partial / file, data)
            header = "x_m,y_m,yaw_rad"
            np.savetxt(partial / "keyframes.csv", path, "%.6f", ",", header=header, comments="")
        return folder

    def diagnose(self, status: Status, more: Mapping[str, str], post: Post) -> None:
        """Post the status on once a second. more: values beside those of SLAM."""
        if status.stamp_ns - self._diagnosed_ns < DIAGNOSED_NS:
            return
        self._diagnosed_ns = status.stamp_ns
        values = {
            "tracking": status.tracking,
            "key frames": str(status.keyframes),
            "closures": str(status.closures),
            **more,
            "recording": "" if status.recording is None else status.recording.name,
        }
        is_fine = status.tracking in ("off", "waiting", "tracking") and not status.ended
        words = status.ended or f"SLAM: {status.tracking}"
        data = self._messages.diagnostics(status.stamp_ns, is_fine, words, values)
        post(DIAGNOSTICS, status.stamp_ns, data)

    def _see(self, placed: Placed, now_ns: int, post: Post) -> None:
        self._last = placed
        self.placed += placed.status is not None
        self.events.extend(placed.events)
        stamps_ns = self._odometry.stamps_ns
        if placed.status is None or not np.isfinite(placed.T_map_base).all():
            return
        if not (len(stamps_ns) and stamps_ns[0] <= placed.stamp_ns <= stamps_ns[-1]):
            return
        # Of the odometry that the robot publishes: SLAM's own has the gyroscope in it.
        T_odom_base = self._odometry.at(np.array([placed.stamp_ns]))[0]
        self._T_map_odom = compose(placed.T_map_base, inverse(T_odom_base))
        post("/tf", now_ns, self._messages.map_odom(placed.stamp_ns, self._T_map_odom))


class _Lag:
    """SLAM has to catch up. is_on: whether that is so."""

    def __init__(self) -> None:
        self.is_on = False

    def news(self, lag_s: float) -> Iterator[str]:
        """What is to be told since the last call. lag_s: how long the oldest message waits."""
        if lag_s > MOST_LAG_S and not self.is_on:
            self.is_on = True
            yield f"SLAM is {lag_s:.0f} s behind: scans are left out until it has caught up"
        elif lag_s < CAUGHT_UP_S and self.is_on:
            self.is_on = False
            yield "SLAM has caught up"


def _later(before: PlanarTrajectory, now: PlanarTrajectory) -> PlanarTrajectory:
    """The last seconds of both, in order: what comes last is right where stamps go back."""
    first_ns, last_ns = now.stamps_ns[0], now.stamps_ns[-1]
    kept = (before.stamps_ns < first_ns) & (before.stamps_ns > last_ns - REMEMBERED_NS)
    stamps_ns = np.concatenate([before.stamps_ns[kept], now.stamps_ns])
    return PlanarTrajectory(stamps_ns, np.concatenate([before.poses[kept], now.poses]))
