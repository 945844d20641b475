"""Drawing without a browser: names, shells, camera, messages."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import umsgpack

from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import Kinematics, Robot, load_robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.show import (
    FAR,
    FIELD_OF_VIEW,
    ITSELF,
    TIGHT,
    Display,
    PlanAnimation,
    SceneGraph,
    Track,
    blocks,
    facets,
    fattened,
    frame,
    grid,
    hills,
    kept_axes,
    machine_meshes,
    margin_rgb,
    mesh_of_many,
    node_name,
    node_names,
    part_behind,
    site_mesh,
    solid,
    timeline,
    together,
    tube,
)
from backhoe_planner.show.drawing import site_meshes
from backhoe_planner.site import build_obstacles, scene_from_dict

GOAL = {"goal": {"position": [3.0, 1.0, 0.0]}}
START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}


def test_a_node_name_is_one_level_of_the_tree() -> None:
    assert "/" not in node_name("a/b")
    assert node_name("  ") == "_"
    assert node_name("__proto__") != "__proto__"
    assert node_name("gas pipe") == "gas pipe"


def test_names_that_would_share_a_node_get_different_ones() -> None:
    nodes = node_names(["a/b", "a\N{DIVISION SLASH}b", "c"])
    assert len(set(nodes.values())) == 3


@pytest.mark.parametrize("clearance", [0.0, 0.3])
def test_the_shell_of_a_box_is_the_clearance_away(clearance: float) -> None:
    size = np.array([1.0, 2.0, 0.5])
    piece = shapes.box(size, pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([1.0, 2.0, 3.0])))
    shell = fattened(piece.hull, clearance)
    local = (shell.vertices - piece.placement.translation) @ piece.placement.rotation
    outside = np.linalg.norm(np.maximum(np.abs(local) - size / 2.0, 0.0), axis=1)
    assert outside.max() <= clearance + 1e-9
    assert outside.min() >= 0.98 * clearance
    # the rounded box of Steiner's formula, less what the ball's facets cut off
    exact = 1.0 + 7.0 * clearance + np.pi * 3.5 * clearance**2 + 4.0 / 3.0 * np.pi * clearance**3
    assert shell.volume == pytest.approx(exact, rel=0.01)


def test_a_drawn_capsule_has_its_volume() -> None:
    drawn = solid(shapes.capsule(0.2, 1.5, pin.SE3.Identity()))
    assert drawn.volume == pytest.approx(np.pi * 0.04 * 1.5 + 4.0 / 3.0 * np.pi * 0.008, rel=0.02)


def test_a_box_keeps_its_edges_and_a_ball_is_smooth() -> None:
    box = facets(trimesh.creation.box(extents=[1.0, 1.0, 1.0]))
    assert len(box.vertices) == 24  # three normals at each corner
    assert np.allclose(np.sort(np.abs(box.normals), axis=1)[:, 2], 1.0)
    ball = facets(trimesh.creation.icosphere(subdivisions=3))
    assert len(ball.vertices) == 642
    np.testing.assert_allclose(ball.normals, ball.vertices, atol=0.02)


@pytest.mark.parametrize(("roughness", "walls"), [(0.06, 0), (0.0, 2 * 4 * 11)])
def test_ground_is_drawn_from_above_with_sharp_edges_only_at_walls(
    tmp_path: Path, roughness: float, walls: int
) -> None:
    """20 x 20 cells: rough ones that meet at up to 60 degrees, or a pit, 2 m deep, between upright walls."""
    heights = roughness * np.random.default_rng(2).normal(size=(21, 21))
    if walls:
        heights[5:15, 5:15] -= 2.0
    np.savetxt(tmp_path / "ground.csv", heights, delimiter=",")
    turn = [0.3, 0.0, 1.0]
    ground = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [4.0, 4.0], "rpy": turn}
    task = {"goal": {"position": [1.0, 0.0, 1.0]}}
    content = {"version": 1, "start": {"joints": {}}, "task": task, "obstacles": [ground]}
    scene = scene_from_dict(content, folder=tmp_path)
    (obstacle,) = build_obstacles(scene, load_robot("example:planar4"))
    drawn = site_mesh(obstacle, scene, centre=np.zeros(3), reach=5.0)
    assert drawn.one_sided
    assert (drawn.facets.normals @ pin.rpy.rpyToMatrix(*turn)[:, 2] > 0.0).all()
    corners = len(np.unique(drawn.facets.vertices.round(9), axis=0))
    assert corners == heights.size
    split = len(drawn.facets.vertices) - corners
    assert min(walls, 4 * 9) <= split <= walls  # there is one vertex more at most of those along both rims


@pytest.mark.parametrize(("depth", "is_drawn"), [(0.5, False), (0.0, True)])
def test_level_ground_is_not_drawn_over_lower_scanned_ground(
    backhoe: Robot, tmp_path: Path, depth: float, is_drawn: bool
) -> None:
    """Points within 3 m of (4, 0): a heap on ground `depth` below the machine's, which a sheet would hide."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(1.0, 7.01, 0.1), np.arange(-3.0, 3.01, 0.1)))
    heap = np.exp(-((x - 4.0) ** 2 + y**2))
    np.savetxt(tmp_path / "scan.xyz", np.column_stack((x, y, heap - depth)), fmt="%.3f")
    scan = {"name": "scan", "shape": "pointcloud", "file": "scan.xyz", "resolution": 0.1}
    task = {"goal": {"position": [3.0, 0.0, 2.0]}}
    content = {"version": 1, "start": {"joints": START}, "task": task, "obstacles": [scan]}
    display = Display()
    SceneGraph(display.visualizer(), build_problem(backhoe, scene_from_dict(content, folder=tmp_path)))
    (message,) = [content for key, content in display.messages().items() if key[:2] == ("set_object", "/ground/sheet")]
    assert isinstance(message, bytes)
    (geometry,) = umsgpack.unpackb(message)["object"]["geometries"]
    packed, rows = (geometry["data"][key] for key in ("attributes", "index"))
    vertices = np.frombuffer(packed["position"]["array"].data, dtype=np.float32).reshape(-1, 3)
    corners = vertices[np.frombuffer(rows["array"].data, dtype=np.uint32).reshape(-1, 3), :2]
    middles = corners.mean(axis=1)
    inside = (np.abs(middles - [4.0, 0.0]) < 2.9).all(axis=1)
    assert inside.any() == is_drawn


