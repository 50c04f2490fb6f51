"""Validates that a robot model is physically plausible, our own and those of users alike.

A wrong model gives plausible wrong results: a default inertia of 1 kg m^2 on a camera makes a
robot vibrate until it bursts, a support wheel 7 mm off the floor makes it rock, a fixed one
makes it drag.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.sim.robot.inertia import Inertial
from slamsim.sim.robot.urdf import Description, Link, LinkShape

DOWN = np.array([0.0, 0.0, -1.0])
LEAST_DENSITY_KG_M3, GREATEST_DENSITY_KG_M3 = 5.0, 23_000.0
"""Lighter than expanded foam, heavier than osmium: no such robot part."""
GREATEST_INERTIA_FACTOR = 3.0
"""All mass in the corners of a cuboid gives three times the moment of the solid one."""
LEAST_INERTIA_FACTOR = 0.05
"""All mass within the inner 22 % of a body: less is a wrong unit or a placeholder."""
_LEAST_EDGE_M = 1e-6
"""Between two feet at one place."""
ROLLING_NAMES = ("caster", "wheel")

FaultKind = Literal["inertia", "support_wheels", "wheel_height", "balance"]


class ModelFault(NamedTuple):
    """Something that no sane robot has: what kind of thing, and in words with its numbers."""

    kind: FaultKind
    words: str


def model_faults(description: Description, max_gap_m: float) -> list[ModelFault]:
    """Every fault with its numbers; empty for a sane model.

    max_gap_m: how far a wheel may be above or below the floor (z = 0 of base_footprint).
    """
    faults = [fault for link in description.links.values() for fault in _inertia_faults(link)]
    faults += _moving_mass_faults(description)
    faults += _joint_faults(description)
    faults += _floor_faults(description, max_gap_m)
    return faults or list(_balance_faults(description))


def _bounding_box(link: Link) -> tuple[LinkShape, float] | None:
    """The cuboid around a link's visible shapes (else its contact shapes) and their volume."""
    shapes = link.visuals or link.collisions
    if not shapes:
        return None
    axes = np.eye(3)
    upper = np.array([max(s.reach_m(np.eye(4), axis) for s in shapes) for axis in axes])
    lower = np.array([-max(s.reach_m(np.eye(4), -axis) for s in shapes) for axis in axes])
    T = np.eye(4)
    T[:3, 3] = 0.5 * (upper + lower)
    size = upper - lower
    return LinkShape("box", (size[0], size[1], size[2]), T), sum(s.volume_m3() for s in shapes)


def _inertia_faults(link: Link) -> Iterator[ModelFault]:
    body = link.inertial
    if body is None:
        if link.collisions:
            yield ModelFault(
                "inertia",
                f"{link.name}: has a contact shape but no mass; engines would take 1 kg and "
                "1 kg m^2 for it: give it its own",
            )
        return
    if not body.mass_kg > 0.0:
        yield ModelFault("inertia", f"{link.name}: mass {body.mass_kg:g} kg must be positive")
        return
    moments = np.linalg.eigvalsh(body.inertia_kg_m2)
    shown = ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] <= 0.0:
        yield ModelFault(
            "inertia",
            f"{link.name}: principal moments of inertia ({shown}) kg m^2 must be positive",
        )
        return
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6):
        yield ModelFault(
            "inertia",
            f"{link.name}: principal moments of inertia ({shown}) kg m^2 break the triangle "
            "inequality: the largest exceeds the sum of the other two, no body is like that",
        )
    yield from _solid_faults(link, body)


def _solid_faults(link: Link, body: Inertial) -> Iterator[ModelFault]:
    bounds = _bounding_box(link)
    if bounds is None:
        return
    box, volume_m3 = bounds
    density = body.mass_kg / volume_m3
    if not LEAST_DENSITY_KG_M3 <= density <= GREATEST_DENSITY_KG_M3:
        yield ModelFault(
            "inertia",
            f"{link.name}: mass {body.mass_kg:g} kg in {volume_m3 * 1e3:.3g} litres is "
            f"{density:.3g} kg/m^3; plausible is {LEAST_DENSITY_KG_M3:g} to "
            f"{GREATEST_DENSITY_KG_M3:g}",
        )
    solid = np.diag(box.solid_inertia(body.mass_kg))
    moments = np.diag(body.inertia_kg_m2)
    for axis, moment, expected in zip("xyz", moments, solid, strict=True):
        least, most = LEAST_INERTIA_FACTOR * expected, GREATEST_INERTIA_FACTOR * expected
        if not least <= moment <= most:
            yield ModelFault(
                "inertia",
                f"{link.name}: moment of inertia about {axis} is {moment:.4g} kg m^2, but a solid "
                f"cuboid of its size and mass has {expected:.4g}; plausible is {least:.3g} to "
                f"{most:.3g}",
            )


