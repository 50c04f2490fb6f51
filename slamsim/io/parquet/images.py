"""Camera images of a recording as Parquet tables, one for each topic, during the simulation.

A row is an image: stamps, encoding, and the bytes of a JPEG or PNG file as it was recorded. What
was recorded raw becomes a PNG, or where that cannot hold it (floats, 32 bits) differences packed by
zstd (``codecs.planes``): nothing is lost. The table says which camera took it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.depth import DEPTH_HEAD_BYTES, decode_compressed_depth
from slamsim.cameras.codecs.pictures import decode_picture, encode_png
from slamsim.cameras.codecs.planes import pack_planes, unpack_planes
from slamsim.cameras.frames import metres
from slamsim.guard.pictures import require_size
from slamsim.io.parquet.file import Cells, Column, ParquetFile
from slamsim.io.ros.images import info_topic
from slamsim.io.staged_writer import StagedWriter
from slamsim.recording import RawStream
from slamsim.recording.images import RawCameraInfos, RawFrameTruths, RawImages, RawPackedImages

ROWS_PER_GROUP = 8
"""What is read for one image; a truth image of 424 x 240 pixels takes some 0.2 MB."""
_TRUTH = "/ground_truth/"
_PLANES, _PNG = "; planes", "; png"
_DTYPES = {"8UC": "u1", "16UC": "u2", "32SC": "i4", "32FC": "f4"}
_CHANNELS = {"rgb8": ("u1", 3), "mono8": ("u1", 1)}
_IMAGE = (
    Column("stamp_ns", "int64", "as in the message, on the camera's clock"),
    Column("received_ns", "int64", "when the recorder received it"),
    Column("sample", "int64", "number among the images of this topic"),
    Column("topic", "string"),
    Column("encoding", "string", "of the pixels, and how data packs them"),
    Column("data", "binary", "a JPEG or PNG file; planes: see slamsim.cameras.codecs.planes"),
)


class ImageTables(StagedWriter):
    """``images/CAMERA_IMAGER.parquet`` and ``truth/CAMERA_IMAGER_WHAT.parquet`` below a folder.

    A context manager. sequence: its number in a data set. counts: images by table, without those of
    the truth.
    """

    def __init__(self, folder: Path, sequence: int | None = None) -> None:
        super().__init__()
        self.counts = Counter[str]()
        self._folder, self._sequence = folder, sequence
        self._files = dict[str, ParquetFile]()
        self._rows = Counter[str]()
        self._infos = dict[str, RawCameraInfos]()

    def write(self, streams: Iterable[RawStream]) -> None:
        """What cameras took in the next window; other streams are passed over."""
        streams = tuple(streams)
        # Kept: flow is told with the next image, which may be lost.
        self._infos |= {each.topic: each for each in streams if isinstance(each, RawCameraInfos)}
        for stream in streams:
            if isinstance(stream, RawFrameTruths):
                self._append(stream, _frame_columns(stream), {}, _frame_cells(stream))
            elif isinstance(stream, RawImages | RawPackedImages):
                facts = _facts(self._infos.get(info_topic(stream.topic)))
                self._append(stream, _IMAGE, facts, _image_cells(stream))

    def _append(
        self,
        stream: RawStream,
        columns: tuple[Column, ...],
        facts: Mapping[str, object],
        cells: Mapping[str, Cells],
    ) -> None:
        path, count = table_of(stream.topic), len(stream.stamps_ns)
        file = self._files.get(path)
        if file is None:
            whole = self._folder / path
            whole.parent.mkdir(exist_ok=True)
            about = {"topic": stream.topic, "frame_id": stream.frame_ids[0], **facts}
            opened = ParquetFile(whole, columns, about, ROWS_PER_GROUP, sequence=self._sequence)
            file = self._files[path] = self._open.enter_context(opened)
        numbers = np.arange(self._rows[path], self._rows[path] + count)
        file.append({"sample": numbers, **cells})
        self._rows[path] += count
        if not stream.topic.startswith(_TRUTH):
            self.counts[Path(path).stem] += count


def table_of(topic: str) -> str:
    """Where a topic's table stands: ``/front/color/image_raw/compressed`` is
    ``images/front_color.parquet``, ``/ground_truth/front/color/depth``
    ``truth/front_color_depth.parquet``."""
    folder = "truth" if topic.startswith(_TRUTH) else "images"
    words = topic.removeprefix(_TRUTH).strip("/").split("/")
    if "image_raw" in words:
        words = words[: words.index("image_raw")]
    return f"{folder}/{'_'.join(words)}.parquet"


def pixels_of(encoding: str, data: bytes, size: tuple[int, int]) -> NDArray[Any]:
    """The image in a row: colour (h, w, 3) uint8 RGB, grey (h, w) uint8, depth (h, w) float32
    metres with nan for none, other truth as it is.

    size: (width, height) as the table says. Raises ValueError for what is damaged or of another
    size, Excessive beyond ``LIMITS``.
    """
    kind = encoding.partition(";")[0]
    if encoding.endswith(_PLANES):
        dtype, channels = _stored_as(kind)
        require_size(*size, channels * np.dtype(dtype).itemsize)
        shape = (size[1], size[0], channels) if channels > 1 else (size[1], size[0])
        pixels = unpack_planes(data, shape, dtype)
    elif "compressedDepth" in encoding:
        pixels = decode_compressed_depth(encoding, data)
    else:
        pixels = decode_picture(data)
    if pixels.shape[1::-1] != size:
        told = "{1} x {0}, while its table says {2} x {3}"
        raise ValueError(f"an image is {told.format(*pixels.shape[:2], *size)}")
    return metres(pixels, 1e-3) if kind in ("16UC1", "32FC1") else pixels


def _stored_as(encoding: str) -> tuple[str, int]:
    """(dtype, channels) of a raw image; raises ValueError for an encoding never written."""
    if encoding in _CHANNELS:
        return _CHANNELS[encoding]
    dtype = _DTYPES.get(encoding[:-1])
    if dtype is None or not encoding[-1:].isdigit():
        raise ValueError(f"images of the encoding {encoding[:40]!r} are not packed in planes")
    return dtype, int(encoding[-1])


def _facts(info: RawCameraInfos | None) -> dict[str, object]:
    if info is None:
        return {}
    told = {
        "width": info.width,
        "height": info.height,
        "distortion_model": info.distortion_models[0],
        "coefficients": info.coefficients.tolist(),
        "K": info.K.tolist(),
        "right_of_m": info.right_of_m,
    }
    return {"camera": told}


def _image_cells(stream: RawImages | RawPackedImages) -> Mapping[str, Cells]:
    packed = [_packed(stream, number) for number in range(len(stream.stamps_ns))]
    received_ns = stream.stamps_ns if stream.received_ns is None else stream.received_ns
    return {
        "stamp_ns": stream.stamps_ns,
        "received_ns": received_ns,
        "topic": [stream.topic] * len(packed),
        "encoding": [encoding for encoding, _ in packed],
        "data": [data for _, data in packed],
    }


def _packed(stream: RawImages | RawPackedImages, number: int) -> tuple[str, bytes]:
    """(encoding, data) of one image, without what is only the head of a ROS message."""
    data = stream.data[number]
    if isinstance(stream, RawPackedImages):
        told = stream.formats[0]
        if told.endswith("compressedDepth png"):
            return told.partition(";")[0] + _PNG, data[DEPTH_HEAD_BYTES:].tobytes()
        return told, data.tobytes()
    encoding = stream.encodings[0]
    dtype, channels = _stored_as(encoding)
    shape = (stream.height, stream.width, channels)[: 3 if channels > 1 else 2]
    pixels = np.ascontiguousarray(data).view(f"<{dtype}").reshape(shape)
    if pixels.dtype.kind == "u":
        return encoding + _PNG, encode_png(pixels)
    return encoding + _PLANES, pack_planes(pixels)


def _frame_columns(stream: RawFrameTruths) -> tuple[Column, ...]:
    rows = stream.row_instants_ns.shape[1]
    return (
        *_IMAGE[:4],
        Column("true_stamp_ns", "int64", "the middle of the exposure of the first row"),
        Column("exposure_s", "float64"),
        Column("gain", "float64"),
        Column("row_instants_ns", "int64", "of each row; one of a global shutter", rows),
        Column("positions_m", "float64", "x, y, z of T_map_optical at each", 3 * rows),
        Column("quats_xyzw", "float64", "of T_map_optical at each", 4 * rows),
    )


def _frame_cells(stream: RawFrameTruths) -> Mapping[str, Cells]:
    received_ns = stream.stamps_ns if stream.received_ns is None else stream.received_ns
    return {
        "stamp_ns": stream.stamps_ns,
        "received_ns": received_ns,
        "topic": [stream.topic] * len(stream.stamps_ns),
        "true_stamp_ns": stream.instants_ns,
        "exposure_s": stream.exposures_s,
        "gain": stream.gains,
        "row_instants_ns": stream.row_instants_ns,
        "positions_m": stream.positions_m,
        "quats_xyzw": stream.quats_xyzw,
    }
