"""A log as another drive of the same robot: backward, mirrored, thinned, noisier.

    PYTHONPATH=. python tests/support/log_variants.py LOG RELATIONS [--backward] [--mirrored]
        [--keep 3] [--leave-out 10] [--noise 0.01]

maps it, and tells the errors of the relations that are left. What was not tuned on a log that was
recorded forward should not mind: loops close elsewhere, and doubts arise at other places.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.result import SlamResult
from slamsim.core.types import Log, PlanarTrajectory, Scan
from slamsim.evaluate.relations import RelationScores, score_relations
from slamsim.io.open import read_log
from slamsim.io.text.relations import Relations, read_relations
from slamsim.slam.session import run_slam

MIRROR = np.array([1.0, -1.0, -1.0])
"""Of a pose in the plane, seen from below."""


@dataclass(frozen=True)
class Variant:
    """keep: every so many scans one; leave_out: of so many scans the last, 0 for none. noise_m: so
    much more of it in each range."""

    backward: bool = False
    mirrored: bool = False
    keep: int = 1
    leave_out: int = 0
    noise_m: float = 0.0

    def of(self, log: Log) -> Log:
        """The log so. Only of odometry and of scans without beam times, as of CARMEN."""
        assert log.imu is None and log.encoders is None and log.odometry is not None
        assert not any(scan.geometry.beam_dt_ns for scan in log.scans)
        rng = np.random.default_rng(7)
        scans = [self._noisier(scan, rng) for scan in self._kept(list(log.scans))]
        odometry, T_base_laser = log.odometry, log.T_base_laser
        if self.mirrored:
            scans = [_mirrored(scan) for scan in scans]
            odometry = PlanarTrajectory(odometry.stamps_ns, odometry.poses * MIRROR)
            below = np.diag([1.0, -1.0, 1.0, 1.0])
            T_base_laser = below @ T_base_laser @ below
        if self.backward:
            sum_ns = _sum_ns(log)
            scans = [_backward(scan, sum_ns) for scan in scans[::-1]]
            odometry = PlanarTrajectory(sum_ns - odometry.stamps_ns[::-1], odometry.poses[::-1])
        return replace(log, scans=scans, odometry=odometry, T_base_laser=T_base_laser)

    def scores(self, slam: SlamResult, log: Log, relations: Relations) -> RelationScores:
        """Errors of the relations between scans that were kept. log: as it was."""
        kept_ns = np.array([scan.stamp_ns for scan in self._kept(list(log.scans))])
        ends_ns = np.stack([relations.from_ns, relations.to_ns])
        kept = np.isin(ends_ns, kept_ns).all(axis=0)
        if self.backward:
            ends_ns = _sum_ns(log) - ends_ns
        T_from_to = relations.planar[kept] * (MIRROR if self.mirrored else 1.0)
        from_ns, to_ns = ends_ns[:, kept]
        return score_relations(slam.trajectory, from_ns, to_ns, T_from_to)

    def _kept(self, scans: list[Scan]) -> list[Scan]:
        scans = scans[:: self.keep]
        if self.leave_out:
            scans = [s for n, s in enumerate(scans, 1) if n % self.leave_out]
        return scans

    def _noisier(self, scan: Scan, rng: np.random.Generator) -> Scan:
        if not self.noise_m:
            return scan
        noisy_m = scan.ranges_m + rng.normal(0.0, self.noise_m, scan.ranges_m.shape)
        measured = scan.ranges_m < 0.5 * np.nanmax(scan.ranges_m, initial=0.0)
        return replace(scan, ranges_m=np.where(measured, noisy_m, scan.ranges_m).astype(np.float32))


def _mirrored(scan: Scan) -> Scan:
    """Beams in the order in which they fired, now clockwise."""
    of = scan.geometry
    turned = replace(of, angle_min_rad=-of.angle_min_rad, angle_step_rad=-of.angle_step_rad)
    return replace(scan, geometry=turned)


def _backward(scan: Scan, sum_ns: int) -> Scan:
    """The last beam fires first."""
    of = scan.geometry
    last_rad = of.angle_min_rad + (of.beam_count - 1) * of.angle_step_rad
    return replace(
        scan,
        stamp_ns=sum_ns - scan.stamp_ns,
        geometry=replace(of, angle_min_rad=last_rad, angle_step_rad=-of.angle_step_rad),
        ranges_m=scan.ranges_m[::-1].copy(),
    )


def _sum_ns(log: Log) -> int:
    """Of a stamp and the same one backward."""
    scans = list(log.scans)
    return scans[0].stamp_ns + scans[-1].stamp_ns


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("relations", type=Path)
    parser.add_argument("--backward", action="store_true")
    parser.add_argument("--mirrored", action="store_true")
    parser.add_argument("--keep", type=int, default=1)
    parser.add_argument("--leave-out", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.0)
    given = parser.parse_args()
    variant = Variant(given.backward, given.mirrored, given.keep, given.leave_out, given.noise)
    log, relations = read_log(given.log), read_relations(given.relations)
    began_s = time.process_time()
    slam = run_slam(variant.of(log), SlamConfig())
    scores = variant.scores(slam, log, relations)
    told = {event.kind for event in slam.events} & {"kidnapped", "torn", "unrefined"}
    sys.stdout.write(
        f"{scores.all.translation_mean_m:.4f} m, {scores.all.rotation_mean_deg:.3f} deg over "
        f"{scores.all.count} relations; {', '.join(sorted(told)) or 'nothing'} told; "
        f"{time.process_time() - began_s:.0f} s\n"
    )


if __name__ == "__main__":
    _main()
