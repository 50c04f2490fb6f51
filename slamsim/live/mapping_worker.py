"""The process that maps beside a live robot: ``python -m slamsim.live.mapping_worker``.

When its parent is gone, standard input ends, and so does it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from queue import Empty, SimpleQueue
from typing import cast

import numpy as np

from slamsim.guard.errors import SlamsimError
from slamsim.live.mapping import Begin, Finish, Finished, MapNews, Placed, Ready, Taken
from slamsim.live.slam_feed import Arrived, SlamFeed
from slamsim.process.module_process import answers, listen, requests, tell
from slamsim.slam.frontend.tracking import Step
from slamsim.slam.mapping.growing import GrowingMap
from slamsim.slam.online.async_back_end import AsyncBackEnd
from slamsim.slam.session import SlamSession, open_session

MAP_PERIOD_S = 1.0
"""Of the maps that are published: what was seen is on the map a second later."""


class _Worker:
    """One map after the other."""

    def __init__(self) -> None:
        self._stream = answers()
        self._messages: SimpleQueue[object] = SimpleQueue()
        self._session: SlamSession | None = None

    def run(self) -> None:
        listen(requests(), self._messages.put)
        while True:
            try:
                message = self._messages.get(timeout=MAP_PERIOD_S)
            except Empty:
                self._tell_map()
                continue
            try:
                self._heed(message)
            except SlamsimError as error:
                self._tell(error)

    def _tell(self, answer: object) -> None:
        tell(self._stream, answer)

    def _heed(self, message: object) -> None:
        if isinstance(message, Begin):
            self._begin(message)
        elif isinstance(message, Finish):
            self._finish()
        else:
            self._take(cast(tuple[Arrived, ...], message))
            self._tell(Taken())

    def _begin(self, begin: Begin) -> None:
        if self._session is not None:
            self._session.close()
        self._session = open_session(begin.slam, begin.T_base_laser, begin.T_base_imu, begin.start)
        self._feed, self._map = SlamFeed(begin.limit), GrowingMap(begin.mapping)
        self._told_version, self._told_s, self._last_ns = 0, 0.0, 0
        self._tell(Ready())

    def _take(self, streams: Sequence[Arrived]) -> None:
        session = self._session
        assert session is not None
        for scan, motion in self._feed.take(streams):
            step = session.step(scan, motion)
            self._last_ns = scan.stamp_ns
            self._tell(self._placed(scan.stamp_ns, step, session))
            if step is not None:
                self._draw(step, session)
        self._tell_map()

    def _placed(self, stamp_ns: int, step: Step | None, session: SlamSession) -> Placed:
        keeper = session.keeper
        assert isinstance(keeper, AsyncBackEnd)
        count = keeper.taken, keeper.closures
        if step is None:
            return Placed(stamp_ns, np.full(3, np.nan), None, *count, ())
        events = tuple(event.words for event in step.events)
        return Placed(stamp_ns, step.T_map_base, step.status, *count, events)

    def _draw(self, step: Step, session: SlamSession) -> None:
        self._map.add(step)
        changed = session.keeper.changed()
        if changed is not None:
            self._map.move(*changed)

    def _tell_map(self) -> None:
        if self._session is None or not len(self._map) or self._map.version == self._told_version:
            return
        if time.monotonic() - self._told_s < MAP_PERIOD_S:
            return
        self._told_version, self._told_s = self._map.version, time.monotonic()
        self._tell(MapNews(self._last_ns, self._map.grid(), self._map.poses))

    def _finish(self) -> None:
        session = self._session
        if session is None:
            raise SlamsimError("there is no map to finish")
        result = session.finish()
        self._map.settle(result.trajectory)
        keyframes, closures = len(result.graph.keyframes), result.closures_accepted
        self._tell(Finished(result.trajectory, self._map.grid(), keyframes, closures))


if __name__ == "__main__":
    _Worker().run()
