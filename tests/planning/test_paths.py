"""Paths with known answers: where detours begin and end, which elbow passes, and why none does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reasons import nearest, obstruction, span

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import OBJECTIVES, PathCost, Problem, build_problem, step_lengths
from backhoe_planner.planning import (
    Layering,
    PathLayers,
    PathResolver,
    Resolution,
    Stretch,
    compare_with_law,
    redundancy_of,
    smooth_stretch,
)
from backhoe_planner.planning.report import comparison
from validation.habitats import load_machine
from validation.independent_check import refutations
from validation.sites import SiteKey, random_site

Data = dict[str, Any]

CLEARANCE = 0.02
BALL = 0.05  # at the elbow arm's tip
LINE = [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0]]

# two links of 1 m, 4 cm thick, and a ball of 5 cm at the tip; every point in reach has elbow up and elbow down
ELBOW = """<robot name="elbow">
  <link name="base"/>
  <link name="upper"><collision><origin xyz="0.5 0 0" rpy="0 1.5707963 0"/>
    <geometry><cylinder radius="0.02" length="0.96"/></geometry></collision></link>
  <link name="lower"><collision><origin xyz="0.5 0 0" rpy="0 1.5707963 0"/>
    <geometry><cylinder radius="0.02" length="0.96"/></geometry></collision></link>
  <link name="tip"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
    <origin xyz="1 0 0"/><limit lower="-2.9" upper="2.9" velocity="1" effort="100"/></joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="1 0 0"/></joint>
</robot>"""


def site(points: list[list[float]], obstacles: list[Data] | None = None, **keys: Any) -> bp.Scene:
    path = {"waypoints": [{"position": point} for point in points]} | keys
    content = {"version": 1, "task": {"path": path}, "clearance": CLEARANCE, "obstacles": obstacles or []}
    return bp.scene_from_dict(content)


def ball(x: float, y: float, radius: float) -> Data:
    return {"name": "ball", "shape": "sphere", "radius": radius, "position": [x, y, 0.0]}


@pytest.fixture(scope="module")
def elbow(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    file: Path = tmp_path_factory.mktemp("elbow") / "elbow.urdf"
    file.write_text(ELBOW)
    return bp.load_robot(file, tip="tip")


HALF_WIDTH = 0.04  # of planar4's links, boxes that end at the tip


# --- through an obstacle, along a wall, by one elbow, beyond a limit ----------------------


def test_a_path_through_an_obstacle_is_left_and_rejoined_at_the_clearance(around_a_ball: bp.Plan) -> None:
    """The tip can follow up to the clearance if the last link points at the ball, a little less if it slants."""
    around = around_a_ball
    assert around.verified, around.message
    assert len(around.certificate.detours) == around.metrics.detour.count == 1
    near = 0.3 + CLEARANCE
    [detour] = around.findings.detours
    assert 0.6 - near - HALF_WIDTH - 0.02 < span(detour)[0] < 0.6 - near + 1e-3
    assert 0.6 + near - 1e-3 < span(detour)[1] < 0.6 + near + HALF_WIDTH + 0.02
    assert detour.obstacle == "ball"
    # beside the ball's middle the tip must be at least as far from the path as from the ball
    assert near - 1e-3 < around.metrics.detour.max_deviation < 2.5 * near
    assert around.metrics.detour.length > np.pi * near * 0.9
    assert np.min(np.linalg.norm(around.tip_path() - [2.0, 0.0, 0.0], axis=1)) > near
    assert refutations(around, refine=3) == []


@pytest.mark.long
def test_without_detours_the_same_stretch_is_reported_and_no_detour_is_searched(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **keys: object) -> None:
        raise AssertionError("a detour was looked for")

    monkeypatch.setattr("backhoe_planner.planning.path_planning.find_detour", refuse)
    found = bp.plan(planar4, site(LINE, [ball(2.0, 0.0, 0.3)], detour=False), effort="quick")
    near = 0.3 + CLEARANCE
    assert found.reason == "blocked"
    assert 1.0 - near - HALF_WIDTH - 0.02 < span(obstruction(found))[0] < 1.0 - near + 1e-3
    assert 1.0 + near - 1e-3 < span(obstruction(found))[1] < 1.0 + near + HALF_WIDTH + 0.02
    assert obstruction(found).obstacle == "ball"
    assert "ball" in found.message
    assert "detours are not allowed" in found.message
    assert found.metrics.detour.max_deviation == 0.0


def test_the_distance_of_the_tip_to_a_waypoint_left_out_is_reported(planar4: bp.Robot) -> None:
    """A spike of 0.5 m to the side and back, into a ball: the detour past its foot is on the path all along."""
    spike = [[2.0, -0.6, 0.0], [2.0, 0.0, 0.0], [2.5, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.6, 0.0]]
    found = bp.plan(planar4, site(spike, [ball(2.5, 0.0, 0.2)]), effort="quick")
    assert found.verified, found.message
    off = np.min(np.linalg.norm(found.tip_path() - [2.5, 0.0, 0.0], axis=1))
    assert off > 0.2
    assert found.metrics.detour.max_deviation == pytest.approx(off, abs=2e-3)


def beside_a_wall(gap: float) -> bp.Scene:
    """A path past a wall that leaves `gap` beside the ball at the elbow arm's tip [m]."""
    wall = {"name": "wall", "shape": "box", "size": [0.5, 4.0, 1.0], "position": [1.4 + BALL + gap + 0.25, 0.0, 0.0]}
    return site([[1.4, -0.5, 0.0], [1.4, 0.5, 0.0]], [wall], detour=False)


