"""Scans in the order in which they were recorded, without those that are stamped in the future."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from slamsim.core.types import Log, Scan
from slamsim.guard.errors import SlamsimError
from slamsim.slam.frontend.motion import Odometry


class NothingSeen(SlamsimError):
    """Scans that show nothing, so that no lidar can map."""


class InOrder:
    """Iterates over scans, once. A scan whose stamp the next one falls behind, though that is
    later than all before both, has a wrong stamp: believed, it would cost all scans after it."""

    def __init__(self, scans: Iterable[Scan]) -> None:
        self._scans = iter(scans)
        self.left_out = 0
        """Scans with such a stamp so far."""

    def __iter__(self) -> Iterator[Scan]:
        latest_ns: int | None = None
        scan = next(self._scans, None)
        while scan is not None:
            after = next(self._scans, None)
            if after is not None and _overtakes(scan, after, latest_ns):
                self.left_out += 1
            else:
                latest_ns = scan.stamp_ns if latest_ns is None else max(latest_ns, scan.stamp_ns)
                yield scan
            scan = after

    def warnings(self) -> tuple[str, ...]:
        """What to tell of those left out."""
        if not self.left_out:
            return ()
        return (f"{self.left_out} scans left out: stamped later than the scans that follow them",)


def _overtakes(scan: Scan, after: Scan, latest_ns: int | None) -> bool:
    return scan.stamp_ns > after.stamp_ns and (latest_ns is None or after.stamp_ns > latest_ns)


def nothing_to_track(log: Log, odometry: Odometry | None) -> str:
    """Why no scan of a log could be used."""
    if len(log.scans) == 0:
        return f"{log.name}: no laser scans in the log; SLAM needs them"
    covered = "nothing"
    if odometry is not None:
        covered = f"{odometry.stamps_ns[0]}..{odometry.stamps_ns[-1]} ns"
    return (
        f"{log.name}: none of the {len(log.scans)} scans could be used; "
        f"odometry covers {covered}: is it on another clock?"
    )


def nothing_seen(scans: int) -> str:
    """Why so many scans, though tracked, make no map."""
    return (
        f"none of the {scans} scans shows a surface: their returns are too few, invalid or all "
        "at the maximum range; there is nothing to map"
    )
