"""Planar scans of a depth camera: for a robot on a floor it is one more lidar, with a narrow view.

A beam is the median of the pixels that look its way and hardly up or down. Noise and edges of
surfaces, to which the nearest of them (as in depthimage_to_laserscan) would give way, do not count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import wrap_angle, xyzw_from_matrix
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.io.open import OpenRecording
from slamsim.io.selection import Selection, selected
from slamsim.perception.corners import rays_xy_at
from slamsim.perception.recorded import mount_of
from slamsim.recording import RawScans, ScanLayout, TransformEdge

MOST_DEPTH_M = 4.0
"""Farther away one depth of a D435 is off by more than a cell of a map, 0.05 m (0.003 / m times
its square). In ``rooms`` and ``labyrinth`` 4 m are better than 8 m, by a third."""
BAND_RAD = np.radians(3.0)
"""Up and down from level. In ``rooms`` bands of 0.3, 0.8, 3 and 6 degrees give 7.9, 4.5, 2.7 and
3.5 mm, and the nearest of all that is 0.1 to 0.7 m above the floor 122 mm; in ``labyrinth`` those
of 0.8, 3 and 6 degrees 11, 9.5 and 7.8 mm."""
STEP_RAD = np.radians(0.35)
"""Between beams, no less than between pixels at the middle of the image: half a cell of a map at
4 m."""
FLOOR_M = 0.1
"""What is lower above the base frame may be the floor; for a camera lower than 0.15 m, what is
0.05 m lower than it."""
MOST_PIXELS = 50
"""Of a beam, evenly spread: neighbours share their noise."""
LEAST_KNOWN = 1.0 / 3.0
"""Of the pixels of a beam so many must have a depth."""
LEAST_IMAGES = 2
MOST_LEANING_RAD = np.radians(30.0)
"""What is seen so far from level is a floor or a ceiling soon."""


def widest_depth(cameras: Cameras) -> str:
    """The topic of depth images with the widest view, of those the one with the most images; empty
    without any. What is aligned to the pixels of another imager has a part of them alone."""

    def order(topic: CameraTopic) -> tuple[bool, bool, int]:
        return topic.topic not in cameras.infos, "aligned" in topic.topic, -topic.messages

    first = min(cameras.of_kind("depth"), key=order, default=None)
    return "" if first is None else first.topic


def with_depth_scans(
    opened: OpenRecording, topic: str, K: FloatArray | None = None, progress: Progress = silent
) -> OpenRecording:
    """The recording with scans cut out of a topic of depth images in the place of all others.

    K: (3, 3) in the place of what the recording claims.

    Raises NotFound without CameraInfo, InputRefused for a camera whose place is unknown or that
    looks up or down alone, or with fewer than two images that can be used.
    """
    recording = opened.recording
    stamps_ns, received_ns, rows = list[int](), list[int](), list[Float32Array]()
    damaged = list[str]()
    with open_cameras(opened.path) as cameras:
        about = cameras.topics[topic]
        given = None if K is None else CameraModel(about.width, about.height, K)
        model = given or cameras.model(topic)
        frame = about.frame_id
        T_base_camera = mount_of(opened.path, topic, frame, recording)
        beams = depth_beams(model, T_base_camera)
        if beams is None:
            raise InputRefused(opened.path, "looks up or down alone", f"topic {topic}")
        for number, image in enumerate(cameras.encoded({topic}), 1):
            progress(number, about.messages)
            try:
                rows.append(beams.ranges_m(image.decoded().pixels))
            except InputRefused as refusal:
                damaged.append(refusal.reason)
                continue
            stamps_ns.append(image.stamp_ns)
            received_ns.append(image.received_ns)
    told = f"{len(damaged):,} of {about.messages:,} images cannot be used" if damaged else ""
    told += f" ({damaged[0]})" if damaged else ""
    if len(rows) < LEAST_IMAGES:
        reason = told or f"{len(rows)} images; {LEAST_IMAGES} are needed"
        raise InputRefused(opened.path, reason, f"topic {topic}")
    scans = RawScans(
        topic=topic,
        frame_ids=(f"{frame}_level",),
        stamps_ns=np.array(stamps_ns, dtype=np.int64),
        received_ns=np.array(received_ns, dtype=np.int64),
        layouts=(beams.layout,),
        layout_of=np.zeros(len(rows), dtype=np.int32),
        ranges_m=np.array(rows, dtype=np.float32).reshape(len(rows), -1),
        in_order=False,
        note=f"cut out of depth images: {beams.in_words}",
    )
    at_ns = scans.stamps_ns[:1]
    level = TransformEdge(
        *("/tf_static", frame, f"{frame}_level", True, at_ns, at_ns),
        positions_m=np.zeros((1, 3)),
        quats_xyzw=xyzw_from_matrix(T_base_camera[:3, :3].T)[None],
    )
    changed = replace(
        recording,
        streams=(scans, *recording.streams),
        transforms=(*recording.transforms, level),
        anomalies=(*recording.anomalies, *([f"{topic}: {told}"] if told else ())),
    )
    alone = selected(changed, Selection(scans=(topic,)), opened.path)
    return replace(opened, contents=replace(opened.contents, recording=alone))


@dataclass(frozen=True, slots=True, eq=False)
class DepthBeams:
    """Evenly spread beams, and the pixels of which each one is the median.

    pixels: (b, k) indices into the image, -1 for none. level: (b, k) level distance for each metre
    of depth; rise: (b, k) by how much what they see is higher than the camera, likewise. above_m:
    height of the camera above the base frame.
    """

    layout: ScanLayout
    in_words: str
    pixels: IntArray
    level: FloatArray
    rise: FloatArray
    above_m: float

    def ranges_m(self, depth_m: Float32Array) -> Float32Array:
        """(b,) of an image (h, w): nan where too few pixels have a depth, or show more than
        the floor; inf where it is farther away than is used."""
        depths = depth_m.ravel()[self.pixels].astype(np.float64)
        some = (self.pixels >= 0) & (depths > 0.0)
        some &= self.rise * depths >= -max(self.above_m - FLOOR_M, 0.5 * FLOOR_M)
        ranges_m = np.sort(np.where(some, depths * self.level, np.inf), axis=1)
        counts = np.count_nonzero(some, axis=1)
        middle = np.maximum(counts - 1, 0) // 2
        medians_m = np.take_along_axis(ranges_m, middle[:, None], axis=1)[:, 0]
        medians_m[medians_m > MOST_DEPTH_M] = np.inf
        is_known = counts > LEAST_KNOWN * np.count_nonzero(self.pixels >= 0, axis=1)
        return np.where(is_known, medians_m, np.nan).astype(np.float32)


def depth_beams(model: CameraModel, T_base_camera: FloatArray) -> DepthBeams | None:
    """How scans are cut out of the images of a camera; None where it looks up or down alone.

    T_base_camera: (4, 4) of the optical frame. Of a camera that leans the band is as near to level
    as the middle of its image sees.
    """
    v, u = (each.ravel() for each in np.mgrid[0 : model.height, 0 : model.width])
    rays_xy = rays_xy_at(model, np.column_stack([u, v]).astype(np.float32))
    rays = np.column_stack([rays_xy, np.ones(len(u))]) @ T_base_camera[:3, :3].T
    level = np.hypot(rays[:, 0], rays[:, 1])
    up_rad = np.arctan2(rays[:, 2], level)
    ahead = float(np.arctan2(T_base_camera[1, 2], T_base_camera[0, 2]))
    left_rad = wrap_angle(np.arctan2(rays[:, 1], rays[:, 0]) - ahead)
    in_middle = up_rad[np.abs(left_rad) < BAND_RAD]
    if not np.isfinite(in_middle).any():
        return None
    lowest, highest = np.nanmin(in_middle) + BAND_RAD, np.nanmax(in_middle) - BAND_RAD
    centre = float(np.clip(0.0, min(lowest, highest), highest))
    if abs(centre) > MOST_LEANING_RAD:
        return None
    used = np.flatnonzero(np.abs(up_rad - centre) <= BAND_RAD)
    first, last = float(left_rad[used].min()), float(left_rad[used].max())
    step = max(STEP_RAD, 1.0 / float(model.focal_px.min()))
    count = max(int((last - first) / step), 1)
    beam = np.minimum(((left_rad[used] - first) / step).astype(np.int64), count - 1)
    first += ahead + 0.5 * step
    pixels = _table(used, beam, count)
    words = f"{np.degrees(centre):+.1f} deg from level, {np.degrees(step):.2g} deg a beam"
    layout = ScanLayout(first, first + (count - 1) * step, step, 0.0, 0.0, 0.0, MOST_DEPTH_M)
    return DepthBeams(
        layout, words, pixels, level[pixels], rays[pixels, 2], float(T_base_camera[2, 3])
    )


def _table(pixels: IntArray, beam: IntArray, count: int) -> IntArray:
    """(count, k) the pixels of each beam, evenly thinned to ``MOST_PIXELS``, -1 for no more."""
    order = np.argsort(beam, kind="stable")
    ends = np.searchsorted(beam[order], np.arange(count + 1))
    found = np.full((count, MOST_PIXELS), -1)
    for k, (begin, end) in enumerate(pairwise(ends.tolist())):
        mine = pixels[order[begin:end]]
        chosen = mine[:: max(-(-len(mine) // MOST_PIXELS), 1)]
        found[k, : len(chosen)] = chosen
    return found
