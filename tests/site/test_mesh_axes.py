"""Units and upward axes of mesh files written by hand: what counts, what is drawn, and what is warned of.

The block of every file spans 0 to 1 along its x, 0 to 2 along its y and 0 to 3 along its z.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.files.meshes.mesh_axes import mesh_axes
from backhoe_planner.machine import Robot, load_mesh, load_robot
from backhoe_planner.show.drawing.machine_meshes import machine_meshes
from backhoe_planner.show.drawing.site_meshes import site_mesh
from backhoe_planner.site import Scene, build_obstacles, input_warnings, obstacle_warnings, scene_from_dict

CORNERS = [(x, y, z) for z in (0, 3) for y in (0, 2) for x in (0, 1)]
SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
TRIANGLES = [three for a, b, c, d in SIDES for three in ((a, b, c), (a, c, d))]

ASSET = '<unit name="metre" meter="1"/><up_axis>Z_UP</up_axis>'
NODES = '<node><instance_geometry url="#block"/></node>'
THREE_MF = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


def collada(asset: str = ASSET, nodes: str = NODES, more: str = "") -> str:
    numbers = " ".join(str(number) for corner in CORNERS for number in corner)
    indices = " ".join(str(index) for three in TRIANGLES for index in three)
    times = "<created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>"
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{times}{asset}</asset>
<library_geometries><geometry id="block"><mesh><source id="p"><float_array id="a" count="24">{numbers}</float_array>
<technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p></triangles>{more}</mesh>
</geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def gltf(**changes: Any) -> dict[str, Any]:
    """The JSON of a glTF of the block, with its numbers in it."""
    vertices = np.array(CORNERS, dtype="<f4").tobytes()
    indices = np.array(TRIANGLES, dtype="<u2").tobytes()
    data = "data:application/octet-stream;base64," + base64.b64encode(vertices + indices).decode()
    extremes = {"min": [0, 0, 0], "max": [1, 2, 3]}
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", **extremes},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(vertices)},
            {"buffer": 0, "byteOffset": len(vertices), "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(vertices + indices), "uri": data}],
    } | changes  # fmt: skip


def as_glb(tree: dict[str, Any]) -> bytes:
    content = json.dumps(tree).encode()
    content += b" " * (-len(content) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(content), len(content), b"JSON") + content


def write_3mf(path: Path, attributes: str) -> None:
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in CORNERS)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in TRIANGLES)
    relations = "http://schemas.openxmlformats.org/package/2006/relationships"
    with zipfile.ZipFile(path, "w") as parts:
        target = 'Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"'
        parts.writestr("_rels/.rels", f'<Relationships xmlns="{relations}"><Relationship {target}/></Relationships>')
        parts.writestr(
            "3D/3dmodel.model",
            f'<model {attributes} xmlns="{THREE_MF}"><resources><object id="1" type="model"><mesh><vertices>{vertices}'
            f"</vertices><triangles>{triangles}</triangles></mesh></object></resources><build><item objectid='1'/>"
            "</build></model>",
        )


def scene_of(folder: Path, file: str, **keys: object) -> Scene:
    data: dict[str, Any] = {
        "version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0, 0, 0]}},
        "obstacles": [{"name": "block", "shape": "mesh", "file": file, **keys}],
    }  # fmt: skip
    return scene_from_dict(data, folder=folder, file=folder / "scene.yaml")


def spans(scene: Scene, robot: Robot) -> tuple[Matrix, Matrix]:
    """(2, 3) lowest and highest corner of the obstacle as it counts, and as it is drawn."""
    (obstacle,) = build_obstacles(scene, robot)
    drawn = site_mesh(obstacle, scene, centre=np.zeros(3), reach=5.0).bounds
    assert drawn is not None
    return obstacle.bounds, np.asarray(drawn)


def write(path: Path, kind: str) -> None:
    if kind == "glb":
        path.write_bytes(as_glb(gltf()))
    elif kind == "gltf":
        path.write_text(json.dumps(gltf()), encoding="utf-8")
    elif kind == "3mf":
        write_3mf(path, "")
    else:
        path.write_text(collada('<unit meter="0.01"/><up_axis>Y_UP</up_axis>'), encoding="utf-8")


Z_UP, Y_UP, X_UP = ([0, 0, 0], [1, 2, 3]), ([0, -3, 0], [1, 0, 2]), ([-2, -3, 0], [0, 0, 1])
SPANS: dict[str, tuple[str, dict[str, object], tuple[list[int], list[int]], float]] = {
    "GLB has y up": ("glb", {}, Y_UP, 1.0),
    "glTF has y up": ("gltf", {}, Y_UP, 1.0),
    "GLB with z up": ("glb", {"up": "z"}, Z_UP, 1.0),
    "DAE has its unit and z up": ("dae", {}, Z_UP, 0.01),
    "DAE with y up": ("dae", {"up": "y"}, Y_UP, 0.01),
    "DAE with x up": ("dae", {"up": "x"}, X_UP, 0.01),
    "DAE with a scale": ("dae", {"scale": 0.5}, Z_UP, 0.5),
    "3MF has millimetres": ("3mf", {}, Z_UP, 0.001),
    "3MF with a scale": ("3mf", {"scale": 1.0, "up": "y"}, Y_UP, 1.0),
}


@pytest.mark.parametrize(("kind", "keys", "span", "unit"), SPANS.values(), ids=SPANS.keys())
def test_a_mesh_counts_and_is_drawn_in_metres_and_upright(
    kind: str, keys: dict[str, object], span: tuple[list[int], list[int]], unit: float, planar4: Robot, tmp_path: Path
) -> None:
    write(tmp_path / f"block.{kind}", kind)
    for found in spans(scene_of(tmp_path, f"block.{kind}", position=[5, 6, 7], **keys), planar4):
        np.testing.assert_allclose(found, unit * np.array(span) + [5, 6, 7], atol=1e-9)


def test_three_factors_and_map_origin_are_along_the_axes_of_the_file(planar4: Robot, tmp_path: Path) -> None:
    """Less (1, 1, 1) the block spans -1 to 0, -1 to 1, -1 to 2, then by 2, 3, 4: y up it is 2 by 12 by 6."""
    write(tmp_path / "block.glb", "glb")
    scene = scene_of(tmp_path, "block.glb", scale=[2.0, 3.0, 4.0], map_origin=[1.0, 1.0, 1.0])
    for found in spans(scene, planar4):
        np.testing.assert_allclose(found, [[-2, -8, -3], [0, 4, 3]], atol=1e-9)


def test_a_mesh_with_a_map_origin_is_drawn_where_it_counts(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "block.dae").write_text(collada(), encoding="utf-8")
    for found in spans(scene_of(tmp_path, "block.dae", map_origin=[10.0, 0.0, 0.0]), planar4):
        np.testing.assert_allclose(found, [[-10, 0, 0], [-9, 2, 3]], atol=1e-9)


def test_the_map_origin_in_a_message_is_in_the_axes_of_the_file(planar4: Robot, tmp_path: Path) -> None:
    """A node 110 km along x, 300 m along y, which is up, and 120 km along z."""
    moved = gltf(nodes=[{"mesh": 0, "translation": [1.1e5, 300, 1.2e5]}])
    (tmp_path / "far.gltf").write_text(json.dumps(moved), encoding="utf-8")
    with pytest.raises(SceneError, match=r"`map_origin: \[11000[01], 300, 12000[12]\]` puts"):
        build_obstacles(scene_of(tmp_path, "far.gltf"), planar4)


@pytest.mark.parametrize(
    ("attributes", "unit"),
    [("unit='micron'", 1e-6), ("unit='centimeter'", 0.01), ("unit='inch'", 0.0254), ("unit='foot'", 0.3048)],
)
def test_a_3mf_is_in_its_unit(attributes: str, unit: float, planar4: Robot, tmp_path: Path) -> None:
    write_3mf(tmp_path / "block.3mf", attributes)
    (obstacle,) = build_obstacles(scene_of(tmp_path, "block.3mf", scale=None), planar4)
    np.testing.assert_allclose(obstacle.bounds[1], unit * np.array([1, 2, 3]), atol=1e-9)


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "inf", "0,01", "one"])
def test_a_unit_that_is_none_is_refused(unit: str, planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "block.dae").write_text(collada(f'<unit meter="{unit}"/>'), encoding="utf-8")
    with pytest.raises(
        SceneError, match=rf"block\.dae: asset > unit @meter: is not a unit; found '{unit}'; allowed: m"
    ):
        build_obstacles(scene_of(tmp_path, "block.dae"), planar4)
    write_3mf(tmp_path / "block.3mf", "unit='parsec'")
    with pytest.raises(SceneError, match=r"model @unit: is not a unit; found 'parsec'; allowed: micron, millimeter"):
        build_obstacles(scene_of(tmp_path, "block.3mf"), planar4)


@pytest.mark.parametrize("kind", ["3mf", "dae", "glb"])
def test_a_mesh_cut_anywhere_is_refused(kind: str, tmp_path: Path) -> None:
    file = tmp_path / f"block.{kind}"
    write(file, kind)
    whole = file.read_bytes()
    for length in range(0, len(whole) - 1, 150):
        file.write_bytes(whole[:length])
        with pytest.raises(InputError, match=rf"block\.{kind}"):
            load_mesh(file)
        if kind == "3mf":
            with pytest.raises(InputError, match=r"block\.3mf"):
                mesh_axes(file)


def test_an_axis_that_may_not_be_up_is_warned_of_until_the_scene_says_it(planar4: Robot, tmp_path: Path) -> None:
    (tmp_path / "y.dae").write_text(collada("<up_axis>Y_UP</up_axis>"), encoding="utf-8")
    (tmp_path / "z.dae").write_text(collada(), encoding="utf-8")
    write(tmp_path / "block.glb", "glb")
    by_trimesh = gltf(asset={"version": "2.0", "generator": "https://github.com/mikedh/trimesh"})
    (tmp_path / "own.glb").write_bytes(as_glb(by_trimesh))
    lying = {"rpy": [1.5708, 0, 0]}
    for file, keys, said in (
        ("y.dae", {}, r"the mesh y\.dae \(block\) says that y is up, which is not applied.*`up: y`.*`up: z`"),
        ("own.glb", {}, r"own\.glb \(block\) was written by trimesh.*`up: y` if y is up, `up: z` confirms z"),
        ("block.glb", lying, r"block\.glb \(block\) has y up and is turned.*turns it again: `up: z`"),
        ("z.dae", lying, None),
        ("block.glb", {}, None),
        ("block.glb", {"up": "y", **lying}, None),
        ("y.dae", {"up": "z"}, None),
        ("own.glb", {"up": "z"}, None),
        ("own.glb", {"up": "y"}, None),
    ):
        scene = scene_of(tmp_path, file, **keys)
        found = " ".join(input_warnings(planar4, scene))
        assert file not in " ".join(input_warnings(planar4, scene, is_planned=True))  # it was said before
        if said is None:
            assert file not in found
        else:
            assert re.search(said, found), file


def test_a_mesh_as_large_or_small_as_in_other_units_is_warned_of(planar4: Robot, tmp_path: Path) -> None:
    """The arm reaches 4 m: 3,000 m are 750 times as far, 3 mm less than a thousandth part, 3 m and 0.3 m neither."""
    (tmp_path / "block.dae").write_text(collada(), encoding="utf-8")
    write(tmp_path / "block.3mf", "3mf")
    for file, keys, said in (
        ("block.dae", {"scale": 1000.0}, "block (block.dae) is 3,000 m large, 750 times as far as the machine"),
        ("block.dae", {"scale": 1e4}, "is 30,000 m large, 7,"),
        ("block.3mf", {}, "is 3 mm large, 0.00075 times as far as the machine reaches, at a scale of 0.001, which its"),
        ("block.3mf", {"scale": 0.1}, None),
        ("block.dae", {}, None),
    ):
        found = " ".join(obstacle_warnings(planar4, build_obstacles(scene_of(tmp_path, file, **keys), planar4)))
        assert (said or "") in found
        assert ("`scale` is 0.001 for a file in millimetres" in found) == (said is not None)


URDF = """<robot name="r"><link name="base"/><link name="arm">
<collision><geometry><mesh filename="{0}" scale="1 2 3"/></geometry></collision>
<visual><geometry><mesh filename="{0}" scale="1 2 3"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [("dae", [0, 0, 0], [0.01, 0.04, 0.09]), ("glb", [0, -6, 0], [1, 0, 6]), ("3mf", [0, 0, 0], [1e-3, 4e-3, 9e-3])],
)
def test_links_of_a_urdf_count_and_are_drawn_alike(
    kind: str, low: list[float], high: list[float], tmp_path: Path
) -> None:
    """As in RViz: the unit of a DAE counts, its upward axis does not, y of a glTF is up; then the URDF scales."""
    write(tmp_path / f"block.{kind}", kind)
    (tmp_path / "arm.urdf").write_text(URDF.format(f"block.{kind}"), encoding="utf-8")
    robot = load_robot(tmp_path / "arm.urdf")
    solid = np.vstack([piece.piece.hull for piece in robot.pieces])
    (drawn,), warnings = machine_meshes(robot)
    assert warnings == ()
    for points in (solid, drawn.facets.vertices):
        np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [low, high], atol=1e-7)


