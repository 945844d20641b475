"""Paths of arms with continuous joints: a turn more or less is the same configuration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import PathCost, build_problem
from backhoe_planner.planning import PathLayers
from validation.pose_arms import write_arm

SHOULDER, ELBOW, RADIUS = 0.25, 0.2, 0.35  # m: the links, and the tip's distance from the base


@pytest.fixture
def crank(tmp_path: Path) -> bp.Robot:
    """Two links in the plane; the first joint is continuous, the second turns from 0 to 3 rad."""
    rate = 'velocity="1" effort="100"'
    parts = ['<link name="base"/>', *(f'<link name="{name}">{inertia()}</link>' for name in ("one", "two", "tip"))]
    places = (
        ("continuous", "base", "one", 0.0, rate),
        ("revolute", "one", "two", SHOULDER, f'{rate} lower="0" upper="3"'),
    )
    for kind, parent, child, x, limit in places:
        parts.append(
            f'<joint name="to_{child}" type="{kind}"><origin xyz="{x} 0 0"/><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 1"/><limit {limit}/></joint>'
        )
    parts.append(
        f'<joint name="to_tip" type="fixed"><origin xyz="{ELBOW} 0 0"/><parent link="two"/><child link="tip"/></joint>'
    )
    path = tmp_path / "crank.urdf"
    path.write_text(f'<robot name="crank">{"".join(parts)}</robot>')
    return bp.load_robot(path)


def inertia() -> str:
    shape = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
    return f'<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>{shape}'


def circle(turns: float) -> list[dict[str, list[float]]]:
    angles = np.linspace(0.0, 2.0 * np.pi * turns, 25)
    return [{"position": [RADIUS * np.cos(a), RADIUS * np.sin(a), 0.0]} for a in angles.tolist()]


@pytest.mark.parametrize(("turns", "first"), [(1.0, 0.0), pytest.param(-1.0, 20.0, marks=pytest.mark.long)])
def test_a_path_around_the_base_turns_the_continuous_joint_once(crank: bp.Robot, turns: float, first: float) -> None:
    """From whatever turn the joint begins in; it never jumps back by a turn on passing pi."""
    bend = np.arccos((RADIUS**2 - SHOULDER**2 - ELBOW**2) / (2.0 * SHOULDER * ELBOW))
    start = {"to_one": first, "to_two": float(bend)}
    task = {"path": {"waypoints": circle(turns), "tolerance": 0.002}}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": start}, "task": task})
    plan = bp.plan(crank, scene, effort="quick")
    assert plan.verified, plan.message
    q = plan.trajectory.q
    on_path = -np.arctan2(ELBOW * np.sin(bend), SHOULDER + ELBOW * np.cos(bend))
    begin = on_path + 2.0 * np.pi * np.round((first - on_path) / (2.0 * np.pi))
    assert np.min(np.abs(q[:, 0] - begin)) < 1e-6
    assert q[-1, 0] == pytest.approx(begin + 2.0 * np.pi * turns, abs=1e-6)
    assert np.max(np.abs(np.diff(q[:, 0]))) < 0.05


def test_nodes_of_a_layer_differ_modulo_a_turn(tmp_path: Path) -> None:
    robot = bp.load_robot(write_arm("gen3", tmp_path))
    np.testing.assert_array_equal(robot.continuous, [True, False] * 3 + [True])
    at = bp.Kinematics(robot).at(np.array([3.1, 0.5, -3.0, 1.6, 3.0, 0.9, -3.1]))
    target = TipTarget(at.tip_position, None, at.tip_rotation)
    (nodes,) = PathLayers(robot, grid=0.2).at(np.zeros(1), [target])
    assert len(nodes) > 20
    assert np.max(np.abs(nodes[:, robot.continuous])) <= np.pi + 1e-12
    off = nodes[:, None] - nodes[None]
    off[..., robot.continuous] = (off[..., robot.continuous] + np.pi) % (2.0 * np.pi) - np.pi
    apart = np.max(np.abs(off), axis=2) + 10.0 * np.eye(len(nodes))
    assert np.min(apart) > 0.09  # half of a grid cell
    for q in nodes[:5]:
        position, angle = target.distances(bp.Kinematics(robot).at(q))
        assert max(position, angle) < 1e-7


def test_a_step_across_half_a_turn_costs_as_much_as_elsewhere(crank: bp.Robot) -> None:
    task = {"path": {"waypoints": circle(0.5)}}
    cost = PathCost(
        build_problem(crank, bp.scene_from_dict({"version": 1, "task": task, "objective": "velocity_norm"}))
    )
    across = cost.step_costs(np.array([[3.1, 1.0]]), np.array([[-3.1, 1.0]]), 0.1)
    plain = cost.step_costs(np.array([[0.0, 1.0]]), np.array([[2.0 * np.pi - 6.2, 1.0]]), 0.1)
    np.testing.assert_allclose(across, plain, rtol=1e-9)


def test_only_continuous_joints_are_reduced_by_whole_turns(crank: bp.Robot) -> None:
    q = np.array([[7.0, 7.0], [-3.5, -3.5]])
    np.testing.assert_allclose(crank.reduce_unchecked(q), [[7.0 - 2.0 * np.pi, 7.0], [2.0 * np.pi - 3.5, -3.5]])
    near = crank.reduce_unchecked(q, near=np.array([20.0, 0.0]))
    np.testing.assert_allclose(near, [[7.0 + 4.0 * np.pi, 7.0], [8.0 * np.pi - 3.5, -3.5]])


def test_costs_of_steps_are_infinite_exactly_where_a_joint_would_move_too_far(tmp_path: Path) -> None:
    """With few pairs in reach, which are found joint by joint, and with all of them."""
    robot = bp.load_robot(write_arm("gen3", tmp_path))
    task = {"path": {"waypoints": circle(0.5)}}
    cost = PathCost(build_problem(robot, bp.scene_from_dict({"version": 1, "task": task})))
    rng = np.random.default_rng(3)
    many = np.array([robot.random_q(rng) for _ in range(30)])
    for a, b in ((many, many + 0.9 * rng.uniform(-1.0, 1.0, many.shape)), (many[:1], many[:1] + 0.01 * many)):
        b[:, robot.continuous] += 2.0 * np.pi
        change = b[None] - a[:, None]
        change[..., robot.continuous] = (change[..., robot.continuous] + np.pi) % (2.0 * np.pi) - np.pi
        near = np.max(np.abs(change), axis=2) <= 0.7
        found = cost.step_costs(a, b, 0.05)
        assert near.any()
        np.testing.assert_array_equal(np.isfinite(found), near)
        for row, column in np.argwhere(near)[::7].tolist():
            alone = cost.step_costs(a[[row]], b[[column]], 0.05)
            assert found[row, column] == pytest.approx(float(alone[0, 0]), rel=1e-12)


def test_configurations_near_each_other_are_found_modulo_a_turn(tmp_path: Path) -> None:
    """As by comparing each with each, whether along a joint or with a tree: the latter for many in one place."""
    robot = bp.load_robot(write_arm("gen3", tmp_path))
    layers, rng = PathLayers(robot, grid=0.1), np.random.default_rng(4)
    few = np.array([robot.random_q(rng) for _ in range(60)])
    for q in (np.vstack((few, few[:40] + rng.uniform(-0.06, 0.06, (40, 7)))), np.tile(few[:2], (400, 1))):
        q[::2, robot.continuous] += 2.0 * np.pi
        change = q[None] - q[:, None]
        change[..., robot.continuous] -= 2.0 * np.pi * np.round(change[..., robot.continuous] / (2.0 * np.pi))
        near = np.argwhere(np.triu(np.max(np.abs(change), axis=2) <= 0.05, 1))
        found = layers._close_pairs(q, 0.05)
        assert len(near) > 10
        np.testing.assert_array_equal(found[np.lexsort(found.T[::-1])], near)
