"""Camera images and CameraInfo as they change in a copy: one image at a time is in memory."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.changes import CutShort, PixelChange
from slamsim.cameras.codecs.depth import decode_compressed_depth, encode_compressed_depth
from slamsim.cameras.codecs.pictures import decode_picture, encode_jpeg, encode_png
from slamsim.cameras.codecs.raw import encoding_of
from slamsim.cameras.frames import CameraClaim, readout_key
from slamsim.cameras.survey import CameraSurvey
from slamsim.core.types import IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.pictures import JPEG_MAGIC
from slamsim.io.ros.images import stamp_of, without_transport
from slamsim.recording import Origin, Recording
from slamsim.recording.schemas import Schema

_JPEG_QUALITY = 95
"""Of images that are packed again: what is lost then is less than what was lost before."""
_SCHEMA = Schema("sensor_msgs/msg/Image", ())
_INFO_TOPIC = "topic "
"""Before the name in what ``CameraClaim.source`` says of a recording."""


@dataclass(frozen=True, slots=True, eq=False)
class ImagesPart:
    """Images as a copy compares them with those that were read: by stamps and places."""

    camera: CameraSurvey

    schema = _SCHEMA

    @property
    def topic(self) -> str:
        return self.camera.topic

    @property
    def frame_ids(self) -> tuple[str, ...]:
        return (self.camera.frame_id,)

    @property
    def stamps_ns(self) -> IntArray:
        return self.camera.stamps_ns

    @property
    def received_ns(self) -> IntArray:
        return self.camera.received_ns

    @property
    def origin(self) -> Origin:
        return Origin.in_order(self.camera.read_topic, self.camera.numbers)

    def repaint(self, message: Any, row: int) -> None:
        """Change the image of a message; the pixels of one that is damaged stay as they are.

        Raises SlamsimError for pixels that cannot be changed in their encoding.
        """
        number = int(self.camera.numbers[row])
        try:
            for change in self.camera.changes:
                _repaint(message, change, number)
        except ValueError as error:
            name = f"image {number} of {self.camera.read_topic}"
            raise SlamsimError(f"{name} cannot be changed: {error}") from None


def _repaint(message: Any, change: PixelChange | CutShort, number: int) -> None:
    if isinstance(change, CutShort):
        message.data = change.of_data(np.array(message.data, dtype=np.uint8), number)
    elif hasattr(message, "encoding"):
        message.data = _raw(message, change, number)
    else:
        packed = _packed(str(message.format), bytes(message.data), change, number)
        message.data = np.frombuffer(packed, dtype=np.uint8)


def _raw(message: Any, change: PixelChange, number: int) -> NDArray[np.uint8]:
    """The data of a sensor_msgs/Image in its own encoding and byte order, as they are if they are
    cut off."""
    encoding = encoding_of(str(message.encoding))
    if encoding.kind == "colour" and encoding.channels < 3:
        raise ValueError(f"the encoding {message.encoding} mixes colours of neighbours")
    dtype = np.dtype((">" if message.is_bigendian else "<") + encoding.dtype)
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.array(message.data, dtype=np.uint8)
    used = width * encoding.channels * dtype.itemsize
    if not height * used or step < used or data.size < height * step:
        return data
    rows = data[: height * step].reshape(height, step)
    shape = (height, width, encoding.channels)[: 2 + (encoding.channels > 1)]
    pixels = np.ascontiguousarray(rows[:, :used]).view(dtype).reshape(shape)
    changed = np.ascontiguousarray(change.of_pixels(pixels, number), dtype)
    rows[:, :used] = changed.reshape(height, -1).view(np.uint8)
    return data


def _packed(told: str, data: bytes, change: PixelChange, number: int) -> bytes:
    """The data of a CompressedImage, packed as it was, and as it is if it cannot be decoded."""
    is_depth = "compressedDepth" in told
    try:
        before = decode_compressed_depth(told, data) if is_depth else decode_picture(data)
    except ValueError:
        return data
    pixels: Any = change.of_pixels(before, number)
    if is_depth:
        _, quotient, shift = struct.unpack_from("<iff", data)
        most_m = quotient / (1.0 - shift) if pixels.dtype.kind == "f" and shift < 1.0 else 10.0
        codec: Any = "rvl" if told.rstrip().endswith("rvl") else "png"
        return encode_compressed_depth(pixels, codec, most_m)[1]
    is_jpeg = data.startswith(JPEG_MAGIC)
    return encode_jpeg(pixels, _JPEG_QUALITY) if is_jpeg else encode_png(pixels)


@dataclass(frozen=True, slots=True, eq=False)
class InfoChange:
    """What changes in the messages of a CameraInfo topic.

    claim: what they say from now on, None for as before. before_ns: (n,) ascending stamps of its
    images, and by how much each of them is later now, by_ns.
    """

    claim: CameraClaim | None
    before_ns: IntArray
    by_ns: IntArray

    def patch(self, message: Any) -> None:
        """Change a message; a stamp goes with that of the first image that is not earlier."""
        stamp_ns = stamp_of(message)
        if self.before_ns.size and self.by_ns.any():
            at = int(np.clip(np.searchsorted(self.before_ns, stamp_ns), 0, self.by_ns.size - 1))
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamp_ns + int(self.by_ns[at]), 1_000_000_000)
        if self.claim is not None:
            _set_claim(message, self.claim)


def _set_claim(message: Any, claim: CameraClaim) -> None:
    message.width, message.height = claim.width, claim.height
    message.distortion_model = claim.distortion_model
    numbers = {"d": claim.coefficients, "k": claim.K, "r": claim.R, "p": claim.P}
    for name, values in numbers.items():
        known = name if hasattr(message, name) else name.upper()  # ROS 1 has capitals
        setattr(message, known, np.array(values, dtype=np.float64).ravel())


def told_shutters(read: Recording, edited: Recording) -> dict[str, str]:
    """Custom data that say otherwise how long shutters take."""
    before = {camera.topic: camera.claim for camera in read.cameras}
    found = {}
    for camera in edited.cameras:
        known, claim = before.get(camera.topic), camera.claim
        if known is None or claim is None or claim.readout_s in (None, known.readout_s):
            continue
        found[readout_key(without_transport(camera.topic))] = f"{claim.readout_s:.7g}"
    return found


def info_changes(read: Recording, edited: Recording) -> dict[str, InfoChange]:
    """By topic: what is claimed otherwise, and stamps that moved with those of all images."""
    before = {camera.topic: camera for camera in read.cameras}
    found = {}
    for camera in edited.cameras:
        known, claim = before.get(camera.topic), camera.claim
        if known is None or claim is None or not claim.source.startswith(_INFO_TOPIC):
            continue
        another = claim if claim is not known.claim else None
        same = camera.numbers.size and np.array_equal(camera.numbers, known.numbers)
        by_ns = camera.stamps_ns - known.stamps_ns if same else np.zeros(0, dtype=np.int64)
        if another is not None or by_ns.any():
            order = np.argsort(known.stamps_ns if same else by_ns)
            times_ns = known.stamps_ns[order] if same else by_ns
            change = InfoChange(another, times_ns, by_ns[order])
            found[claim.source.removeprefix(_INFO_TOPIC)] = change
    return found
