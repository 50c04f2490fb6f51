"""Camera messages of ROS: sensor_msgs/Image, CompressedImage (compressedDepth too), CameraInfo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.depth import decode_compressed_depth
from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.cameras.codecs.raw import Kind, RawImage, decode_raw
from slamsim.cameras.frames import CameraClaim, EncodedFrame, readout_key
from slamsim.guard.errors import shown
from slamsim.guard.pictures import JPEG_MAGIC, PNG_MAGIC
from slamsim.recording.frames import frame_name

RAW, PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
_DEPTH_TRANSPORT = "compressedDepth"
_Decoded = tuple[Kind, NDArray[Any]]


def stamp_of(message: Any) -> int:
    """Nanoseconds of a header's stamp."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def frame_of(path: Path, topic: str, number: int, received_ns: int, message: Any) -> EncodedFrame:
    """An image message, raw or packed, which is decoded when that is asked for."""
    is_raw = hasattr(message, "encoding")
    packed = b"" if is_raw or _DEPTH_TRANSPORT in message.format else bytes(message.data)
    is_picture = packed.startswith((JPEG_MAGIC, PNG_MAGIC))
    read: Callable[[], _Decoded] = partial(_raw if is_raw else _packed, message)
    return EncodedFrame(
        path,
        topic,
        number,
        stamp_of(message),
        received_ns,
        frame_name(message.header.frame_id),
        message.encoding if is_raw else message.format,
        read,
        partial(bytes, packed if is_picture else b""),
        lambda: memoryview(message.data),
    )


def _raw(message: Any) -> _Decoded:
    data = np.asarray(message.data, dtype=np.uint8)
    height, width, step = int(message.height), int(message.width), int(message.step)
    is_bigendian = bool(message.is_bigendian)
    return decode_raw(RawImage(height, width, str(message.encoding), is_bigendian, step, data))


def _packed(message: Any) -> _Decoded:
    """JPEG or PNG by its first bytes, compressedDepth by its format."""
    told, data = str(message.format), bytes(message.data)
    if _DEPTH_TRANSPORT in told:
        return "depth", decode_compressed_depth(told, data)
    return of_picture(decode_picture(data), told)


def of_picture(pixels: NDArray[Any], told: str = "") -> _Decoded:
    """Kind and pixels of a decoded JPEG or PNG, whose message has this format.

    A single channel of 16 bits holds depths, unless it is told to be mono16. Where the format says
    that colours were packed as they were (``compressed rgb``), not in the order of the file type,
    red and blue are swapped back, as compressed_image_transport does. pixels: (h, w) or (h, w, 3).
    """
    if pixels.ndim == 2 and pixels.dtype == np.uint16 and not told.startswith("mono16"):
        return "depth", pixels
    eight = (pixels >> 8).astype(np.uint8) if pixels.dtype == np.uint16 else pixels
    if pixels.ndim == 2:
        return "grey", eight
    is_swapped = "compressed rgb" in told
    return "colour", np.ascontiguousarray(eight[:, :, ::-1]) if is_swapped else eight


def claim_of(topic: str, message: Any) -> CameraClaim:
    """What a CameraInfo says; ROS 1 writes D, K, R and P in capitals."""

    def numbers(name: str) -> NDArray[np.float64]:
        value = getattr(message, name, None)
        return np.array(getattr(message, name.upper()) if value is None else value, np.float64)

    roi = message.roi
    return CameraClaim(
        f"topic {topic}",
        frame_name(message.header.frame_id),
        int(message.width),
        int(message.height),
        str(message.distortion_model),
        numbers("d"),
        numbers("k").reshape(3, 3),
        numbers("r").reshape(3, 3),
        numbers("p").reshape(3, 4),
        (max(int(message.binning_x), 1), max(int(message.binning_y), 1)),
        (int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)),
    )


def told_readout(custom: Mapping[str, str], image_topic: str) -> float | None:
    """What they say of a topic's camera, in seconds; None where nothing.

    Raises ValueError for what is no such time.
    """
    key = readout_key(without_transport(image_topic))
    if key not in custom:
        return None
    try:
        readout_s = float(custom[key])
    except ValueError:
        readout_s = np.nan
    if not abs(readout_s) <= 1.0:
        raise ValueError(f"custom data {key} are {shown(custom[key])}, no seconds from -1 to 1")
    return readout_s


def info_topic(image_topic: str) -> str:
    """The topic of the CameraInfo beside an image topic, by the rule of image_transport:
    ``camera_info`` in the namespace of the raw image, whatever transport follows it."""
    return f"{without_transport(image_topic).rpartition('/')[0]}/camera_info"


def without_transport(image_topic: str) -> str:
    """The topic of the raw image, of which a topic of image_transport has a packed copy."""
    for transport in ("/compressed", f"/{_DEPTH_TRANSPORT}"):
        image_topic = image_topic.removesuffix(transport)
    return image_topic