@pytest.mark.parametrize(("scale", "said"), [("1000 1 1", "drawn 1e+03 m"), ("0.001 0.001 0.001", "drawn 0.003 m")])
def test_a_link_that_is_drawn_in_other_units_than_it_counts_is_warned_of(scale: str, said: str, tmp_path: Path) -> None:
    """It counts as 1 by 2 by 3 m."""
    (tmp_path / "block.dae").write_text(collada(), encoding="utf-8")
    head, visual, end = URDF.format("block.dae").replace("1 2 3", "1 1 1").partition("<visual>")
    for factor, warned in ((scale, True), ("0.1 0.1 0.1", False)):
        text = head + visual + end.replace("1 1 1", factor)
        (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
        _, warnings = machine_meshes(load_robot(tmp_path / "arm.urdf"))
        expected = f"link arm: it is {said} large, and its collision shape is 3 m large; `scale`"
        assert [warning.startswith(expected) for warning in warnings] == [True] * warned


@pytest.mark.parametrize(("scale", "size"), [("1000 1 1", "1e+03 m"), ("1e-5 1e-5 1e-5", "3e-05 m"), ("1 1 1", None)])
def test_a_mesh_of_a_link_in_other_units_is_warned_of(scale: str, size: str | None, tmp_path: Path) -> None:
    """The joint is 0.5 m from its parent: 1 km is 2,000 times as far, 3e-5 m are a 17,000th part, 3 m are 6 times."""
    (tmp_path / "block.dae").write_text(collada(), encoding="utf-8")
    text = URDF.format("block.dae").replace("1 2 3", scale).replace("<axis", '<origin xyz="0.3 0 0.4"/><axis')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    warnings = load_robot(tmp_path / "arm.urdf").warnings
    said = f"do not fit the distances between the joints, in all 0.5 m: arm (block.dae, {size}); `scale`"
    assert [said in warning for warning in warnings] == [True] * (size is not None)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "Draco": ({"extensionsUsed": ["KHR_draco_mesh_compression"]}, "is compressed; found KHR_draco_mesh_compression"),
    "meshopt": ({"extensionsRequired": ["EXT_meshopt_compression"]}, "extensionsUsed: is compressed"),
    "instances": ({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "repeats its parts by an extension"),
    "unknown": ({"extensionsRequired": ["ACME_folds"]}, "needs an extension that is not known; found ACME_folds"),
    "skeleton": ({"nodes": [{"mesh": 0, "skin": 0}]}, r"nodes\[0\]\.skin: is posed by a skeleton"),
    "weights": ({"nodes": [{"mesh": 0, "weights": [0.5]}]}, r"nodes\[0\]\.weights: has weights of other shapes"),
    "fan": (
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 6}]}]},
        r"meshes\[0\]\.primitives\[0\]\.mode: has triangles as a fan; found 6",
    ),
}