def _moving_mass_faults(description: Description) -> Iterator[ModelFault]:
    for joint in description.joints:
        if joint.kind != "fixed" and description.links[joint.child].inertial is None:
            yield ModelFault(
                "inertia", f"{joint.child}: moves ({joint.kind} joint {joint.name}) but has no mass"
            )


def _joint_faults(description: Description) -> Iterator[ModelFault]:
    for joint in description.joints:
        link = description.links[joint.child]
        if joint.kind == "fixed" and link.collisions and _is_rolling_name(link.name):
            yield ModelFault(
                "support_wheels",
                f"{link.name}: this wheel is fixed (joint {joint.name}) and would be dragged; "
                "its joint must be continuous",
            )


def _is_rolling_name(name: str) -> bool:
    return any(word in name.lower() for word in ROLLING_NAMES)


def rolling_links(description: Description) -> tuple[str, ...]:
    """Links with a contact shape that turn freely about a horizontal axis: the wheels."""
    placed = description.placements()
    return tuple(
        joint.child
        for joint in description.joints
        if joint.kind == "continuous"
        and description.links[joint.child].collisions
        and abs(float((placed[joint.child][:3, :3] @ joint.axis)[2])) < 0.02
    )


def lowest_point_m(link: Link, T_base_link: FloatArray) -> float:
    """Height of a link's lowest contact point above the floor; inf without contact shape."""
    reaches = [shape.reach_m(T_base_link, DOWN) for shape in link.collisions]
    return -max(reaches) if reaches else float("inf")


def _floor_faults(description: Description, max_gap_m: float) -> Iterator[ModelFault]:
    placed = description.placements()
    rolling = rolling_links(description)
    if len(rolling) < 3:
        yield ModelFault(
            "support_wheels",
            f"a robot stands on at least 3 wheels that roll, this one has {len(rolling)}",
        )
    for name, link in description.links.items():
        lowest = lowest_point_m(link, placed[name])
        if name in rolling and abs(lowest) > max_gap_m:
            side = "above" if lowest > 0.0 else "below"
            yield ModelFault(
                "wheel_height",
                f"{name}: the wheel's lowest point is {1e3 * abs(lowest):.2f} mm {side} the floor; "
                f"it must touch it within {1e3 * max_gap_m:g} mm",
            )
        elif name not in rolling and not _is_rolling_name(name) and lowest <= max_gap_m:
            yield ModelFault(
                "wheel_height",
                f"{name}: does not roll but its lowest point is {1e3 * lowest:.2f} mm above the "
                "floor: it would drag",
            )


def _balance_faults(description: Description) -> Iterator[ModelFault]:
    """The centre of mass must stand between the wheels, else the robot topples at rest."""
    placed = description.placements()
    centre = description.whole().centre_m[:2]
    touching = np.array([placed[name][:2, 3] for name in rolling_links(description)])
    feet = np.unique(touching.round(6), axis=0)
    middle = feet.mean(axis=0)
    feet = feet[np.argsort(np.arctan2(*(feet - middle).T[::-1]))]
    edges, arms = np.roll(feet, -1, axis=0) - feet, centre - feet
    lengths_m = np.maximum(np.linalg.norm(edges, axis=1), _LEAST_EDGE_M)
    inside_m = (edges[:, 0] * arms[:, 1] - edges[:, 1] * arms[:, 0]) / lengths_m
    if inside_m.min() <= 0.0:
        yield ModelFault(
            "balance",
            f"the centre of mass at x = {centre[0]:.4f} m, y = {centre[1]:.4f} m lies "
            f"{-1e3 * inside_m.min():.1f} mm outside the wheels' support: the robot would topple",
        )