@pytest.mark.parametrize(("top", "is_ground"), [(0.03, False), (0.0, True)])
def test_the_top_of_a_low_table_before_an_arm_is_not_the_ground(panda: Robot, top: float, is_ground: bool) -> None:
    table = {"name": "table", "shape": "box", "size": [0.6, 0.8, 0.02], "position": [0.7, 0.0, top - 0.01]}
    task = {"goal": {"position": [0.5, 0.0, 0.4]}}
    start = {"joints": dict(zip(panda.joint_names, panda.middle.tolist(), strict=True))}
    content = {"version": 1, "tip": "panda_hand_tcp", "start": start, "task": task, "obstacles": [table]}
    graph = SceneGraph(Display().visualizer(), build_problem(panda, scene_from_dict(content)))
    assert (graph._below_ground()[0] is not None) == is_ground


def test_a_tube_follows_its_line() -> None:
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5]])
    points = tube(line, 0.05, tolerance=0.003).vertices
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(low, [-0.05, -0.05, -0.05], atol=0.01)
    np.testing.assert_allclose(high, [1.05, 1.05, 0.55], atol=0.01)
    assert len(tube(np.zeros((1, 3)), 0.05, tolerance=0.003).faces) > 0
    assert len(tube(np.zeros((4, 3)), 0.05, tolerance=0.003).faces) > 0


