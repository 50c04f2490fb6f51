"""Walks over a ROS 1 bag (format 2.0) before anyone reads it: sizes, chunks, definitions.

The format has no checksums of its own; only bz2 chunks carry one. Format:
wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from slamsim.logs.bag_limits import BagFacts, inflate
from slamsim.safe.errors import Excessive, InputRefused, limit_of
from slamsim.safe.files import open_input, require_magic
from slamsim.safe.limits import LIMITS, Limits

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = (bytes([op]) for op in range(2, 8))


def check_bag1(path: Path, limits: Limits = LIMITS) -> BagFacts:
    """What is in the file; InputRefused, with the byte, for one that is cut, damaged or a bomb."""
    messages, definitions = 0, {}
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        require_magic(file, path, MAGIC, "ROS 1 bag")
        while file.tell() < size:
            position = file.tell()
            try:
                head = header_fields(_block(file, size, "bag_record_bytes", limits))
                data = _block(file, size, "bag_chunk_bytes", limits)
                if head[b"op"] == CHUNK:
                    messages += _count_in_chunk(head, data, limits)
                elif head[b"op"] == CONNECTION:
                    fields = header_fields(data)
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


def header_fields(data: bytes) -> dict[bytes, bytes]:
    """The values of a header by name; ValueError unless it is all fields."""
    fields, position = {}, 0
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "little")
        name, separator, value = data[position + 4 : position + 4 + length].partition(b"=")
        position += 4 + length
        if not separator or position > len(data):
            raise ValueError("a header field is damaged")
        fields[name] = value
    return fields


def chunk_content(head: dict[bytes, bytes], data: bytes, limits: Limits = LIMITS) -> bytes:
    """The records in a chunk with this header, unpacked; raises as ``inflate`` does."""
    size = int.from_bytes(head[b"size"], "little")
    return inflate(data, head[b"compression"].decode(), size, limits)


def records_in_chunk(content: bytes) -> Iterator[tuple[dict[bytes, bytes], int, int, int]]:
    """(header, first byte of the record, of its data, end); ValueError unless it is all records."""
    position = 0
    while position < len(content):
        ends = [position]
        for _ in range(2):
            length = int.from_bytes(content[ends[-1] : ends[-1] + 4], "little")
            ends.append(ends[-1] + 4 + length)
        begin, middle, end = ends
        if end > len(content):
            raise ValueError("a record reaches beyond the end of its chunk")
        yield header_fields(content[begin + 4 : middle]), begin, middle + 4, end
        position = end


def _count_in_chunk(head: dict[bytes, bytes], data: bytes, limits: Limits) -> int:
    records = records_in_chunk(chunk_content(head, data, limits))
    return sum(fields.get(b"op") == MESSAGE for fields, *_ in records)
