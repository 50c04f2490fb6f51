"""Camera images of a recording: sensor_msgs/Image and CompressedImage."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import CameraImage
from slamsim.guard.errors import InputRefused
from slamsim.io.ros.bag import Bag, open_bag

RAW, PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_MAGIC = {b"\xff\xd8\xff": "image/jpeg", b"\x89PNG": "image/png"}
_CHANNELS: dict[str, tuple[str, int]] = {
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "8UC3": ("u1", 3),
    "16UC1": ("u2", 1),
    "mono16": ("u2", 1),
    "32FC1": ("f4", 1),
}


def camera_images(path: Path, most: int) -> Iterator[CameraImage]:
    """At most so many images of each topic, evenly spread; those that cannot be read are left out.

    Raises InputRefused as ``open_bag`` does.
    """
    with open_bag(path) as bag:
        every = {c.topic: -(-c.messages // most) for c in bag.of_type(RAW, PACKED)}
        seen = dict.fromkeys(every, 0)
        for topic, _, data in bag.received(set(every)) if every else ():
            seen[topic] += 1
            if (seen[topic] - 1) % every[topic] == 0:
                with suppress(InputRefused, ValueError):
                    yield _image(bag, topic, data)


def _image(bag: Bag, topic: str, data: bytes) -> CameraImage:
    """Raises InputRefused for what is no message, ValueError for an image of another form."""
    message = bag.deserialize(topic, data)
    stamp = message.header.stamp
    stamp_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    if hasattr(message, "encoding"):
        return CameraImage(topic, stamp_ns, pixels=_pixels(message), encoding=message.encoding)
    packed = bytes(message.data)
    media_type = next((kind for magic, kind in _MAGIC.items() if packed.startswith(magic)), "")
    if not media_type:
        raise ValueError("neither JPEG nor PNG")
    return CameraImage(topic, stamp_ns, packed, media_type)


def _pixels(message: Any) -> NDArray[Any]:
    if message.encoding not in _CHANNELS:
        raise ValueError(f"images of encoding {message.encoding!r} are not known")
    kind, channels = _CHANNELS[message.encoding]
    dtype = np.dtype((">" if message.is_bigendian else "<") + kind)
    rows, columns, step = int(message.height), int(message.width), int(message.step)
    used = columns * channels * dtype.itemsize
    data = np.asarray(message.data, dtype=np.uint8)
    if not rows or not columns or step < used or data.size < step * rows:
        raise ValueError("too few bytes for an image of its size")
    plain = np.ascontiguousarray(data[: step * rows].reshape(rows, step)[:, :used])
    pixels = plain.view(dtype).astype(dtype.newbyteorder("="))
    return pixels.reshape(rows, columns, channels) if channels > 1 else pixels
