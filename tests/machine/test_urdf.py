"""Reading a URDF: errors name file and element, and nothing else is printed."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import trimesh

from backhoe_planner.errors import RobotError
from backhoe_planner.machine import example_names, load_robot, read_urdf, shipped_file, shipped_folder

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
JOINT = (
    f'<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
)
ARM = '<link name="arm"/>'
INERTIAL = '<link name="arm"><inertial><mass value="1"/><inertia %s/></inertial></link>'
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'


def robot_xml(joint: str = JOINT, arm: str = ARM) -> str:
    """Two links and the joint between them."""
    return f'<robot name="tiny"><link name="base"/>{joint}{arm}</robot>'


def hinge(kind: str = "revolute", inside: str = f'<axis xyz="0 0 1"/>{LIMIT}', parent: str = "base") -> str:
    return f'<joint name="hinge" type="{kind}"><parent link="{parent}"/><child link="arm"/>{inside}</joint>'


def solid(shape: str, kind: str = "collision") -> str:
    return f'<link name="arm"><{kind}><geometry>{shape}</geometry></{kind}></link>'


def limit(attributes: str) -> str:
    return robot_xml(hinge(inside=f"<limit {attributes}/>"))


BROKEN = {
    "empty file": ("", ["empty"]),
    "only blanks": (" \n ", ["empty"]),
    "not XML": ("version: 1\n", ["not well-formed XML"]),
    "unclosed element": ('<robot name="tiny"><link name="base">', ["not well-formed XML"]),
    "wrong root": ('<sdf version="1.6"/>', ["<sdf>", "<robot>"]),
    "robot without a name": (robot_xml().replace(' name="tiny"', ""), ["no name"]),
    "no link": ('<robot name="tiny"/>', ["no link"]),
    "link without a name": (robot_xml(arm=ARM + "<link/>"), ["<link> has no name"]),
    "joint without a name": (robot_xml(JOINT.replace(' name="hinge"', "")), ["<joint> has no name"]),
    "joint without a parent": (robot_xml(JOINT.replace('<parent link="base"/>', "")), ["joint 'hinge'", "<parent"]),
    "joint without a child": (robot_xml(JOINT.replace('<child link="arm"/>', "")), ["joint 'hinge'", "<child"]),
    "two geometries in one shape": (
        robot_xml(arm=solid('<sphere radius="1"/></geometry><geometry><box size="1 1 1"/>')),
        ["link 'arm' > collision", "more than one <geometry>"],
    ),
    "two limits of one joint": (robot_xml(hinge(inside=LIMIT + LIMIT)), ["joint 'hinge'", "more than one <limit>"]),
    "two links of one name": (robot_xml(arm=ARM + ARM), ["two links", "arm"]),
    "two joints of one name": (
        robot_xml(JOINT + JOINT.replace('"arm"', '"hand"'), ARM + '<link name="hand"/>'),
        ["two joints", "hinge"],
    ),
    "link on two joints": (
        robot_xml(JOINT + JOINT.replace('"hinge"', '"other"')),
        ["link 'arm'", "two joints", "'hinge'", "'other'"],
    ),
    "two trees": (robot_xml(arm=ARM + '<link name="loose"/>'), ["one tree", "base, loose"]),
    "everything in one loop": (
        robot_xml(
            JOINT
            + JOINT.replace('"hinge"', '"back"')
            .replace('"arm"', '"x"')
            .replace('"base"', '"arm"')
            .replace('"x"', '"base"')
        ),
        ["one tree", "a loop"],
    ),
    "joint from a link to itself": (robot_xml(hinge(parent="arm")), ["loop", "arm"]),
    "unknown parent, like a known one": (
        robot_xml(hinge(parent="bose")),
        ["joint 'hinge'", "parent link does not exist", "bose", "did you mean 'base'?"],
    ),
    "unknown child": (robot_xml(JOINT, '<link name="boom"/>'), ["joint 'hinge'", "child link does not exist", "arm"]),
    "no limit": (robot_xml(hinge(inside='<axis xyz="0 0 1"/>')), ["joint 'hinge'", "<limit>", "lower, upper"]),
    "no limit on a slide": (robot_xml(hinge("prismatic", "")), ["joint 'hinge'", "<limit>"]),
    "limit without lower": (limit('upper="1" effort="1" velocity="1"'), ["joint 'hinge'", "lower and upper"]),
    "lower equals upper": (limit('lower="1" upper="1"'), ["joint 'hinge'", "lower limit is not below upper"]),
    "lower above upper": (limit('lower="2" upper="1"'), ["joint 'hinge'", "lower 2.0, upper 1.0"]),
    "NaN limit": (limit('lower="nan" upper="1"'), ["joint 'hinge' > limit @lower", "not a finite number", "'nan'"]),
    "infinite limit": (limit('lower="-1" upper="inf"'), ["joint 'hinge' > limit @upper", "not a finite number"]),
    "word for a number": (limit('lower="-1" upper="one"'), ["joint 'hinge' > limit @upper", "not a number", "'one'"]),
    "nothing for a number": (limit('lower="" upper="1"'), ["joint 'hinge' > limit @lower", "not a finite number"]),
    "two numbers for one": (limit('lower="-1" upper="1 2"'), ["joint 'hinge' > limit @upper", "has 2 numbers"]),
    "negative rate": (limit('lower="-1" upper="1" effort="1" velocity="-1"'), ["joint 'hinge'", "negative", "-1"]),
    "negative effort": (limit('lower="-1" upper="1" effort="-5"'), ["joint 'hinge' > limit @effort", "negative"]),
    "rate of no machine": (
        limit('lower="-1" upper="1" velocity="1e-5"'),
        ["@velocity", "too small", "at least 0.0001"],
    ),
    "effort of no machine": (limit('lower="-1" upper="1" effort="1e-300"'), ["@effort", "too small", "1e-06, or 0"]),
    "endless rate": (limit('lower="-1" upper="1" velocity="1e100"'), ["@velocity", "too large", "up to 1e+12"]),
    "endless range": (limit('lower="-1e300" upper="1"'), ["@lower", "too large", "a joint that turns for ever is"]),
    "shape out of sight": (
        robot_xml(arm=solid('<sphere radius="1"/>').replace("<geo", '<origin xyz="1e200 0 0"/><geo')),
        ["link 'arm' > collision > origin @xyz", "too large", "up to 100000"],
    ),
    "sphere beyond any site": (robot_xml(arm=solid('<sphere radius="1e300"/>')), ["sphere @radius", "too large"]),
    "entities": (
        '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>' + robot_xml().replace('"tiny"', '"&b;"'),
        ["entities of its own", "written out"],
    ),
    "no acceleration": (
        robot_xml(JOINT.replace("/></joint>", ' acceleration="0"/></joint>')),
        ["limit @acceleration", "greater than 0"],
    ),
    "zero axis": (robot_xml(hinge(inside=f'<axis xyz="0 0 0"/>{LIMIT}')), ["joint 'hinge'", "axis has no direction"]),
    "axis of two numbers": (robot_xml(hinge(inside=f'<axis xyz="0 1"/>{LIMIT}')), ["> axis @xyz", "has 2 numbers"]),
    "floating joint": (robot_xml(hinge("floating")), ["joint 'hinge'", "floating", "revolute, continuous, prismatic"]),
    "planar joint": (robot_xml(hinge("planar")), ["joint 'hinge'", "planar", "revolute, continuous, prismatic"]),
    "spherical joint": (robot_xml(hinge("spherical")), ["joint 'hinge'", "spherical", "revolute"]),
    "unknown joint type": (robot_xml(hinge("rotary")), ["joint 'hinge'", "unknown joint type", "rotary"]),
    "no joint type": (robot_xml(JOINT.replace(' type="revolute"', "")), ["joint 'hinge'", "unknown joint type"]),
    "negative radius": (robot_xml(arm=solid('<sphere radius="-1"/>')), ["link 'arm' > collision", "@radius", "'-1'"]),
    "zero length": (robot_xml(arm=solid('<cylinder radius="1" length="0"/>')), ["cylinder @length", "greater than 0"]),
    "negative edge": (robot_xml(arm=solid('<box size="1 -1 1"/>', "visual")), ["link 'arm' > visual", "box @size"]),
    "box of two edges": (robot_xml(arm=solid('<box size="1 1"/>')), ["box @size", "has 2 numbers"]),
    "box without a size": (robot_xml(arm=solid("<box/>")), ["link 'arm' > collision", "box: has no size"]),
    "sphere without a radius": (robot_xml(arm=solid("<sphere/>")), ["sphere: has no radius"]),
    "mesh without a file": (robot_xml(arm=solid("<mesh/>")), ["link 'arm' > collision", "mesh: has no filename"]),
    "empty geometry": (robot_xml(arm=solid("")), ["link 'arm' > collision", "found none", "box, sphere"]),
    "no geometry": (robot_xml(arm='<link name="arm"><visual/></link>'), ["link 'arm' > visual", "found none"]),
    "unknown shape": (robot_xml(arm=solid('<cone radius="1"/>')), ["link 'arm' > collision", "<cone>", "box, sphere"]),
    "mesh scaled to nothing": (robot_xml(arm=solid('<mesh filename="a.stl" scale="1 0 1"/>')), ["@scale", "not be 0"]),
    "mesh scale of two numbers": (robot_xml(arm=solid('<mesh filename="a.stl" scale="1 2"/>')), ["@scale", "1 or 3"]),
    "negative mass": (
        robot_xml(arm=f'<link name="arm"><inertial><mass value="-1"/>{INERTIA}</inertial></link>'),
        ["link 'arm' > inertial > mass", "negative"],
    ),
    "negative inertia": (
        robot_xml(arm=INERTIAL % ('ixx="-.5" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"')),
        ["link 'arm' with what is fixed", "negative principal moment", "found -0.5 kg m^2", "0 or more"],
    ),
    "inertia negative about a slanted axis": (  # [[1, 2], [2, 1]] has the moments 3 and -1
        robot_xml(arm=INERTIAL % ('ixx="1" ixy="2" ixz="0" iyy="1" iyz="0" izz="1"')),
        ["link 'arm' with what is fixed", "found -1 kg m^2"],
    ),
    "inertial without mass": (
        robot_xml(arm=f'<link name="arm"><inertial>{INERTIA}</inertial></link>'),
        ["link 'arm' > inertial", "<mass>"],
    ),
    "half an inertia": (
        robot_xml(arm='<link name="arm"><inertial><mass value="1"/><inertia ixx="1"/></inertial></link>'),
        ["link 'arm' > inertial > inertia", "ixy"],
    ),
    "colour without a number": (
        robot_xml(arm=ARM + '<material name="paint"><color rgba="red"/></material>'),
        ["cannot be read", "red"],
    ),
    "colour without a number beside a mesh": (
        robot_xml(arm=solid('<mesh filename="a.stl"/>') + '<material name="paint"><color rgba="red"/></material>'),
        ["cannot be read", "red"],
    ),
    "missing mesh": (
        robot_xml(arm=solid('<mesh filename="meshes/arm.stl"/>')),
        ["link 'arm' > collision", "mesh file not found", "meshes/arm.stl", "relative to the URDF"],
    ),
    "missing visual mesh": (
        robot_xml(arm=solid('<mesh filename="meshes/arm.dae"/>', "visual")),
        ["link 'arm' > visual", "mesh file not found"],
    ),
    "missing mesh of a package": (
        robot_xml(arm=solid('<mesh filename="package://digger/arm.stl"/>')),
        ["link 'arm' > collision", "package://digger/arm.stl", "ROS_PACKAGE_PATH"],
    ),
}


@pytest.mark.parametrize(("xml", "said"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_urdf_is_refused_naming_file_and_element(
    xml: str, said: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken.urdf"
    path.write_text(xml)
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    for fragment in said:
        assert fragment in message
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


@pytest.mark.parametrize(("content", "said"), [(b"", "empty"), (b"no triangles in here", "triangles")])
def test_errors_in_mesh_files_name_link_and_urdf(
    content: bytes, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.stl").write_bytes(content)
    path = tmp_path / "tiny.urdf"
    path.write_text(robot_xml(arm=solid('<mesh filename="arm.stl"/>')))
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    for fragment in (str(path), "link 'arm' > collision", "arm.stl", said):
        assert fragment in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_flat_mesh_in_a_tilted_plane_and_a_flat_cylinder_may_be_links(tmp_path: Path) -> None:
    """coal would end the process at either."""
    turn = trimesh.transformations.euler_matrix(0.3, 0.2, 0.1)
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]], [[0, 1, 2], [1, 3, 2]])
    sheet.apply_transform(turn).export(tmp_path / "sheet.stl")
    path = tmp_path / "tiny.urdf"
    for shape in ('<mesh filename="sheet.stl"/>', '<cylinder radius="1" length="1e-9"/>'):
        path.write_text(robot_xml(arm=solid(shape)))
        assert [piece.link for piece in load_robot(path).pieces] == ["arm"]


HARMLESS = {
    "empty dynamics": hinge(inside=f'<axis xyz="0 0 1"/>{LIMIT}<dynamics/>'),
    "empty safety controller": hinge(inside=f'<axis xyz="0 0 1"/>{LIMIT}<safety_controller/>'),
    "empty calibration": hinge(inside=f'<axis xyz="0 0 1"/>{LIMIT}<calibration/>'),
    "continuous joint without limit": hinge("continuous", '<axis xyz="0 0 1"/>'),
}


@pytest.mark.parametrize("joint", HARMLESS.values(), ids=HARMLESS.keys())
def test_urdfs_about_which_only_the_c_parser_complains_are_accepted_silently(
    joint: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tiny.urdf"
    path.write_text(
        robot_xml(
            joint,
            '<link name="arm"><visual><geometry><sphere radius="1"/></geometry>'
            '<material name="nowhere"/></visual></link>',
        )
    )
    assert load_robot(path).joint_names == ("hinge",)
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_named_and_the_shipped_example_suggested(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"nowhere\.urdf: no such URDF file.*example:backhoe"):
        read_urdf(tmp_path / "nowhere.urdf")


def test_a_folder_is_refused_as_a_urdf(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="is a folder") as caught:
        read_urdf(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_robot_error_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such URDF file"):
        read_urdf(tmp_path / "nowhere.urdf")


def test_an_unknown_example_is_an_error_that_suggests_the_nearest() -> None:
    with pytest.raises(RobotError) as caught:
        read_urdf("example:bakhoe")
    said = str(caught.value)
    assert said.startswith("example:bakhoe: no such example robot; found bakhoe; allowed: backhoe, ")
    # of many names there are the eight most similar ones
    assert said.endswith(f" and {len(example_names()) - 8} others (did you mean 'backhoe'?)")


@pytest.mark.parametrize("name", ["excavator", "Excavators", "digger"])
def test_other_words_for_a_backhoe_suggest_the_example(name: str) -> None:
    with pytest.raises(RobotError, match=rf"example:{name}: no such example robot.*did you mean 'backhoe'\?"):
        read_urdf(f"example:{name}")


def test_examples_are_the_shipped_models_and_those_of_example_robot_data() -> None:
    names = example_names()
    assert names == sorted(names)
    assert {"backhoe", "planar4", "panda", "ur5", "xarm7"} <= set(names)


def test_shipped_models_are_found_by_name() -> None:
    assert read_urdf("example:backhoe").path == shipped_folder("models") / "backhoe.urdf"


@pytest.mark.parametrize("source", ["models/backhoe.urdf", "backhoe.urdf"])
def test_shipped_models_are_found_from_any_folder(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert read_urdf(source).path == shipped_folder("models") / "backhoe.urdf"


def test_a_file_in_the_working_folder_is_preferred_to_the_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("backhoe.urdf").write_text(robot_xml())
    assert read_urdf("backhoe.urdf").robot.name == "tiny"


def test_the_urdf_record_keeps_source_digest_and_acceleration_limits(tmp_path: Path) -> None:
    path = tmp_path / "tiny.urdf"
    path.write_text(limit('lower="-1" upper="1" effort="1" velocity="1" acceleration="0.7"'))
    urdf = read_urdf(path)
    assert urdf.source == str(path)
    assert urdf.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert urdf.acceleration == {"hinge": 0.7}
    assert urdf.leaves == ("arm",)
    assert [joint.name for joint in urdf.chain("arm")] == ["hinge"]


def test_comments_and_elements_outside_links_and_joints_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "tiny.urdf"
    extras = '<!-- radius="-1" --><gazebo><verbose value="Yes"/><limit lower="a"/></gazebo>'
    path.write_text(robot_xml(arm='<link name="arm"><verbose value="Yes"/></link>' + extras))
    assert b"<!--" not in read_urdf(path).xml


def test_names_beyond_ascii_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "tiny.urdf"
    path.write_text(robot_xml().replace('"arm"', '"Löffel"').replace('"hinge"', '"Gelenk ß"'), encoding="utf-8")
    robot = load_robot(path)
    assert (robot.tip, robot.joint_names) == ("Löffel", ("Gelenk ß",))


@pytest.mark.parametrize("uri", ["package://digger/meshes/arm.stl", "file://{root}/digger/meshes/arm.stl"])
def test_meshes_with_package_and_file_uris_are_found(uri: str, tmp_path: Path) -> None:
    mesh = tmp_path / "digger" / "meshes" / "arm.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box().export(mesh)
    path = tmp_path / "digger" / "urdf" / "tiny.urdf"
    path.parent.mkdir()
    path.write_text(robot_xml(arm=solid(f'<mesh filename="{uri.format(root=tmp_path)}"/>')))
    assert len(load_robot(path).pieces) == 1


def test_packages_are_found_through_ros_package_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tmp_path / "elsewhere" / "digger" / "arm.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box().export(mesh)
    path = tmp_path / "tiny.urdf"
    path.write_text(robot_xml(arm=solid('<mesh filename="package://digger/arm.stl"/>')))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    urdf = read_urdf(path)
    assert urdf.mesh_path("package://digger/arm.stl") == mesh


def test_a_shipped_file_is_found_by_its_name_alone_or_with_leading_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own = shipped_folder("scenes") / "jobs" / "drain_with_a_fall.yaml"
    for named in ("drain_with_a_fall.yaml", "scenes/drain_with_a_fall.yaml", "scenes/jobs/drain_with_a_fall.yaml"):
        assert shipped_file(Path(named), "scenes/jobs") == own
    for other in (Path("jobs/drain_with_a_fall.yaml"), Path("none.yaml"), tmp_path / own.name):
        assert shipped_file(other, "scenes/jobs") == other
    Path(own.name).write_text("")
    assert shipped_file(Path(own.name), "scenes/jobs") == Path(own.name)