@pytest.mark.long
def test_a_path_along_a_wall_at_exactly_the_clearance_is_verified(elbow: bp.Robot) -> None:
    found = bp.plan(elbow, beside_a_wall(CLEARANCE), effort="quick")
    assert found.verified
    assert found.certificate.detours == ()
    tightest = found.certificate.min_clearance
    assert tightest is not None
    assert (tightest.obstacle, tightest.link) == ("wall", "tip")
    assert tightest.margin == pytest.approx(0.0, abs=2e-4)


def test_a_millimetre_nearer_the_wall_is_a_collision(elbow: bp.Robot) -> None:
    found = bp.plan(elbow, beside_a_wall(CLEARANCE - 0.001), effort="quick")
    assert found.reason == "goal_in_collision"
    assert obstruction(found).obstacle == "wall"
    assert obstruction(found).distance == pytest.approx(CLEARANCE - 0.001, abs=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_gap_is_passed_with_the_only_possible_elbow(elbow: bp.Robot, side: float) -> None:
    """With the tip at (1.25, 0) the elbows are at (0.625, +-0.781); a ball is at one of them."""
    found = bp.plan(
        elbow, site([[0.8, 0.0, 0.0], [1.7, 0.0, 0.0]], [ball(0.625, side * 0.781, 0.1)], detour=False), effort="quick"
    )
    assert found.verified
    assert np.all(side * found.trajectory.q[:, 1] > 0.1)


def test_with_balls_at_both_elbows_the_blocked_stretch_is_reported(elbow: bp.Robot) -> None:
    balls = [ball(0.625, 0.781, 0.1), ball(0.625, -0.781, 0.1) | {"name": "other ball"}]
    found = bp.plan(elbow, site([[0.8, 0.0, 0.0], [1.7, 0.0, 0.0]], balls, detour=False), effort="quick")
    # the axis of a link is nearer to the ball than radius, clearance and half its thickness
    reach = np.linspace(0.8, 1.7, 901)
    near = np.array([off_links(x, np.array([0.625, 0.781])) < 0.1 + CLEARANCE + 0.02 for x in reach])
    assert found.reason == "blocked"
    assert obstruction(found).obstacle in ("ball", "other ball")
    assert span(obstruction(found))[0] == pytest.approx(reach[near][0] - 0.8, abs=0.01)
    assert span(obstruction(found))[1] == pytest.approx(reach[near][-1] - 0.8, abs=0.01)


def off_links(x: float, point: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """Distance of a point from the links of the elbow arm, elbow up, tip at (x, 0) [m]."""
    corner = np.array([0.5 * x, np.sqrt(1.0 - 0.25 * x * x)])
    found = np.inf
    for a, b in ((np.zeros(2), corner), (corner, np.array([x, 0.0]))):
        part = float(np.clip((point - a) @ (b - a), 0.0, 1.0))
        found = min(found, float(np.linalg.norm(point - a - part * (b - a))))
    return found


def test_a_waypoint_past_the_swing_limit_is_reported_with_the_joint_and_its_distance(backhoe: bp.Robot) -> None:
    """Swing ends at 90 degrees: a point beyond that is out of reach by a known distance."""
    limit = backhoe.limits.upper[0]
    points = [[4.0 * np.cos(a), 4.0 * np.sin(a), 0.0] for a in (limit - 0.4, limit - 0.1, limit + 0.25)]
    found = bp.plan(backhoe, site(points), effort="quick")
    assert found.reason == "unreachable"
    assert "waypoint 3" in found.message
    assert found.findings.joints == ("swing",)
    # the nearest point of the half-plane at the limit, which goes through the swing axis
    axis = bp.Kinematics(backhoe).at(backhoe.middle).points[0]
    outward = np.array([-np.sin(limit), np.cos(limit), 0.0])
    assert nearest(found).position_error == pytest.approx((np.array(points[2]) - axis) @ outward, rel=0.02)


@pytest.mark.long
def test_an_obstacle_at_the_end_of_a_path_blocks_it_up_to_the_end(planar4: bp.Robot) -> None:
    found = bp.plan(planar4, site(LINE, [ball(2.0, 1.0, 0.2)]), effort="quick")
    near = 0.2 + CLEARANCE
    assert found.reason == "blocked"
    assert 2.0 - near - HALF_WIDTH - 0.02 < span(obstruction(found))[0] < 2.0 - near + 1e-3
    assert span(obstruction(found))[1] == pytest.approx(2.0, abs=1e-9)
    assert obstruction(found).obstacle == "ball"


def test_the_start_may_be_off_the_path(backhoe: bp.Robot) -> None:
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"swing": -1.0, "boom": 0.6, "stick": -1.8, "bucket": -0.5}},
            "task": {"path": {"waypoints": [{"position": [4.0, 0.0, 0.2]}, {"position": [4.0, 1.5, 0.2]}]}},
        }
    )
    found = bp.plan(backhoe, scene, effort="quick")
    assert found.verified
    np.testing.assert_allclose(found.trajectory.q[0], [-1.0, 0.6, -1.8, -0.5])


