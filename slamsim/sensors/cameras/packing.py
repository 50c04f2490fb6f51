"""How images are packed into messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.settings import ImagerConfig

Pixels = NDArray[Any]

_RAW = {"color": "rgb8", "grey": "mono8", "infrared": "mono8", "depth": "16UC1"}
_MESSAGE, _PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def raw_encoding(config: ImagerConfig) -> str:
    """Of the pixels, as sensor_msgs/image_encodings names it."""
    return _RAW[config.kind]


def image_topic(config: ImagerConfig, at: str) -> tuple[str, str]:
    """(topic, type) of the images below a topic, as image_transport names them."""
    if config.encoding == "raw":
        return f"{at}/image_raw", _MESSAGE
    return f"{at}/image_raw/{'compressedDepth' if config.is_depth else 'compressed'}", _PACKED


def told_format(config: ImagerConfig) -> str:
    """What a CompressedImage says of itself, as ROS' image transports write it."""
    encoding = raw_encoding(config)
    if config.is_depth:
        return f"{encoding}; compressedDepth {config.encoding}"
    inside = "bgr8" if config.kind == "color" else "mono8"
    return f"{encoding}; {config.encoding} compressed {inside}"


def packer(config: ImagerConfig) -> Callable[[Pixels], bytes]:
    """What makes the data of a message of (h, w) or (h, w, 3) pixels; safe in any thread."""
    if config.encoding == "raw":
        return lambda pixels: np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")).tobytes()
    if config.is_depth:
        from slamsim.cameras.codecs.depth import encode_compressed_depth

        codec: Any = config.encoding
        return lambda pixels: encode_compressed_depth(pixels, codec)[1]
    from slamsim.cameras.codecs.pictures import encode_jpeg, encode_png

    if config.encoding == "png":
        return encode_png
    return lambda pixels: encode_jpeg(pixels, config.jpeg_quality)
