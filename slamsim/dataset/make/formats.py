"""The formats of a sequence besides rosbag2, written alike of clean and of faulty recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import Drive, Float32Array, FloatArray, IntArray, Trajectory
from slamsim.dataset.recipe.sequence import ImageFormat, SequenceSpec
from slamsim.dataset.truth.key_scans import frame_at
from slamsim.guard.numbers import UNIT_WITHIN, is_sound
from slamsim.io.cameras.converting import Layout, convert_images
from slamsim.io.carmen.writer import CarmenFile
from slamsim.io.parquet.images import ImageTables
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.staged_writer import StagedWriter
from slamsim.io.text.kitti import KittiFolder
from slamsim.io.text.tum import write_tum
from slamsim.recording import RawScans, RawStream, Recording, ScanLayout
from slamsim.recording.frames import declared_laser_mounting
from slamsim.sensors.motion import Motion, beam_rays, joined, kept_since
from slamsim.simulation.tails import TruthTail, joined_path

TRUTH_RATE_HZ = 50.0
"""Of poses in the text formats: as often as usual odometry."""
GROUND_TRUTH, ODOMETRY = "ground_truth.tum", "odometry.tum"


class TumPaths(StagedWriter):
    """``ground_truth.tum``, ``T_map_base`` in true time, and ``odometry.tum``, as was published,
    without what is no pose."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._tail = TruthTail(TRUTH_RATE_HZ)
        self._last_ns: int | None = None
        self._truth: list[Trajectory] = []
        self._odometry: list[Trajectory] = []

    def take_truth(self, window: Drive) -> None:
        """The next window of the drive."""
        self._truth.append(self._tail.take(window, self._last_ns).trajectory())
        self._last_ns = int(window.stamps_ns[-1])

    def write(self, part: Recording) -> None:
        """The next part of the recording."""
        for moved in part.odometries[:1]:
            length = np.linalg.norm(moved.quats_xyzw, axis=1)
            sound = is_sound(moved.positions_m) & (np.abs(length - 1.0) < UNIT_WITHIN)
            rows = moved.stamps_ns, moved.positions_m, moved.quats_xyzw
            self._odometry.append(Trajectory(*(column[sound] for column in rows)))

    def _finish(self) -> None:
        """A recording without odometry has no file of it."""
        rest = [] if self._tail.rest is None else [self._tail.rest.trajectory()]
        write_tum(self._folder / GROUND_TRUTH, joined_path([*self._truth, *rest]))
        if self._odometry:
            write_tum(self._folder / ODOMETRY, joined_path(self._odometry))


PARQUET, TUM, KITTI, CARMEN = "parquet", "tum", "kitti", "carmen"
CARMEN_NAME = "log.clf"


class Formats(StagedWriter):
    """What a specification asks for, in folders of their names; a context manager.

    All of them tell what the recording tells, faults included; trajectories called true are.
    """

    def __init__(self, spec: SequenceSpec, folder: Path) -> None:
        super().__init__()
        self._parquet: ParquetLog | None = None
        self._images: ImageTables | None = None
        self._carmen: CarmenFile | None = None
        self._kitti: DeskewedScans | None = None
        self._tum: TumPaths | None = None
        opened = self._open.enter_context
        if "parquet" in spec.formats:
            self._parquet = opened(ParquetLog(folder / PARQUET, spec.index))
            self._images = opened(ImageTables(folder, spec.index))
        if "carmen" in spec.formats:
            self._carmen = opened(CarmenFile(folder / CARMEN / CARMEN_NAME))
        if "kitti" in spec.formats:
            self._kitti = DeskewedScans(opened(KittiFolder(folder / KITTI)))
        if "tum" in spec.formats:
            self._tum = opened(TumPaths(folder / TUM))

    def write(self, part: Recording, true_scan_ns: IntArray, window: Drive) -> None:
        """The next part of the recording, true stamps (n,) of its scans, the drive meanwhile."""
        for log in (self._parquet, self._carmen, self._tum):
            if log is not None:
                log.write(part)
        if self._tum is not None:
            self._tum.take_truth(window)
        if self._kitti is not None:
            self._kitti.write(part, true_scan_ns, window)

    def write_images(self, streams: Iterable[RawStream]) -> None:
        """What cameras took in the next window, which no fault changes."""
        if self._images is not None:
            self._images.write(streams)

    @property
    def images(self) -> Mapping[str, int]:
        """How many images each table of Parquet has."""
        return {} if self._images is None else self._images.counts


