"""Walks over a ROS 1 bag (format 2.0) before anyone reads it: sizes, chunks, definitions.

The format has no checksums of its own; only bz2 chunks carry one. Format:
wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from slamsim.logs.bag_limits import BagFacts, inflate
from slamsim.safe.errors import Excessive, InputRefused, limit_of
from slamsim.safe.files import open_input, require_magic
from slamsim.safe.limits import LIMITS, Limits

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"


def check_bag1(path: Path, limits: Limits = LIMITS) -> BagFacts:
    """What is in the file; InputRefused, with the byte, for one that is cut, damaged or a bomb."""
    messages, definitions = 0, {}
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        require_magic(file, path, _MAGIC, "ROS 1 bag")
        while file.tell() < size:
            position = file.tell()
            try:
                head = _fields(_block(file, size, "bag_record_bytes", limits))
                data = _block(file, size, "bag_chunk_bytes", limits)
                if head[b"op"] == _CHUNK:
                    messages += _count_in_chunk(head, data, limits)
                elif head[b"op"] == _CONNECTION:
                    fields = _fields(data)
                    definitions[fields[b"type"].decode()] = fields[b"message_definition"].decode()
            except Exception as error:
                detail = " ".join(str(error).split())[:200] or type(error).__name__
                reason = f"{detail} ({type(error).__name__}): the bag is damaged or cut off"
                where = f"byte {position:,}"
                raise InputRefused(path, reason, where, limit=limit_of(error)) from error
    return BagFacts(messages, tuple(definitions.items()))


def _block(file: BinaryIO, size: int, limit: str, limits: Limits) -> bytes:
    length = int.from_bytes(file.read(4), "little")
    if length > size - file.tell():
        raise ValueError("a record reaches beyond the end of the file")
    most: int = getattr(limits, limit)
    if length > most:
        raise Excessive(f"a record of {length:,} bytes, at most {most:,} are read", limit)
    return file.read(length)


def _fields(data: bytes) -> dict[bytes, bytes]:
    fields, position = {}, 0
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "little")
        name, separator, value = data[position + 4 : position + 4 + length].partition(b"=")
        position += 4 + length
        if not separator or position > len(data):
            raise ValueError("a header field is damaged")
        fields[name] = value
    return fields


def _count_in_chunk(head: dict[bytes, bytes], data: bytes, limits: Limits) -> int:
    size = int.from_bytes(head[b"size"], "little")
    content = inflate(data, head[b"compression"].decode(), size, limits)
    position, messages = 0, 0
    while position < len(content):
        ends = []
        for _ in range(2):
            length = int.from_bytes(content[position : position + 4], "little")
            ends.append((position + 4, position + 4 + length))
            position += 4 + length
        if position > len(content):
            raise ValueError("a record reaches beyond the end of its chunk")
        messages += _fields(content[slice(*ends[0])]).get(b"op") == _MESSAGE
    return messages
