"""The rotating lidar: each beam leaves at its own instant, from where the laser then is."""

from __future__ import annotations

import numpy as np

from slamsim.config.lidar import LidarConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import Float32Array, FloatArray, IntArray, ScanGeometry
from slamsim.guard.numbers import require_rigid
from slamsim.sensors import lidar_errors
from slamsim.sensors.base import Site
from slamsim.sensors.clock import StreamClock
from slamsim.sensors.motion import Motion, PoseOverride, PoseSamples, as_mounted, beam_rays
from slamsim.sensors.panes import past_panes
from slamsim.sensors.readings import BeamTruth, ScanBatch
from slamsim.sensors.scene import Hits, Scene

BEAMS_PER_BATCH = 35_000


def scan_geometry(config: LidarConfig, frame_id: str = "laser_link") -> ScanGeometry:
    """What all scans of this lidar share."""
    return ScanGeometry(
        angle_min_rad=float(np.radians(config.angle_min_deg)),
        angle_step_rad=float(np.radians(config.angle_step_deg)),
        beam_count=config.beam_count,
        beam_dt_ns=config.beam_dt_ns,
        range_min_m=config.range_min_m,
        range_max_m=config.range_max_m,
        frame_id=frame_id,
    )


class Lidar:
    """A lidar mounted at ``T_base_laser`` (4 x 4, any orientation) in a world of triangles.

    Beams are cast in batches of whole scans from the interpolated poses of the laser, on
    ``site.threads`` threads; neither changes a byte of the result. The robot itself is not seen.
    override: how the laser truly moves and looks, where that is not as it is mounted. with_truth:
    keep the surface that each beam truly met first. name: of its random streams and its clock.
    """

    def __init__(
        self,
        config: LidarConfig,
        T_base_laser: FloatArray,
        site: Site,
        override: PoseOverride = as_mounted,
        with_truth: bool = False,
        name: str = "lidar",
        frame_id: str = "laser_link",
    ) -> None:
        require_rigid("T_base_laser", T_base_laser)
        self.geometry = scan_geometry(config, frame_id)
        self._config, self._T_base_laser, self._override = config, T_base_laser, override
        self._scene = Scene(site.mesh, floor_reach_m=config.range_max_m, threads=site.threads)
        meets_panes = config.meets_panes and site.appearance is not None
        self._looks = site.appearance() if meets_panes and site.appearance else None
        self._clock = StreamClock(config, site.start_ns, site.seed, name)
        self._streams = lidar_errors.EffectStreams(
            noise=random_stream(site.seed, name, "noise"),
            dropout=random_stream(site.seed, name, "dropout"),
            mixed=random_stream(site.seed, name, "mixed"),
        )
        angles_rad = self.geometry.angles_rad()
        self._directions = np.stack([np.cos(angles_rad), np.sin(angles_rad)])
        self._with_truth = with_truth
        self._next = 0

    @property
    def needed_ns(self) -> int:
        """The earliest instant that later scans look at."""
        return self._clock.needed_ns(self._next)

    def sense(self, motion: Motion) -> ScanBatch:
        """All scans that the motion covers to their last beam and that were not given yet."""
        last_start_ns = motion.covered_ns - self.geometry.duration_ns
        samples = self._clock.samples_until(self._next, last_start_ns)
        self._next += samples.size
        true_ns = self._clock.instants_ns(samples)
        ranges_m, strengths, truth = self.scan_batch(motion, true_ns)
        stamps_ns = self._clock.stamps_ns(true_ns)
        arrival_ns = self._clock.arrivals_ns(true_ns + self.geometry.duration_ns)
        there = self._clock.arrived(true_ns.size)
        whole = ScanBatch(self.geometry, stamps_ns, true_ns, arrival_ns, ranges_m, strengths, truth)
        return whole.select(there)

    def scan_batch(
        self, motion: Motion, true_ns: IntArray
    ) -> tuple[Float32Array, Float32Array | None, BeamTruth | None]:
        """(k, beams) ranges, intensities if configured, and truth if asked for, of scans that
        begin at true_ns (k,).

        Advances the random streams by k scans. Raises OutsideTimeRange for uncovered instants.
        """
        shape = (true_ns.size, self.geometry.beam_count)
        ranges_m = np.empty(shape, dtype=np.float32)
        strengths = np.empty(shape, dtype=np.float32) if self._config.intensities else None
        truth = _no_truth(shape) if self._with_truth else None
        scans = max(BEAMS_PER_BATCH // self.geometry.beam_count, 1)
        for first in range(0, true_ns.size, scans):
            part = slice(first, first + scans)
            middle, hits = self._true_hits(motion, true_ns[part])
            if truth is not None:
                _set(truth.select(part), middle)
            reading = lidar_errors.measured(hits, self._config, self._streams)
            ranges_m[part] = reading.reshape(-1, shape[1])
            if strengths is not None:
                strengths[part] = lidar_errors.strengths(hits, reading).reshape(-1, shape[1])
        return ranges_m, strengths, truth

    def _true_hits(self, motion: Motion, scan_ns: IntArray) -> tuple[Hits, Hits]:
        """What the beams of these scans meet without noise: their middles, and with their width
        at edges."""
        beam_ns = (scan_ns[:, None] + self.geometry.offsets_ns()).ravel()
        directions = np.tile(self._directions, scan_ns.size)
        samples = self._override(
            motion.pose_samples(self._T_base_laser, int(beam_ns[0]), int(beam_ns[-1]))
        )
        true, hits = self._cast(samples, beam_ns, directions)
        mixing = self._config.mixed
        if mixing.divergence_mrad == 0.0:
            return true, hits
        beside = lidar_errors.beside_a_jump(hits, self.geometry.beam_count, mixing.min_gap_m)
        return true, self._with_edges(hits, np.flatnonzero(beside), samples, beam_ns, directions)

    def _with_edges(
        self,
        hits: Hits,
        beside: IntArray,
        samples: PoseSamples,
        beam_ns: IntArray,
        directions: FloatArray,
    ) -> Hits:
        """The hits with those beams beside an edge that straddle it cast in their full width."""
        sub_rays = lidar_errors.sub_ray_directions(self._config.mixed.divergence_mrad)

        def parts(beams: IntArray, sub_rays: FloatArray) -> Hits:
            turned = lidar_errors.turned(directions[:, beams], sub_rays)
            return self._cast(samples, np.repeat(beam_ns[beams], sub_rays.shape[1]), turned)[1]

        # Most beams beside an edge miss it: their two rims are cheaper than all their parts.
        rims = parts(beside, sub_rays[:, [0, -1]]).surfaces.reshape(-1, 2)
        two = beside[(rims != hits.surfaces[beside][:, None]).any(axis=1)]
        middle = Hits(
            hits.ranges_m[two],
            hits.cos_incidence[two],
            hits.surfaces[two],
            hits.triangles[two],
        )
        seen = lidar_errors.mixed(
            middle, parts(two, sub_rays), self._config.mixed, self._streams.mixed
        )
        ranges_m, cosines = hits.ranges_m.copy(), hits.cos_incidence.copy()
        ranges_m[two], cosines[two] = seen.ranges_m, seen.cos_incidence
        return Hits(ranges_m, cosines, hits.surfaces, hits.triangles)

    def _cast(
        self, samples: PoseSamples, beam_ns: IntArray, directions: FloatArray
    ) -> tuple[Hits, Hits]:
        """The surfaces that beams meet, and what the lidar takes for them, which panes change."""
        rays = beam_rays(samples, beam_ns, directions, self._scene.origin_m)
        hits = self._scene.cast(rays)
        return hits, hits if self._looks is None else past_panes(
            self._scene, rays, hits, self._looks
        )


def _no_truth(shape: tuple[int, int]) -> BeamTruth:
    """To be set."""
    return BeamTruth(
        np.empty(shape, dtype=np.float32),
        np.empty(shape, dtype=np.float32),
        np.empty(shape, dtype=np.uint32),
    )


def _set(truth: BeamTruth, hits: Hits) -> None:
    shape = truth.ranges_m.shape
    truth.ranges_m[:] = hits.ranges_m.reshape(shape)
    truth.cos_incidence[:] = hits.cos_incidence.reshape(shape)
    truth.triangles[:] = hits.triangles.reshape(shape)