def test_margin_colours_saturate_at_both_ends() -> None:
    assert margin_rgb(-0.1, 0.6) == margin_rgb(0.0, 0.6) == TIGHT
    assert margin_rgb(0.3, 0.6) == margin_rgb(9.0, 0.6) == FAR


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.7, 2.4])
@pytest.mark.parametrize("ceiling", [None, 4.0])
def test_the_camera_has_every_point_in_view(aspect: float, ceiling: float | None) -> None:
    points = np.random.default_rng(3).uniform([-4, -2, -1], [6, 5, 3], size=(200, 3))
    view = frame(points, side=1.0, ceiling=ceiling)
    eye = view.eye(aspect)
    right = np.cross([0.0, 0.0, 1.0], view.direction)
    right /= np.linalg.norm(right)
    up = np.cross(view.direction, right)
    depth = (eye - points) @ view.direction
    assert depth.min() > 0.0
    half = np.tan(FIELD_OF_VIEW / 2.0)
    assert np.max(np.abs((points - eye) @ up) / depth) <= half
    assert np.max(np.abs((points - eye) @ right) / depth) <= half * aspect * 1.03  # the table is interpolated
    assert view.direction[1] > 0.0


def test_a_box_hides_only_what_is_behind_it() -> None:
    """Seen from the origin, its near face, 1 m wide and 2 m away, hides a width of 3 m at 6 m."""
    boxes, eye = np.array([[[2.0, -0.5, -1.0], [2.5, 0.5, 1.0]]]), np.zeros(3)
    points = np.array([[6.0, y, 0.0] for y in (-3.0, -1.6, -1.4, 0.0, 1.4, 1.6, 3.0, 9.0)])
    assert part_behind(boxes, points, eye) == 3 / 8
    assert part_behind(boxes, points[3:4] / 3.0, eye) == 0.0  # on its face
    assert part_behind(boxes, np.array([[2.2, 0.1, 0.0]]), eye) == 0.0  # in it
    assert part_behind(boxes, -points, eye) == 0.0  # behind the camera
    assert part_behind(boxes, points, np.array([2.2, 0.0, 0.0])) == 0.0  # from within
    assert part_behind(np.zeros((0, 2, 3)), points, eye) == 0.0
    side_by_side = np.array([[[2.0, y, -1.0], [2.5, y + 1.0, 1.0]] for y in (-1.0, 0.0)])
    assert part_behind(side_by_side, points[3:4], eye) == 1.0  # through the face between them


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_camera_takes_the_side_from_which_the_machine_is_visible(side: float) -> None:
    points = np.random.default_rng(4).uniform([-2, -1, 0], [4, 1, 2], size=(60, 3))
    left = np.array([[-9.0, 1.5, 0.0], [9.0, 1.8, 6.0]])
    right = np.array([[-9.0, -1.8, 0.0], [9.0, -1.5, 6.0]])

    def seen(walls: list[Matrix]) -> tuple[float, float]:
        """The camera's side, and the part of the machine that walls hide."""
        view = frame(points, side=side, hidden=partial(part_behind, np.array(walls), points))
        return float(np.sign(view.direction[1])), part_behind(np.array(walls), points, view.eye())

    assert seen([left if side < 0.0 else right]) == (side, 0.0)  # it stands behind the machine
    assert seen([left if side > 0.0 else right]) == (-side, 0.0)
    blind = part_behind(np.array([left, right]), points, frame(points, side=side).eye())
    assert seen([left, right])[1] < 0.5 * blind


def test_only_the_last_message_about_a_node_is_kept() -> None:
    display = Display()
    node = display.visualizer()["machine"]["boom"]
    for x in (1.0, 2.0):
        node.set_transform(trimesh.transformations.translation_matrix([x, 0.0, 0.0]))
    display.visualizer()["site"].set_property("visible", False)
    ((_, message), (key, _)) = display.messages().items()
    assert isinstance(message, bytes)
    assert umsgpack.unpackb(message)["matrix"][12:15] == [2.0, 0.0, 0.0]
    assert key == ("set_property", "/site", "visible")
    display.visualizer()["machine"].delete()
    assert [key[1] for key in display.messages()] == ["/site"]


