"""Robot descriptions from outside: what crashes PyBullet or passes it in silence is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh
from limited_child import run_limited

from slamsim.guard.errors import InputRefused
from slamsim.guard.urdf import check_urdf

LINKS = '<link name="base"/><link name="wheel"/>'
JOINT = """<joint name="axle" type="continuous"><parent link="base"/><child link="wheel"/>
  <origin xyz="0 0.1 0" rpy="0 0 0"/><axis xyz="0 1 0"/></joint>"""


def robot(inside: str) -> str:
    return f'<robot name="r">{inside}</robot>'


def body(inertial: str = "", shape: str = '<box size="1 1 1"/>', origin: str = "") -> str:
    return robot(
        f'<link name="base"><inertial>{inertial}</inertial>'
        f"<collision>{origin}<geometry>{shape}</geometry></collision></link>"
    )


def joint(kind: str = "continuous", inside: str = '<axis xyz="0 1 0"/>') -> str:
    ends = '<parent link="base"/><child link="wheel"/>'
    return robot(f'{LINKS}<joint name="axle" type="{kind}">{ends}{inside}</joint>')


@pytest.mark.parametrize(
    "text",
    [
        robot(LINKS + JOINT),
        robot('<link name="only"/>'),
        f'<?xml version="1.0" encoding="utf-8"?>\n{robot(LINKS + JOINT)}',
        body('<mass value="0"/><inertia ixx="1e-3" iyy="1" izz="1" ixy="-0.1"/>'),
        body(shape='<cylinder radius="0.1" length="2"/>', origin='<origin rpy="1e-3 0 -3.1"/>'),
        joint("revolute", '<limit lower="-1" upper="1" effort="9" velocity="3"/>'),
        joint("fixed", '<axis xyz="0 0 0"/>'),
        robot(LINKS + JOINT + '<gazebo reference="base"><mu1>0.2</mu1></gazebo>'),
    ],
)
def test_sane_robots_pass(text: str, tmp_path: Path) -> None:
    check_urdf(text, tmp_path / "robot.urdf")


RING = '<joint name="back" type="fixed"><parent link="wheel"/><child link="base"/></joint>'
MASS = '<mass value="{}"/>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (robot(LINKS), "exactly one root link, has 2: base, wheel"),
        (robot(LINKS + JOINT + RING), "ring"),
        (robot(LINKS + JOINT + '<link name="x"/><link name="y"/>'
               + RING.replace("back", "b1").replace("wheel", "x").replace("base", "y")
               + RING.replace("back", "b2").replace("wheel", "y").replace("base", "x")), "ring"),
        (robot(LINKS + JOINT + JOINT), "2 joints are called 'axle'"),
        (robot(LINKS + '<link name="base"/>' + JOINT), "2 links are called 'base'"),
        (robot("<link/>"), "a <link> has no name"),
        (robot(""), "has no link"),
        (robot(LINKS + JOINT.replace('parent link="base"', 'parent link="b"')), "link 'b' does"),
        (robot(LINKS + JOINT.replace('<child link="wheel"/>', "")), "needs one <child>, has 0"),
        (robot(LINKS + JOINT + JOINT.replace("axle", "other")), "child of two joints"),
        (joint("wobbly"), "the type 'wobbly' is none of fixed, continuous"),
        (joint("continuous", '<axis xyz="0 0 0"/>'), "points nowhere"),
        (joint("continuous", '<axis xyz="0 1"/>'), "3 numbers are needed"),
        (joint("revolute", ""), "needs a <limit>"),
        (joint("prismatic", '<limit lower="2" upper="1"/>'), "lower limit 2 is above the upper 1"),
        (joint("continuous", '<limit effort="-1" velocity="1"/>'), "effort is -1"),
        (joint("continuous", '<limit effort="nan" velocity="1"/>'), "'nan'"),
        (joint("continuous", '<dynamics damping="-2"/>'), "damping is -2"),
        (joint("continuous", '<origin xyz="0 0 inf"/>'), "'0 0 inf'"),
        (body(MASS.format("nan")), "value of <mass> is 'nan', not a finite sane number"),
        (body(MASS.format("inf")), "not a finite"),
        (body(MASS.format("heavy")), "'heavy', not a number"),
        (body(MASS.format("-1")), "mass is -1 kg"),
        (body(MASS.format("1 2")), "one number"),
        (body(MASS.format("1e300")), "not a finite sane"),
        (body("<mass/>"), "value of <mass> is missing"),
        (body('<inertia ixx="1" iyy="1"/>'), "izz of <inertia> is missing"),
        (body('<inertia ixx="-1" iyy="1" izz="1"/>'), "ixx is -1"),
        (body(shape='<box size="1 1"/>'), "3 numbers are needed"),
        (body(shape='<box size="1 -1 1"/>'), "size of a box is not above 0"),
        (body(shape='<box size="nan 1 1"/>'), "not a finite"),
        (body(shape='<sphere radius="0"/>'), "radius of a sphere is not above 0"),
        (body(shape='<cylinder radius="1"/>'), "length of <cylinder> is missing"),
        (body(shape='<cone radius="1"/>'), "shape 'cone' is none of box"),
        (body(shape=""), "one <geometry> with one shape"),
        (body(shape='<mesh filename="../m.stl"/>'), "must lie inside"),
        (body(shape='<mesh filename="/etc/passwd.stl"/>'), "must lie inside"),
        (body(shape='<mesh filename="link/out.stl"/>'), "must lie inside"),
        (body(shape='<mesh filename="file:///m.stl"/>'), "not a plain file name"),
        (body(shape='<mesh filename="package://p/m.stl"/>'), "not a plain file name"),
        (body(shape='<mesh filename="m.txt"/>'), "not a plain file name"),
        (body(shape='<mesh filename="gone.stl"/>'), "does not exist"),
        (body(shape='<mesh filename="m.stl" scale="1 0 1"/>'), "scale of a mesh is 0"),
        ("", "not well-formed"),
        ("not xml", "not well-formed"),
        (robot(LINKS)[:-9], "not well-formed"),
        ("<sdf/>", "begins with <sdf>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]>' + robot(LINKS + JOINT), "refused as XML"),
        ('<!DOCTYPE r SYSTEM "file:///etc/passwd">' + robot(LINKS), "refused as XML"),
        (robot("<a>" * 40 + "</a>" * 40), "deeper than 32"),
        (robot("<a/>" * 60_000), "more than 50,000 elements"),
        (robot("<!--" + "x" * 5_000_000 + "-->"), "at most 4,194,304 are read"),
    ],
)  # fmt: skip
def test_faults_are_named(text: str, words: str, tmp_path: Path) -> None:
    folder = tmp_path / "robots"
    folder.mkdir()
    (tmp_path / "m.stl").touch()
    (folder / "m.stl").touch()
    (folder / "link").symlink_to(tmp_path)
    (tmp_path / "out.stl").touch()
    with pytest.raises(InputRefused) as caught:
        check_urdf(text, folder / "robot.urdf")
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(folder / "robot.urdf"))


def test_a_mesh_inside_the_folder_passes(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box().export(tmp_path / "meshes" / "m.STL", file_type="stl")
    shape = '<mesh filename="./meshes//m.STL"/>'
    assert check_urdf(body(shape=shape), tmp_path / "robot.urdf") == ("meshes/m.STL",)


def test_xml_bombs_go_off_in_no_memory(tmp_path: Path) -> None:
    entities = '<!ENTITY a0 "xxxxxxxxxx">' + "".join(
        f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)
    )
    (tmp_path / "laughs").write_text(f"<!DOCTYPE r [{entities}]>{robot('&a9;')}")
    (tmp_path / "deep").write_text(robot("<a>" * 500_000 + "</a>" * 500_000))
    (tmp_path / "wide").write_text(robot("<a/>" * 900_000))
    chain = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(900)
    )
    links = "".join(f'<link name="l{i}"/>' for i in range(901))
    (tmp_path / "chain").write_text(robot(links + chain))
    done = run_limited(
        """
        import sys
        from pathlib import Path
        from slamsim.guard.errors import InputRefused
        from slamsim.guard.urdf import check_urdf
        for path in sorted(Path(sys.argv[1]).iterdir()):
            try:
                check_urdf(path.read_text(), path)
                print(path.name, "passed")
            except InputRefused:
                print(path.name, "refused")
        """,
        str(tmp_path),
    )
    assert done.stdout.split("\n")[:-1] == [
        "chain passed",
        "deep refused",
        "laughs refused",
        "wide refused",
    ]
