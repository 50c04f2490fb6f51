"""A map that a later run can go on with: key frames, closures and where all of them are.

The file is an uncompressed .npz: plain arrays, each under a CRC, none of them code.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slamsim.core.landmarks import Landmark
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.guard.output import write_atomic
from slamsim.models.wheel_gyro import PARAMETERS, ROWS
from slamsim.slam.backend.columns import Columns, Shape, from_columns, to_columns
from slamsim.slam.backend.graph import GraphUnsound, check_edges
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.matching.surfaces import PIECE_FIELDS

FORMAT = 3
TAGS = "landmark."
"""Columns of maps with tags; others have none."""
_SHAPES: dict[str, Shape] = {
    "T_map_base": (3,),
    "T_odom_base": (3,),
    "information": (3, 3),
    "pieces": (None, PIECE_FIELDS),
    "view": (None, PIECE_FIELDS),
    "T_base_view": (3,),
    "origin_m": (2,),
    "beams_m": (None, 2),
    "restart": (3, 3),
    "T_first_last": (3,),
    "parameters": (PARAMETERS,),
    "jacobian": (ROWS, PARAMETERS),
    "doubt": (3,),
    "T_source_target": (3,),
    "covariance": (3, 3),
    "T_map_tag": (3,),
}


@dataclass(frozen=True, slots=True, eq=False)
class SavedMap:
    """keyframes: numbered from 0. poses: (n, 3) T_map_base. closures: between key frames.
    landmarks: tags in the map.

    The key frames' own T_map_base are these poses as well: no drift is left in them, and their
    views stand there.
    """

    keyframes: Sequence[Keyframe]
    poses: FloatArray
    closures: Sequence[GraphEdge]
    landmarks: Sequence[Landmark] = ()

    def __len__(self) -> int:
        return len(self.keyframes)


def settled(
    keyframes: Sequence[Keyframe],
    poses: FloatArray,
    edges: Sequence[GraphEdge],
    first: int,
    landmarks: Sequence[Landmark] = (),
) -> SavedMap:
    """The map of the key frames from number ``first`` on, at their final poses (n, 3)."""
    placed = [
        replace(keyframe, index=number, T_map_base=pose, T_base_view=np.zeros(3))
        for number, (keyframe, pose) in enumerate(zip(keyframes, poses, strict=True))
    ]
    closures = [
        replace(edge, source=edge.source - first, target=edge.target - first)
        for edge in edges
        if edge.kind == "closure" and edge.weight > 0.0 and min(edge.source, edge.target) >= first
    ]
    renumbered = [replace(keyframe, index=keyframe.index - first) for keyframe in placed[first:]]
    return SavedMap(renumbered, poses[first:], closures, landmarks)


def write_saved_map(path: Path, saved: SavedMap) -> None:
    """Raises SlamsimError or DiskFull."""
    columns: Columns = {
        "format": np.array([FORMAT, len(saved.keyframes), len(saved.closures)]),
        "poses": saved.poses,
        **to_columns(saved.keyframes, Keyframe, "keyframe."),
        **to_columns(saved.closures, GraphEdge, "closure."),
    }
    if saved.landmarks:
        columns |= to_columns(saved.landmarks, Landmark, TAGS)
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **columns)
    write_atomic(path, file.getvalue())


def read_saved_map(path: Path) -> SavedMap:
    """Raises NotFound, or InputRefused for a file that is damaged or none of these."""
    data = read_input(path, "saved_map_bytes")
    try:
        return _checked(_arrays(data))
    except (ValueError, KeyError, TypeError, OverflowError, EOFError, GraphUnsound) as error:
        raise InputRefused(path, f"is no map to go on with, or damaged: {error}") from None
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError) as error:
        raise InputRefused(path, f"is no map to go on with, or damaged: {error}") from None


def _arrays(data: bytes) -> Columns:
    """All arrays of the file, once every CRC was found right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        if any(m.compress_type != zipfile.ZIP_STORED for m in members):
            raise ValueError("its arrays are compressed")
        if sum(m.file_size for m in members) > len(data):
            raise ValueError("its arrays are larger than the file")
        if (name := archive.testzip()) is not None:
            raise ValueError(f"the checksum of {name} is wrong")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        loaded = dict(arrays)
    if not all(isinstance(array, np.ndarray) for array in loaded.values()):
        raise ValueError("it holds something that is no array")
    return loaded


def _checked(columns: Columns) -> SavedMap:
    number, count, closed = columns["format"].tolist()
    if number != FORMAT:
        raise ValueError(f"its format is {number}, this version reads {FORMAT}")
    poses = columns["poses"]
    if poses.dtype != np.float64 or poses.shape != (count, 3) or not np.isfinite(poses).all():
        raise ValueError("its poses are not those of its key frames")
    keyframes = from_columns(columns, Keyframe, count, _SHAPES, "keyframe.")
    closures = from_columns(columns, GraphEdge, closed, _SHAPES, "closure.")
    if count < 1 or [keyframe.index for keyframe in keyframes] != list(range(count)):
        raise ValueError("its key frames are not numbered in order")
    if any(edge.kind != "closure" or max(edge.source, edge.target) >= count for edge in closures):
        raise ValueError("its closures do not join its key frames")
    check_edges(closures)
    tags = len(columns.get(TAGS + "number", ()))
    columns.setdefault(TAGS + "family", np.full(tags, "", dtype="U16"))  # of an earlier version
    landmarks = from_columns(columns, Landmark, tags, _SHAPES, TAGS) if tags else []
    return SavedMap(keyframes, poses, closures, landmarks)
