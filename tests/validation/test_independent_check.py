"""The independent check against pinocchio, all of its own points and a wrong claim."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import backhoe_planner as bp
from backhoe_planner.motion import build_problem

# opens the wall: the tree of balls is held against every point at the same moments and placements
from validation import independent_check
from validation.habitats import load_machine
from validation.signed_distances import obstacle_distance, voxels_distance
from validation.sites import SiteKey, random_site
from validation.surfaces import BRANCHES, link_shapes


@pytest.fixture(scope="module")
def plan() -> bp.Plan:
    robot = load_machine("planar4")
    return bp.plan(robot, random_site(robot, SiteKey("planar4", "cluttered", "goal", 1)).scene, effort="quick")


def test_the_independent_check_places_the_joints_as_pinocchio_does() -> None:
    robot = load_machine("panda")
    rng = np.random.default_rng(3)
    q = np.array([robot.random_q(rng) for _ in range(4)])
    data = robot.model.createData()
    for row, joints in enumerate(q):
        pin.forwardKinematics(robot.model, data, joints)
        for joint, (rotation, translation) in enumerate(independent_check._placements(robot, q)):
            np.testing.assert_allclose(rotation[row], data.oMi[joint].rotation, atol=1e-14)
            np.testing.assert_allclose(translation[row], data.oMi[joint].translation, atol=1e-14)


def test_the_independent_check_finds_the_least_distance_of_all_points(plan: bp.Plan) -> None:
    """Against every point of the cover at every moment, one by one."""
    found = {
        (least.link, least.obstacle): least.distance for least in independent_check.least_distances(plan, refine=2)
    }
    covers, _ = link_shapes(plan.robot)
    q = plan.trajectory.at(independent_check._finer(plan.trajectory.time, 2))
    placements = independent_check._placements(plan.robot, q)
    for spec in plan.scene.obstacles:
        distance = obstacle_distance(spec, plan.scene)
        for cover in covers:
            if cover.joint == 0:
                continue
            points = cover.points
            rotation, translation = placements[cover.joint]
            placed = points @ np.swapaxes(rotation, 1, 2) + translation[:, None]
            assert found[cover.link, spec.name] == pytest.approx(np.min(distance(placed.reshape(-1, 3))), abs=1e-12)


PLATE = """<robot name="plate"><link name="base"/><link name="arm"><collision><geometry><mesh filename="plate.stl"/>
</geometry></collision></link><joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


def test_a_link_that_is_a_flat_plate_has_the_distances_of_a_rectangle(tmp_path: Path) -> None:
    """1 m long and 0.4 m wide, it stands on its long edge."""
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.4], [0.0, 0.0, 0.4]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "plate.stl")
    (tmp_path / "plate.urdf").write_text(PLATE)
    _, [plate] = link_shapes(bp.load_robot(tmp_path / "plate.urdf"))
    at = np.array([[0.5, 0.3, 0.2], [0.5, -0.3, 0.2], [2.0, 0.0, 0.2], [0.5, 0.0, 0.7], [0.5, 0.0, 0.2]])
    np.testing.assert_allclose(plate.signed_distance(at), [0.3, 0.3, 1.0, 0.3, 0.0], atol=1e-7)


def test_every_ball_of_a_cover_contains_its_parts_down_to_the_leaves(plan: bp.Plan) -> None:
    covers, _ = link_shapes(plan.robot)
    assert max(len(cover.points) for cover in covers) > 100
    for cover in covers:
        inner = np.flatnonzero(cover.first >= 0)
        parts = [np.arange(cover.first[ball], cover.first[ball] + cover.children[ball]) for ball in inner.tolist()]
        assert sorted(np.concatenate([[0], *parts]).tolist()) == list(range(len(cover.first)))
        assert all(2 <= len(part) <= BRANCHES for part in parts)
        depth = np.zeros(len(cover.first), dtype=int)
        above = np.zeros(len(cover.first), dtype=int)
        for ball, part in zip(inner.tolist(), parts, strict=True):
            depth[part], above[part] = depth[ball] + 1, ball
        assert depth.max() <= np.ceil(np.log2(len(cover.points)) / np.log2(BRANCHES)) + 1
        held = np.flatnonzero(cover.first < 0)
        at, node = cover.centre[held], above[held]
        for _ in range(int(depth.max())):
            off = np.linalg.norm(at - cover.centre[node], axis=1) + cover.radius[held]
            assert np.all(off <= cover.radius[node] + 1e-12)
            node = above[node]


def test_a_too_large_claim_is_refuted(plan: bp.Plan) -> None:
    assert plan.verified
    assert independent_check.refutations(plan) == []
    entries = plan.certificate.clearances
    first = next(entry for entry in entries if entry.kind == "obstacle")
    # a proven distance is within 2 % of the true one, and the points are 4 cm apart
    raised = dataclasses.replace(first, distance=1.02 * first.distance + 0.03)
    others = tuple(raised if entry is first else entry for entry in entries)
    wrong = dataclasses.replace(plan, certificate=dataclasses.replace(plan.certificate, clearances=others))
    lines = independent_check.refutations(wrong)
    assert lines
    assert all(first.obstacle in line for line in lines)


def test_an_obstacle_of_one_leg_is_checked_in_that_leg_only() -> None:
    """A ball at the middle of the first leg's motion: in the way of that leg, absent in the second."""
    robot = load_machine("planar4")
    ends = [dict.fromkeys(robot.joint_names, value) for value in (0.0, 0.2, 0.4)]
    legs = [{"name": name, "goal": {"joints": end}} for name, end in zip(("first", "second"), ends[1:], strict=True)]
    content = {"version": 1, "start": {"joints": ends[0]}, "task": {"sequence": legs}}
    free = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    assert free.verified
    tip = free.tip_path()[free.legs[0].last // 2].tolist()
    ball = {"name": "ball", "shape": "sphere", "radius": 0.05, "position": tip}
    for name, wrong in (("first", True), ("second", False)):
        held = bp.scene_from_dict(content | {"obstacles": [ball | {"legs": [name]}]})
        lines = independent_check.refutations(dataclasses.replace(free, problem=build_problem(robot, held)))
        assert any("ball" in line for line in lines) == wrong


def test_the_distance_of_a_scan_is_that_of_its_nearest_voxel() -> None:
    rng = np.random.default_rng(5)
    points = np.column_stack((rng.uniform(-1.0, 1.0, (3000, 2)), rng.normal(0.0, 0.02, 3000)))
    edge = 0.1
    low = np.unique(np.floor(points / edge), axis=0) * edge
    at = rng.uniform(-1.5, 1.5, (300, 3))
    off = np.maximum(low[None] - at[:, None], at[:, None] - low[None] - edge)
    every = np.linalg.norm(np.maximum(off, 0.0), axis=2) + np.minimum(off.max(axis=2), 0.0)
    np.testing.assert_allclose(voxels_distance(points, edge)(at), every.min(axis=1), atol=1e-9)
