"""Hostile robot descriptions."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import fault_doors as doors
from fault_corpus_base import Data, Hostile, one

from slamsim.config.robot import RobotConfig
from slamsim.sim.robot.model import build_robot

SOUND = build_robot(RobotConfig()).urdf
_LINK = '<link name="{}"/>'
_FIXED = '<joint name="j{0}" type="fixed"><parent link="{1}"/><child link="{2}"/></joint>'


def _with(inside: str) -> str:
    return SOUND.replace("</robot>", f"{inside}</robot>")


def _swapped(old: str, new: str) -> str:
    assert old in SOUND, old
    return SOUND.replace(old, new, 1)


def _value(tag: str, key: str, value: str) -> str:
    """With another value of the first such attribute."""
    at = SOUND.index(f'{key}="', SOUND.index(f"<{tag} ")) + len(key) + 2
    return SOUND[:at] + value + SOUND[SOUND.index('"', at) :]


def _shape(shape: str) -> str:
    part = f"<collision><geometry>{shape}</geometry></collision>"
    return _with(f'<link name="x">{part}</link>{_FIXED.format("x", "base_link", "x")}')


def _chain(count: int) -> str:
    links = "".join(_LINK.format(f"c{i}") for i in range(count))
    joints = "".join(_FIXED.format(f"c{i}", f"c{i - 1}", f"c{i}") for i in range(1, count))
    return _with(links + joints + _FIXED.format("c0", "base_link", "c0"))


def _ladder(count: int) -> str:
    """As ``_chain``, the joints told from the last to the first."""
    links = "".join(_LINK.format(f"c{i}") for i in range(count))
    joints = [_FIXED.format(f"c{i}", f"c{i - 1}", f"c{i}") for i in range(1, count)]
    return _with(links + "".join(joints[::-1]) + _FIXED.format("c0", "base_link", "c0"))


def _arm(count: int) -> str:
    """A chain whose every joint turns."""
    inertial = (
        '<inertial><mass value="0.001"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6"/></inertial>'
    )
    links = "".join(f'<link name="c{i}">{inertial}</link>' for i in range(count))
    return (
        _chain(count)
        .replace("".join(_LINK.format(f"c{i}") for i in range(count)), links)
        .replace('type="fixed"><parent link="c', 'type="continuous"><parent link="c')
    )


_ENTITIES = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {new} "{10 * f"&{old};"}">' for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)

ROBOTS: dict[str, tuple[Data, str]] = {
    "two roots": (_with(_LINK.format("other")), "exactly one root"),
    "no link": ("<robot name='r'/>", "no link"),
    "a ring": (
        _with(
            _LINK.format("a")
            + _LINK.format("b")
            + _FIXED.format(1, "a", "b")
            + _FIXED.format(2, "b", "a")
        ),
        "ring",
    ),
    "a link of its own child": (_with(_LINK.format("a") + _FIXED.format(1, "a", "a")), "ring"),
    "two parents": (
        _with(_FIXED.format(1, "base_link", "laser_link")),
        "child of two joints",
    ),
    "an unknown parent": (
        _with(_LINK.format("a") + _FIXED.format(1, "nobody", "a")),
        "does not exist",
    ),
    "a link twice": (_with(_LINK.format("laser_link")), "2 links are called"),
    "a joint twice": (
        _with(
            _LINK.format("a")
            + _LINK.format("b")
            + _FIXED.format(1, "base_link", "a")
            + _FIXED.format(1, "base_link", "b")
        ),
        "2 joints are called",
    ),
    "a link without a name": (_with("<link/>"), "has no name"),
    "an unknown joint": (_swapped('type="continuous"', 'type="magnetic"'), "magnetic"),
    "a joint without a type": (_swapped('type="continuous"', ""), "None"),
    "mass of nan": (_value("mass", "value", "nan"), "finite"),
    "mass of inf": (_value("mass", "value", "-inf"), "finite"),
    "mass of a word": (_value("mass", "value", "heavy"), "not a number"),
    "mass below 0": (_value("mass", "value", "-1"), "at least 0"),
    "mass of 0": (_value("mass", "value", "0"), "mass"),
    "mass of a planet": (_value("mass", "value", "6e24"), "sane"),
    "mass of a mote": (_value("mass", "value", "1e-300"), "inertia"),
    "inertia of nan": (_value("inertia", "ixx", "nan"), "finite"),
    "inertia of 0": (_value("inertia", "ixx", "0"), "inertia"),
    "inertia that no body has": (_value("inertia", "ixy", "9e5"), "inertia"),
    "a place of nan": (_value("origin", "xyz", "nan 0 0"), "finite"),
    "a place of two numbers": (_value("origin", "xyz", "0 0"), "3 numbers"),
    "a place far away": (_value("origin", "xyz", "1e9 0 0"), "sane"),
    "a turn of 1e300": (_value("origin", "rpy", "1e300 0 0"), "sane"),
    "an axis of nothing": (_value("axis", "xyz", "0 0 0"), "points nowhere"),
    "an axis of nan": (_value("axis", "xyz", "nan 0 1"), "finite"),
    "a box of size 0": (_shape('<box size="0 1 1"/>'), "above 0"),
    "a box of two numbers": (_shape('<box size="1 1"/>'), "3 numbers"),
    "a box without a size": (_shape("<box/>"), "missing"),
    "a ball of nan": (_shape('<sphere radius="nan"/>'), "finite"),
    "a ball of -1": (_shape('<sphere radius="-1"/>'), "above 0"),
    "a cylinder without a length": (_shape('<cylinder radius="1"/>'), "missing"),
    "a shape of no kind": (_shape("<teapot/>"), "teapot"),
    "two shapes in one": (_shape('<box size="1 1 1"/><sphere radius="1"/>'), "one shape"),
    "a mesh elsewhere": (_shape('<mesh filename="../../../../x.stl"/>'), "inside"),
    "a mesh of the machine": (_shape('<mesh filename="/etc/passwd.stl"/>'), "inside"),
    "a mesh by an address": (_shape('<mesh filename="http://a.b/c.stl"/>'), "plain file name"),
    "a mesh of a package": (_shape('<mesh filename="package://a/c.stl"/>'), "plain file name"),
    "a mesh of the file system": (_shape('<mesh filename="file:///x.stl"/>'), "plain file name"),
    "a mesh that is not there": (_shape('<mesh filename="no.stl"/>'), "does not exist"),
    "a mesh with NUL": (_shape('<mesh filename="a&#0;.stl"/>'), "well-formed"),
    "a mesh of size 0": (_shape('<mesh filename="no.stl" scale="0 1 1"/>'), "scale"),
    "XML cut off": (SOUND[: len(SOUND) // 2], "well-formed"),
    "no XML": ("hello", "well-formed"),
    "another XML": ("<sdf version='1.6'/>", "begins with"),
    "nothing": ("", "well-formed"),
    "NUL in XML": (SOUND.encode() + b"\0", "well-formed"),
    "UTF-16 in XML": (SOUND.encode("utf-16"), "text"),
    "Latin 1 in XML": ("<robot name='Höhle'/>".encode("latin-1"), "text"),
    "entities like a bomb": (f"{_ENTITIES}]><robot name='&i;'/>", "refused as XML"),
    "an entity outside": (
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>',
        "refused as XML",
    ),
    "a definition outside": (
        '<!DOCTYPE r SYSTEM "http://a.b/c.dtd"><robot name="r"/>',
        "refused as XML",
    ),
    "100,000 levels": (lambda: "<a>" * 100_000 + "</a>" * 100_000, "r.urdf"),
    "100,000 levels in a robot": (
        lambda: _with("<a>" * 90_000 + "</a>" * 90_000),
        "nested deeper",
    ),
    "300,000 elements": (lambda: _with("<a/>" * 300_000), "elements"),
    "60,000 elements": (lambda: _with("<a/>" * 60_000), "elements"),
    "10 MB of XML": (lambda: _with(f"<!--{'x' * 10_000_000}-->"), "bytes long"),
    "a number of a million digits": (
        lambda: _value("mass", "value", "9" * 1_000_000),
        "finite",
    ),
    "100,000 attributes": (
        lambda: _with("<link " + " ".join(f'a{i}="1"' for i in range(100_000)) + "/>"),
        "has no name",
    ),
    "5,000 links in a chain": (lambda: _chain(5000), "links, at most"),
    "900 links in a chain": (lambda: _chain(900), ""),
    "900 links, the last first": (lambda: _ladder(900), ""),
    "300 links that turn": (lambda: _arm(300), "moving joints"),
    "60 links that turn": (lambda: _arm(60), ""),
    "a mass twice": (
        _swapped("<mass ", '<mass value="nan"/><mass '),
        "finite",
    ),
    "an inertia without axes": (_value("inertia", "ixx", ""), "one number"),
    "a wheel of no size": (_value("cylinder", "radius", "1e-320"), "above 0"),
    "a limit upside down": (
        _with(
            _LINK.format("a")
            + '<joint name="j" type="revolute"><parent link="base_link"/><child link="a"/>'
            '<limit lower="1" upper="-1"/></joint>'
        ),
        "above the upper",
    ),
    "a name of a million letters": (
        lambda: _with(_LINK.format("n" * 1_000_000)),
        "1,000,000 characters",
    ),
    "a name of control characters": (_with(_LINK.format("&#x1b;[31m")), "well-formed"),
}


def _pipe(folder: Path) -> None:
    os.mkfifo(folder / "r.urdf")


def hostile_robots() -> Iterator[Hostile]:
    """All of them."""
    for name, (text, words) in ROBOTS.items():
        yield Hostile(f"robot: {name}", "r.urdf", one("r.urdf", text), doors.robot, words)
    yield Hostile("robot: a pipe", "r.urdf", _pipe, doors.robot, "pipe")