@pytest.mark.long
def test_a_path_to_and_fro_over_its_own_beginning_is_followed(planar4: bp.Robot) -> None:
    points = [[2.0, -0.1, 0.0], [2.0, 0.1, 0.0]] * 4
    found = bp.plan(planar4, site(points), effort="quick")
    assert found.verified
    assert found.certificate.tracking.followed == pytest.approx(7 * 0.2, abs=1e-3)


# --- seven joints -------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("index", [0, 4])
def test_a_seven_joint_arm_follows_full_poses_among_boxes(index: int) -> None:
    """At most 1 mm and 0.1 degrees off, between the waypoints too, without a jump."""
    robot = load_machine("panda")
    place = random_site(robot, SiteKey("panda", "cluttered", "path", index))
    found = bp.plan(robot, place.scene, effort="quick")
    assert found.verified
    assert found.certificate.detours == ()
    path = build_problem(robot, place.scene).path
    assert path is not None
    motion = found.trajectory
    begin = found.certificate.tracking.approach_time
    kinematics = bp.Kinematics(robot)
    low = 0.0
    for moment in np.linspace(begin, motion.duration, 400):
        at = kinematics.at(motion.at(float(moment)))
        low, off = path.nearest(at.tip_position, low=low, high=min(low + 0.1, path.length))
        assert off < 1e-3
        assert path.target(low).distances(at)[1] < np.radians(0.1)
    assert (
        np.max(np.abs(np.diff(motion.q, axis=0)) / np.diff(motion.time)[:, None] / robot.limits.velocity) < 1.0 + 1e-6
    )


# --- the layers ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "full", "expected"),
    [("backhoe", False, 1), ("planar4", False, 2), ("panda", True, 1), ("panda", False, 4), ("ur5", True, 0)],
)
def test_redundancy_is_the_dimension_of_the_null_space(
    name: str, full: bool, expected: int, request: pytest.FixtureRequest
) -> None:
    robot: bp.Robot = request.getfixturevalue(name)
    at = bp.Kinematics(robot).at(robot.middle)
    target = TipTarget(at.tip_position.copy(), rotation=at.tip_rotation.copy() if full else None)
    assert redundancy_of(robot, target) == expected


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("backhoe", ""),
        pytest.param("panda", "rotation", marks=pytest.mark.long),
        pytest.param("telescope", "pitch", marks=pytest.mark.long),
    ],
)
def test_no_branch_of_the_solutions_is_missed(name: str, asked: str) -> None:
    """Every solution of the inverse kinematics, from random guesses, has a node within two grid steps."""
    robot = load_machine(name)
    rng = np.random.default_rng(3)
    grid = np.radians(5.0)
    missed = 0
    for _ in range(4):
        at = bp.Kinematics(robot).at(robot.random_q(rng))
        target = TipTarget(
            at.tip_position.copy(),
            pitch=(at.pitch, at.pitch) if asked == "pitch" else None,
            rotation=at.tip_rotation.copy() if asked == "rotation" else None,
        )
        # layers are completed from neighbour to neighbour; here all have one target
        nodes = PathLayers(robot, grid=grid).at(np.linspace(0.0, 2.0, 6), [target] * 6)[-1]
        guesses = np.array([robot.random_q(rng) for _ in range(200)])
        q, reached = solve_batch(BatchKinematics(robot), TargetBatch.of([target] * 200), guesses)
        near = np.min(np.max(np.abs(q[reached][:, None] - nodes[None]), axis=2), axis=1)
        missed += int(np.sum(near > 2.0 * grid))
    assert missed == 0