def test_a_track_is_packed_as_32_bit_numbers() -> None:
    values = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    animation = PlanAnimation([Track("/machine/boom", "position", np.array([0.0, 0.5]), values)], 0.5)
    (clip,) = animation.lower()
    (track,) = clip["clip"]["tracks"]
    assert (track["name"], track["type"], clip["clip"]["fps"]) == (".position", "vector3", 1)
    np.testing.assert_array_equal(np.frombuffer(track["values"].data, "<f4").reshape(2, 3), values)


def test_links_are_drawn_where_pinocchio_places_them(backhoe: Robot) -> None:
    scene = scene_from_dict({"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}})
    display = Display()
    graph = SceneGraph(display.visualizer(), build_problem(backhoe, scene))
    q = np.array([0.3, 0.5, -1.2, -0.4])
    graph.move(q)
    drawn = {key[1]: message for key, message in display.messages().items() if key[0] == "set_transform"}
    data = backhoe.model.createData()
    pin.forwardKinematics(backhoe.model, data, q)
    for link in ("swing_post", "boom", "stick", "bucket"):
        message = drawn[f"/machine/{link}"]
        assert isinstance(message, bytes)
        matrix = np.array(umsgpack.unpackb(message)["matrix"]).reshape(4, 4).T
        joint = next(visual.joint for visual in backhoe.visuals if visual.link == link)
        np.testing.assert_allclose(matrix, data.oMi[joint].homogeneous, atol=1e-12)
    assert graph.warnings == ()


def test_every_goal_is_drawn_and_a_joint_goal_as_the_tips_frame(backhoe: Robot) -> None:
    goals = [{"position": [3.0, 1.0, 0.0]}, {"position": [3.0, -1.0, 0.0], "pitch": [-2.0, -1.5]}, {"joints": START}]
    scene = scene_from_dict({"version": 1, "start": {"joints": START}, "task": {"goal": goals}})
    display = Display()
    SceneGraph(display.visualizer(), build_problem(backhoe, scene))
    drawn = {key[1] for key in display.messages() if key[0] == "set_object"}
    assert {f"/task/goal {number}" for number in (1, 2, 3)} <= {path.removesuffix("/<object>") for path in drawn}
    assert {path for path in drawn if path.startswith("/task/goal 3/")} >= {f"/task/goal 3/{axis}" for axis in "xyz"}
    assert any(path.startswith("/task/goal 2/pitch") for path in drawn)


def test_the_hills_of_a_ground_are_its_high_parts() -> None:
    """Ground of 40 x 40 m with a bank of 5 m from x = 30 m on, in boxes of 1 m."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.25, 40.1, 0.5), np.arange(0.25, 40.1, 0.5)))
    ground = np.column_stack((x, y, np.where(x > 30.0, 5.0, 0.0)))
    boxes = hills(ground, above=0.5)
    np.testing.assert_allclose(boxes[:, 1, 2], 5.0)
    np.testing.assert_allclose(boxes[:, 0, 2], 0.0)
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    assert 29.0 < low[0] <= 30.25 + 1e-9
    assert high[0] >= 39.75
    assert low[1] <= 0.25
    assert high[1] >= 39.75
    assert hills(ground, above=6.0).shape == (0, 2, 3)
    behind = np.array([[20.0, 20.0, 1.0]])
    assert part_behind(boxes, behind, np.array([45.0, 20.0, 3.0])) == 1.0  # through the bank
    assert part_behind(boxes, behind, np.array([5.0, 20.0, 3.0])) == 0.0


def test_the_camera_is_on_the_open_side_of_a_bank(backhoe: Robot, tmp_path: Path) -> None:
    """A bank of 8 m, 6 m in front of the machine: from behind it nothing of the machine would be seen."""
    heights = np.full((61, 61), -0.2)
    heights[:, 36:] = 8.0  # from x = 6 m on
    np.savetxt(tmp_path / "bank.csv", heights, delimiter=",", fmt="%.2f")
    bank = {"name": "bank", "shape": "heightmap", "file": "bank.csv", "size": [60.0, 60.0]}
    content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
    scene = scene_from_dict({**content, "obstacles": [bank]}, folder=tmp_path)
    eye = SceneGraph(Display().visualizer(), build_problem(backhoe, scene)).view().eye()
    assert eye[0] < 5.0


def test_a_camera_does_not_look_through_a_house_of_a_scan_around_the_machine(backhoe: Robot, tmp_path: Path) -> None:
    """A house of 6 m along the machine's left or right side, in a scan with the street on both sides."""
    street = np.column_stack((*(axis.ravel() for axis in np.mgrid[-9:10:0.2, -9:9.1:0.2]), np.full(95 * 91, -0.3)))
    x, y, z = (axis.ravel() for axis in np.mgrid[-9:10:0.2, 5:9.1:0.2, -0.3:6.0:0.2])
    house = np.column_stack((x, y, z))[(np.abs(y - 7.0) > 1.9) | (z > 5.8)]
    for side in (1.0, -1.0):
        np.savetxt(tmp_path / "scan.csv", np.vstack((street, house * [1.0, side, 1.0])), delimiter=",", fmt="%.2f")
        scan = {"name": "scan", "shape": "pointcloud", "file": "scan.csv", "resolution": 0.25}
        content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
        scene = scene_from_dict({**content, "obstacles": [scan]}, folder=tmp_path)
        eye = SceneGraph(Display().visualizer(), build_problem(backhoe, scene)).view().eye()
        assert eye[1] * side < 5.0


def test_the_blocks_of_a_scan_are_its_high_parts_with_what_is_below_free() -> None:
    """A line along y, 5 m above the ground, over 40 m: in boxes of 1 m."""
    line = np.column_stack((np.full(81, 0.5), np.linspace(0.0, 40.0, 81), np.full(81, 5.5)))
    ground = line * [1.0, 1.0, 0.0]
    boxes = blocks(np.vstack((ground, line)), above=0.5)
    assert boxes.shape == (41, 2, 3)
    np.testing.assert_allclose(boxes[:, :, 2], np.tile([5.0, 6.0], (41, 1)))
    np.testing.assert_allclose(boxes[:, :, 0], np.tile([0.0, 1.0], (41, 1)))
    below = np.array([[2.0, 20.0, 1.0]])
    assert part_behind(boxes, below, np.array([-5.0, 20.0, 1.0])) == 0.0


def row_of_balls(count: int, **keys: Any) -> list[dict[str, Any]]:
    """Balls of 0.5 m radius, 3 m apart from 30 m on, along x: out of reach."""
    balls: list[dict[str, Any]] = [
        {"name": f"ball {number}", "shape": "sphere", "radius": 0.5, "position": [30.0 + 3.0 * number, 0.0, 0.0]}
        for number in range(count)
    ]
    balls[0] |= keys
    return balls


def site_nodes(robot: Robot, obstacles: list[dict[str, Any]], *, each: bool = False) -> tuple[SceneGraph, set[str]]:
    """The picture of a site, and the nodes of its obstacles."""
    content = {"version": 1, "start": {"joints": dict.fromkeys(robot.joint_names, 0.1)}, "task": GOAL}
    display = Display()
    graph = SceneGraph(
        display.visualizer(), build_problem(robot, scene_from_dict({**content, "obstacles": obstacles})), each=each
    )
    paths = {key[1] for key in display.messages() if key[0] == "set_object"}
    return graph, {path.split("/")[2] for path in paths if path.startswith("/site/")}


def test_many_obstacles_out_of_reach_are_drawn_as_one(planar4: Robot) -> None:
    near: dict[str, Any] = {"name": "far away", "shape": "box", "size": [1.0, 1.0, 1.0], "position": [3.0, 3.0, 0.5]}
    graph, nodes = site_nodes(planar4, [near, *row_of_balls(51)])
    assert nodes == {"far away", "far away_"}  # the second is the node of all 51 balls
    assert graph.drawn_as_one == {f"ball {number}" for number in range(51)}
    assert set(graph.anchors) == {"far away"}
    boxes = [{**near, "name": one["name"], "position": one["position"]} for one in row_of_balls(51)]
    for obstacles, each in ((boxes, True), (boxes[:50], False)):
        graph, nodes = site_nodes(planar4, obstacles, each=each)
        assert nodes == {one["name"] for one in obstacles}
        assert not graph.drawn_as_one


def test_among_many_boxes_the_hidden_part_is_found_from_some_of_the_points() -> None:
    """Half of 40,000 points are behind 20 walls, one behind the other."""
    walls = np.array([[[x, 0.0, -1.0], [x + 0.1, 50.0, 9.0]] for x in np.arange(5.0, 7.0, 0.1)])
    points = np.random.default_rng(6).uniform([10.0, -10.0, 0.0], [11.0, 10.0, 1.0], (40_000, 3))
    assert part_behind(walls, points, np.zeros(3)) == pytest.approx(0.5, abs=0.02)


def test_a_fine_hull_is_grown_along_its_normals() -> None:
    """10,242 corners on a ball of 1 m, grown by 0.1 m: not the hull of all their 1.7 million surroundings."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    grown = fattened(np.asarray(ball.vertices), 0.1)
    assert len(grown.faces) == len(ball.faces)
    np.testing.assert_allclose(np.linalg.norm(grown.vertices, axis=1), 1.1, atol=1e-4)
    assert grown.volume > 0.0


def test_a_fine_convex_mesh_is_drawn_with_fewer_triangles(
    planar4: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site_meshes, "_MOST_TRIANGLES", 1000)
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.stl")  # 5,120 triangles
    mesh = {"name": "ball", "shape": "mesh", "file": "ball.stl", "position": [3.0, 3.0, 0.0]}
    content = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
    scene = scene_from_dict({**content, "obstacles": [mesh]}, folder=tmp_path)
    (obstacle,) = build_obstacles(scene, planar4)
    drawn = site_mesh(obstacle, scene, centre=np.zeros(3), reach=5.0)
    assert drawn.shell is not None
    for surface, radius in ((drawn.facets, 1.0), (drawn.shell, 1.05)):
        assert 100 < len(surface.faces) <= 1000
        away = np.linalg.norm(surface.vertices - [3.0, 3.0, 0.0], axis=1)
        np.testing.assert_allclose(away, radius, atol=0.01)


def test_round_obstacles_have_fewer_triangles_among_many(planar4: Robot) -> None:
    content = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
    scene = scene_from_dict({**content, "obstacles": row_of_balls(1)})
    (ball,) = build_obstacles(scene, planar4)
    for among, faces in ((1, 1280), (200, 80)):
        drawn = site_mesh(ball, scene, centre=np.zeros(3), reach=5.0, among=among)
        assert drawn.shell is not None
        assert len(drawn.facets.faces) == len(drawn.shell.faces) == faces  # 20 times 4 for each subdivision
        away = np.linalg.norm(drawn.shell.vertices - [30.0, 0.0, 0.0], axis=1)
        np.testing.assert_allclose(away, 0.5 + 0.05)


@pytest.mark.parametrize("keys", [{"velocity": [-1.0, 0.0, 0.0]}, {"appears_at": 2.0}])
def test_what_moves_or_appears_far_away_has_a_node_of_its_own(planar4: Robot, keys: dict[str, Any]) -> None:
    graph, nodes = site_nodes(planar4, row_of_balls(52, **keys))
    assert nodes == {"ball 0", "far away"}
    assert "ball 0" not in graph.drawn_as_one


def test_obstacles_drawn_as_one_have_their_places_and_colours(backhoe: Robot) -> None:
    pole = {"name": "pole", "shape": "cylinder", "radius": 0.1, "length": 4.0, "position": [-40.0, 1.0, 2.0]}
    content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
    scene = scene_from_dict({**content, "obstacles": [*row_of_balls(2), pole]})
    obstacles = build_obstacles(scene, backhoe)
    drawn = mesh_of_many(obstacles)
    assert drawn.rgba is not None
    for obstacle, low, high in zip(
        obstacles, ([29.5, -0.5, -0.5], [32.5, -0.5, -0.5], [-40.1, 0.9, 0.0]),
        ([30.5, 0.5, 0.5], [33.5, 0.5, 0.5], [-39.9, 1.1, 4.0]), strict=True,
    ):  # fmt: skip
        own = (np.abs(drawn.vertices[:, 0] - low[0] - 0.5) < 1.1) & (drawn.vertices[:, 0] < high[0] + 0.2)
        own &= drawn.vertices[:, 0] > low[0] - 0.2
        np.testing.assert_allclose(drawn.vertices[own].min(axis=0), low, atol=0.05)
        np.testing.assert_allclose(drawn.vertices[own].max(axis=0), high, atol=0.05)
        alone = site_mesh(obstacle, scene, centre=np.zeros(3), reach=5.0)
        np.testing.assert_array_equal(drawn.rgba[own], np.tile(alone.rgba, (own.sum(), 1)))


def test_frames_without_an_obstacle_keep_the_margins_to_the_others(backhoe: Robot) -> None:
    near = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2.9, 0.0, -1.9]}
    content = {"version": 1, "start": {"joints": START}, "task": {"goal": {"position": [3.0, 1.0, 0.0]}}}
    problem = build_problem(backhoe, scene_from_dict({**content, "obstacles": [*row_of_balls(2), near]}))
    frames = timeline(problem, Trajectory.from_steps(np.array([0.0, 0.1]), np.tile([0.0, 0.4, -1.6, -0.9], (2, 1))))
    less = frames.without({"ball 0", "ball 1"})
    assert less.obstacles == ("ball", ITSELF)
    np.testing.assert_array_equal(less.margins(0), frames.margins(2))
    assert np.isfinite(less.margins(0)).all()


def test_a_timeline_ends_with_the_motion_and_has_the_nearest_points(backhoe: Robot) -> None:
    scene = scene_from_dict(
        {
            "version": 1,
            "start": {"joints": START},
            "task": {"goal": {"position": [3.0, 1.0, 0.0]}},
            "obstacles": [
                {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2.9, 0.0, -1.9], "clearance": 0.1},
                {"name": "far", "shape": "sphere", "radius": 0.2, "position": [90.0, 0.0, 0.0]},
            ],
        }
    )
    q = np.array([[0.0, 0.4, -1.6, -0.9], [0.5, 0.4, -1.6, -0.9]])
    frames = timeline(build_problem(backhoe, scene), Trajectory.from_steps(np.array([0.0, 1.01]), q))
    assert frames.obstacles == ("ball", "far", ITSELF)
    assert frames.time[-1] == 1.01
    np.testing.assert_allclose(frames.q[-1], q[-1])
    assert np.all(np.diff(frames.time) <= 1.0 / 30.0 + 1e-9)
    assert np.all(np.isnan(frames.margins(1)))
    spot = frames.nearest[0][0]
    assert spot is not None
    assert spot.distance == pytest.approx(np.linalg.norm(spot.point_obstacle - spot.point_link))
    assert spot.margin == pytest.approx(spot.distance - 0.1)


def test_an_unreadable_mesh_is_replaced_and_reported(tmp_path: Path) -> None:
    (tmp_path / "broken.dae").write_text("this is not a mesh")
    (tmp_path / "arm.urdf").write_text(
        """<robot name="arm"><link name="base"/>
        <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
          <limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
        <link name="arm">
          <visual><geometry><mesh filename="broken.dae"/></geometry></visual>
          <collision><geometry><box size="1 0.1 0.1"/></geometry></collision>
        </link></robot>"""
    )
    meshes, warnings = machine_meshes(load_robot(tmp_path / "arm.urdf"))
    assert [drawn.link for drawn in meshes] == ["arm"]
    np.testing.assert_allclose(np.ptp(meshes[0].facets.vertices, axis=0), [1.0, 0.1, 0.1])
    assert len(warnings) == 1
    assert "broken.dae" in warnings[0]
    assert "arm" in warnings[0]


def test_mesh_colours_come_from_their_files(panda: Robot) -> None:
    meshes, warnings = machine_meshes(panda)
    assert warnings == ()
    assert {drawn.link for drawn in meshes} >= {"panda_link0", "panda_link7", "panda_hand"}
    assert any(max(drawn.rgba[:3]) < 0.3 for drawn in meshes)  # its black parts
    assert any(min(drawn.rgba[:3]) > 0.95 for drawn in meshes)  # its white ones


def test_the_meshes_of_a_machine_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A copy with other limits looks the same; a machine that is loaded again may not."""
    (tmp_path / "arm.urdf").write_text(
        """<robot name="arm"><link name="base"/><link name="arm">
          <visual><geometry><mesh filename="arm.stl"/></geometry></visual>
          <collision><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
          <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
          <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    trimesh.creation.box(extents=[1.0, 0.1, 0.1]).export(tmp_path / "arm.stl")
    read, load = [], trimesh.load_scene

    def counting(file: Path) -> trimesh.Scene:
        read.append(file.name)
        return load(file)

    monkeypatch.setattr(trimesh, "load_scene", counting)
    robot = load_robot(tmp_path / "arm.urdf")
    first, again = machine_meshes(robot), machine_meshes(replace(robot, limits=replace(robot.limits)))
    assert again is first
    assert read == ["arm.stl"]
    machine_meshes(load_robot(tmp_path / "arm.urdf"))
    assert read == ["arm.stl", "arm.stl"]


def test_the_lines_of_a_grid_lie_in_their_plane_on_round_numbers() -> None:
    """A wall through (3, 2.25, 1) across y: lines at whole metres of x and z, none beyond the rim."""
    lines = grid(np.array([3.0, 2.25, 1.0]), np.array([0.0, 1.0, 0.0]), 2.5, (1.0, 0.5, 0.0, 0.8))
    np.testing.assert_allclose(lines.vertices[:, 1], 2.25, atol=1e-12)
    away = np.linalg.norm(lines.vertices - [3.0, 2.25, 1.0], axis=1)
    assert away.max() < 2.5 + 0.02
    # every strip is 3 cm wide around its line
    pairs = lines.vertices.reshape(-1, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1), 0.03, atol=1e-12)
    middles = pairs.mean(axis=1).reshape(-1, 33, 3)
    constant = [line[0, axis] for line in middles for axis in (0, 2) if np.ptp(line[:, axis]) < 1e-9]
    assert sorted(round(value, 9) for value in constant) == [-1.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 5.0]
    assert lines.rgba is not None
    assert lines.rgba[:, 3].max() <= 0.8
    both = together(lines, lines)
    assert len(both.vertices) == 2 * len(lines.vertices)
    np.testing.assert_array_equal(both.faces[len(lines.faces) :], lines.faces + len(lines.vertices))


def test_the_axis_that_is_kept_is_drawn_at_the_tip_and_within_its_cone(backhoe: Robot) -> None:
    """At the start, the axis of the bucket that is kept leans by 0.1 rad; 0.2 rad are allowed."""
    pitch = START["boom"] + START["stick"] + START["bucket"] + 0.1
    axis = [float(np.sin(pitch)), 0.0, float(np.cos(pitch))]
    task = {"goal": {"joints": START}, "keep": {"tilt": {"axis": axis, "tolerance": 0.2}}}
    problem = build_problem(backhoe, scene_from_dict({"version": 1, "start": {"joints": START}, "task": task}))
    (kept,) = kept_axes(problem, scale=1.0)
    at = Kinematics(backhoe).at(np.array(list(START.values())))
    data = backhoe.model.createData()
    pin.forwardKinematics(backhoe.model, data, at.q)
    arrow = np.array([data.oMi[kept.joint].act(corner) for corner in kept.arrow.vertices]) - at.tip_position
    assert kept.cone is not None
    long = arrow[np.argmax(np.linalg.norm(arrow, axis=1))]
    assert np.arccos(long[2] / np.linalg.norm(long)) == pytest.approx(0.1, abs=1e-6)
    rim = kept.cone.vertices[np.linalg.norm(kept.cone.vertices, axis=1) > 0.1]
    np.testing.assert_allclose(np.arccos(rim[:, 2] / np.linalg.norm(rim, axis=1)), 0.2, atol=1e-6)
    assert kept_axes(replace(problem, keep=None), scale=1.0) == ()