@pytest.mark.parametrize(("changes", "said"), REFUSED.values(), ids=REFUSED.keys())
def test_a_gltf_of_which_something_would_be_left_out_is_refused(
    changes: dict[str, Any], said: str, tmp_path: Path
) -> None:
    (tmp_path / "block.glb").write_bytes(as_glb(gltf(**changes)))
    with pytest.raises(InputError, match=rf"block\.glb: .*{said}"):
        load_mesh(tmp_path / "block.glb")


def test_a_gltf_with_extensions_of_colours_is_read(tmp_path: Path) -> None:
    names = ["KHR_materials_unlit", "KHR_texture_transform"]
    (tmp_path / "block.glb").write_bytes(as_glb(gltf(extensionsRequired=names, extensionsUsed=names)))
    np.testing.assert_array_equal(load_mesh(tmp_path / "block.glb").bounds, [[0, 0, 0], [1, 2, 3]])


@pytest.mark.parametrize(
    ("nodes", "more", "said"),
    [
        (NODES + '<node><instance_geometry url="#gone"/></node>', "", "refers to a part that is not in the.*'#gone'"),
        (NODES + '<node><instance_geometry url="b.dae#x"/></node>', "", "refers to a part.*'b.dae#x'"),
        (NODES + '<node><instance_controller url="#c"/></node>', "", "is posed by a skeleton"),
        (NODES.replace("<node>", "<node><skew>45 1 0 0 0 1 0</skew>"), "", "has a part that is skewed"),
        (NODES, "<polygons><ph><p>0 1 2</p><h>0 1 2</h></ph></polygons>", "has a polygon with a hole"),
    ],
)
def test_a_dae_of_which_something_would_be_left_out_is_refused(
    nodes: str, more: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "block.dae").write_text(collada(nodes=nodes, more=more), encoding="utf-8")
    with pytest.raises(InputError, match=rf"block\.dae: line \d+: {said}"):
        load_mesh(tmp_path / "block.dae")