@pytest.mark.long
@pytest.mark.parametrize(("machine", "index", "seed"), [("telescope", 7, 99131), ("panda", 8, 98911)])
def test_a_path_with_a_known_motion_is_not_reported_as_blocked(machine: str, index: int, seed: int) -> None:
    """One needs configurations far from the usual guesses, the other a curve of self-motion close to another."""
    robot = load_machine(machine)
    site = random_site(robot, SiteKey(machine, "narrow", "path", index, seed))
    assert site.way_known
    plan = bp.plan(robot, site.scene, effort="quick")
    assert plan.verified, plan.message
    assert refutations(plan) == []


def test_nodes_fill_a_range_of_pitch_that_opens_along_the_path(backhoe: bp.Robot) -> None:
    targets = [TipTarget(np.array([4.0, 0.1 * k, 0.0]), pitch=(-2.0, -2.0 + 0.2 * k)) for k in range(5)]
    layers = PathLayers(backhoe, grid=0.1).at(np.linspace(0.0, 0.4, 5), targets)
    kinematics = bp.Kinematics(backhoe)
    for k, nodes in enumerate(layers):
        pitches = np.array([kinematics.at(q).pitch for q in nodes])
        assert np.ptp(pitches) == pytest.approx(0.2 * k, abs=1e-6)
        assert np.max(np.diff(np.sort(pitches)), initial=0.0) < 0.1 + 1e-6


def test_nodes_are_on_the_path(backhoe: bp.Robot) -> None:
    targets = [TipTarget(np.array([4.0, 0.2 * k, 0.0]), pitch=(-2.0, -1.0)) for k in range(4)]
    layers = PathLayers(backhoe, grid=0.1).at(np.array([0.0, 0.2, 0.4, 0.6]), targets)
    kinematics = bp.Kinematics(backhoe)
    for target, nodes in zip(targets, layers, strict=True):
        assert len(nodes) >= 5
        for q in nodes:
            assert max(target.distances(kinematics.at(q))) < 1e-7
            assert np.all((q >= backhoe.limits.lower) & (q <= backhoe.limits.upper))


# --- gaps between layers -------------------------------------------------------------------


def resolved_with_two_layers(elbow: bp.Robot, **keys: Any) -> tuple[Problem, Resolution]:
    """A line 1.5 m ahead on which the shoulder turns by 0.76 rad, more than one step may."""
    problem = build_problem(elbow, site([[1.5, y, 0.0] for y in (-0.6, -0.2, 0.2, 0.6)], **keys))
    assert problem.path is not None
    proximity = bp.Proximity(elbow, problem.obstacles)
    resolver = PathResolver(
        problem, problem.path, proximity=proximity, find_detour=lambda *_: None,
        cost=PathCost(problem).step_costs, layering=Layering(spacing=2.0, joint_steps=problem.joint_steps),
    )  # fmt: skip
    return problem, resolver.resolve(None, detours=False)


@pytest.mark.parametrize("keys", [{}, {"max_joint_step": 0.5}], ids=["free", "within steps"])
def test_a_gap_between_two_layers_is_split(elbow: bp.Robot, keys: dict[str, float]) -> None:
    problem, resolved = resolved_with_two_layers(elbow, **keys)
    assert resolved.obstruction is None
    [stretch] = resolved.pieces
    assert isinstance(stretch, Stretch)
    assert stretch.stations[[0, -1]] == pytest.approx([0.0, 1.2])
    tips = BatchKinematics(elbow).at(stretch.q).tip_position
    assert problem.path is not None
    np.testing.assert_allclose(tips, np.array([problem.path(float(s)) for s in stretch.stations]), atol=1e-7)
    assert np.max(np.abs(np.diff(stretch.q, axis=0))) < 0.1


def test_a_step_that_splitting_cannot_shorten_is_reported(elbow: bp.Robot) -> None:
    """From y = 0.2 to 0.6 the shoulder turns by more than 0.2 rad at waypoints 0.4 m apart, 1.5 m ahead."""
    _, resolved = resolved_with_two_layers(elbow, max_joint_step=0.2)
    assert resolved.obstruction is not None
    assert resolved.step is not None
    assert resolved.step.after - resolved.step.before == 1


