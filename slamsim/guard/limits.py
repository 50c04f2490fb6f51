"""Limits for all input files, in one table."""

from __future__ import annotations

from dataclasses import dataclass

MIB, GIB = 1 << 20, 1 << 30


@dataclass(frozen=True, slots=True)
class Limits:
    """What a sane file stays below by a wide margin and a hostile one does not.

    The ratios of text count only above their floors: a robot that stands still in front of a
    wall compresses very well too, but each of its lines has a time of its own. A refusal names
    the limit that it is for: ``InputRefused.limit``.
    """

    yaml_bytes: int = MIB
    json_bytes: int = 64 * MIB
    yaml_depth: int = 32
    yaml_nodes: int = 50_000
    yaml_key_characters: int = 1024
    text_line_bytes: int = MIB
    text_total_bytes: int = 4 * GIB
    text_ratio: int = 1000
    text_ratio_floor_bytes: int = 64 * MIB
    text_lines_per_byte: int = 16
    text_lines_floor: int = 1_000_000
    image_file_bytes: int = 256 * MIB
    image_pixels: int = 64_000_000
    image_decoded_bytes: int = 256 * MIB
    image_corners: int = 400_000
    mesh_file_bytes: int = 512 * MIB
    mesh_header_bytes: int = 4 * MIB
    mesh_line_bytes: int = 64 << 10
    mesh_vertices: int = 20_000_000
    mesh_triangles: int = 20_000_000
    mesh_parts: int = 10_000
    mesh_depth: int = 256
    mesh_coordinate_m: float = 100_000.0
    urdf_bytes: int = 4 * MIB
    urdf_depth: int = 32
    urdf_elements: int = 50_000
    urdf_links: int = 1000
    urdf_moving_joints: int = 64
    urdf_name_characters: int = 1000
    urdf_number: float = 1e6
    sums_bytes: int = 256 * MIB
    route_rows: int = 100_000
    saved_map_bytes: int = 4_000_000_000
    attachment_bytes: int = 2 * GIB
    bag_chunk_bytes: int = 256 * MIB
    bag_record_bytes: int = 64 * MIB
    bag_ratio: int = 1000
    unpacked_file_bytes: int = 64 * GIB
    bag_ratio_floor_bytes: int = 16 * MIB
    table_ratio: int = 1000
    table_ratio_floor_bytes: int = 64 * MIB
    bag_definition_characters: int = 256 << 10
    bag_definition_fields: int = 1000
    bag_array_elements: int = 10_000


LIMITS = Limits()