IMAGE_FOLDERS: Mapping[ImageFormat, Layout] = {"tum_rgbd": "tum", "euroc": "euroc"}


def write_image_folders(spec: SequenceSpec, log: Path, folder: Path) -> None:
    """The layouts of images that a specification asks for, of a finished recording.

    Raises SlamsimError for a robot without a camera that fits.
    """
    for name, layout in IMAGE_FOLDERS.items():
        if name in spec.formats:
            convert_images(log, folder / name, layout)


_TAIL_NS = 2_000_000_000
"""Motion kept for scans that are not there yet: longer than any scan takes."""


class DeskewedScans:
    """Clouds of a recording's scans, each as seen midway through it, into a KITTI folder.

    Clouds and times are what the recording says: its ranges at the declared angles, freed of the
    robot's true motion by the declared times of the beams and the declared mounting, at the scan's
    stamp. Poses are the true ones of a laser that sits where the recording declares it.
    """

    def __init__(self, folder: KittiFolder) -> None:
        self._folder = folder
        self._T_base_laser: FloatArray | None = None
        self._motion: Motion | None = None

    def write(self, part: Recording, true_stamps_ns: IntArray, window: Drive) -> None:
        """The next part of the recording, true stamps (n,) of its scans, the drive meanwhile."""
        if self._T_base_laser is None:
            self._T_base_laser = declared_laser_mounting(part)
        motion = joined(self._motion, window)
        for scans in part.scans[:1]:
            for number, true_ns in enumerate(true_stamps_ns.tolist()):
                self._write_one(motion, self._T_base_laser, scans, number, true_ns)
        self._motion = kept_since(motion, motion.covered_ns - _TAIL_NS)

    def _write_one(
        self, motion: Motion, T_base_laser: FloatArray, scans: RawScans, number: int, true_ns: int
    ) -> None:
        ranges_m, layout = scans.ranges_m[number], scans.layout(number)
        met = np.flatnonzero(np.isfinite(ranges_m))
        half_ns, beams_ns = _since_first(layout, ranges_m.size, met)
        # Wrong times of the beams may reach beyond the drive.
        first_ns, last_ns = int(motion.drive.stamps_ns[0]), motion.covered_ns
        begin_ns, end_ns = sorted((true_ns, true_ns + 2 * half_ns))
        begin_ns, end_ns = max(begin_ns, first_ns), min(end_ns + 1, last_ns)
        samples = motion.pose_samples(T_base_laser, begin_ns, end_ns)
        T_map_laser = frame_at(samples, min(max(true_ns + half_ns, begin_ns), end_ns))
        instants_ns = np.clip(true_ns + beams_ns, begin_ns, end_ns)
        rays = beam_rays(samples, instants_ns, _directions(layout, met), T_map_laser[:3, 3])
        points = np.zeros((met.size, 4), dtype=np.float32)
        _place(points, rays, ranges_m[met], T_map_laser[:3, :3])
        if scans.intensities is not None and scans.intensities[number].size == ranges_m.size:
            points[:, 3] = scans.intensities[number][met]
        self._folder.add(int(scans.stamps_ns[number]) + half_ns, T_map_laser, points)


def _since_first(layout: ScanLayout, count: int, beams: IntArray) -> tuple[int, IntArray]:
    """Half of a scan as it is declared, and when these beams fired after the first; ns, below 0
    where the last one fires first."""
    beam_dt_ns = round(layout.beam_dt_s * 1e9)
    return beam_dt_ns * (count - 1) // 2, beam_dt_ns * beams


def _directions(layout: ScanLayout, beams: IntArray) -> FloatArray:
    angles_rad = layout.angle_min_rad + beams * layout.angle_step_rad
    return np.stack([np.cos(angles_rad), np.sin(angles_rad)])


@kernel
def _place(
    points: Float32Array, rays: Float32Array, ranges_m: Float32Array, R_map_laser: FloatArray
) -> None:
    """Ends of rays, given from the laser's place in map axes, as seen in the laser's own."""
    for beam in range(rays.shape[0]):
        for axis in range(3):
            value = 0.0
            for i in range(3):
                end = rays[beam, i] + ranges_m[beam] * rays[beam, 3 + i]
                value += R_map_laser[i, axis] * end
            points[beam, axis] = value