# --- smoothing ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_smoothing_lowers_the_cost_and_stays_on_the_path(backhoe: bp.Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    begin = np.array([rng.uniform(3.0, 4.5), rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0)])
    end = begin + np.array([rng.uniform(-1.0, 0.5), rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5)])
    scene = site([begin.tolist(), end.tolist()], [ball(3.0, 2.0, 0.3)])
    problem = build_problem(backhoe, scene)
    assert problem.path is not None
    proximity = bp.Proximity(backhoe, problem.obstacles)
    resolved = PathResolver(
        problem, problem.path, proximity=proximity, find_detour=lambda a, b, low, high: None,
        cost=PathCost(replace(problem, objective=OBJECTIVES["velocity_norm"])).step_costs,
    ).resolve(None, detours=False)  # fmt: skip
    assert resolved.obstruction is None
    [piece] = resolved.pieces
    assert isinstance(piece, Stretch)
    smooth = smooth_stretch(problem, problem.path, piece, proximity=proximity, free_end=True)
    np.testing.assert_array_equal(smooth.q[0], piece.q[0])
    cost = [
        np.sum(np.sum(np.diff(way.q, axis=0) ** 2, axis=1) / step_lengths(way.stations, way.q, least=1e-6))
        for way in (smooth, piece)
    ]
    assert cost[0] < cost[1]
    kinematics = bp.Kinematics(backhoe)
    for s, joints in zip(smooth.stations, smooth.q, strict=True):
        assert max(problem.path.target(float(s)).distances(kinematics.at(joints))) < 1e-6
        assert np.all(proximity.distances(joints) >= proximity.clearance - 1e-4)


# --- repeatability ------------------------------------------------------------------------


@pytest.mark.long
def test_the_same_seed_gives_the_same_plan_with_a_detour(planar4: bp.Robot, around_a_ball: bp.Plan) -> None:
    again = bp.plan(planar4, around_a_ball.scene, effort="quick")
    assert again.verified
    np.testing.assert_array_equal(again.trajectory.q, around_a_ball.trajectory.q)
    np.testing.assert_array_equal(again.trajectory.time, around_a_ball.trajectory.time)
    assert again.findings == around_a_ball.findings


@pytest.mark.long
def test_routes_of_short_steps_are_tried_if_the_cheapest_cross_between_self_motions() -> None:
    """The site comes from a motion that follows the path. The 40 cheapest routes all cross where no motion can."""
    robot = load_machine("panda")
    site = random_site(robot, SiteKey("panda", "terrain", "path", 0, 6400))
    plan = bp.plan(robot, site.scene, effort="quick")
    assert plan.verdict == "verified", plan.message


@pytest.mark.long
def test_the_law_follows_a_path_once_for_the_plan_and_its_comparison(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan's figures equal those of a law that follows the path anew from the plan's beginning."""
    site = random_site(backhoe, SiteKey("backhoe", "open", "path", 1, 77))
    with monkeypatch.context() as patch:
        patch.setattr(comparison, "resolve_along", None)  # not called
        plan = bp.plan(backhoe, site.scene, effort="quick")
    assert plan.verdict == "verified"
    anew = compare_with_law(plan.problem, plan.trajectory, plan.certificate)
    assert anew is not None
    assert plan.metrics.objective == anew.figures
    assert anew.figures.law is not None


def test_with_bounded_steps_every_configuration_has_a_near_one_in_the_next_layer(planar4: bp.Robot) -> None:
    """All that reach the next point within half of the longest step have a node as near there."""
    longest = 0.12
    targets = [TipTarget(np.array([2.5, y, 0.0])) for y in (0.0, 0.02, 0.04)]
    layers = PathLayers(planar4, grid=0.1, longest=longest).at(np.array([0.0, 0.02, 0.04]), targets)
    batch = TargetBatch.of([targets[1]] * len(layers[0]))
    onward, reached = solve_batch(BatchKinematics(planar4), batch, layers[0])
    short = reached & (np.max(np.abs(onward - layers[0]), axis=1) < 0.5 * longest)
    apart = np.max(np.abs(layers[0][short][:, None] - layers[1][None]), axis=2).min(axis=1)
    assert np.count_nonzero(short) > 100
    assert np.max(apart) <= 0.5 * longest + 0.01
    far = PathLayers(planar4, grid=0.1).at(np.array([0.0, 0.02, 0.04]), targets)
    assert len(far[1]) < len(layers[1])
