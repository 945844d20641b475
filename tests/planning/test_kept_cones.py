"""Paths of positions within a cone of orientations, on arms that can take any orientation at a position or cannot.

Each path is built from joint configurations: straight on with the tip, and with each configuration within the cone.
So it has a solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import Axis, load_chain
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import build_problem, motion_cost
from backhoe_planner.planning import EFFORTS, Brake, planner
from backhoe_planner.planning.kept_path import in_middle_of_cone
from backhoe_planner.planning.stretches import kept_cones
from validation.habitats import load_machine

Data = dict[str, Any]
Matrix = NDArray[np.float64]

FAR = 0.005  # rad or m that the known configurations keep from the limits
STEP = 0.01  # m of the known path
MORE = [*range(1, 6)]  # seeds of the long variants

# place and axis of each hinge of an arm, and half of its range [rad]: with a roll, and six that move in a plane;
# and with a slide for its third joint, half of whose range is 0.3 m
FIVE_AXES = (
    ("0 0 0.2", "0 0 1", 2.5), ("0.05 0 0.1", "0 1 0", 1.5), ("0.5 0 0", "0 1 0", 2.5), ("0.4 0 0", "0 1 0", 2.0),
    ("0.1 0 0", "1 0 0", 2.9),
)  # fmt: skip


SIX_IN_A_PLANE = (
    ("0 0 0.3", "0 0 1", 2.5), ("0.1 0 0", "0 -1 0", 1.2), *(("0.4 0 0", "0 -1 0", 1.2) for _ in range(4)),
)  # fmt: skip
WITH_A_SLIDE = (
    ("0 0 1", "0 0 1", 2.5), ("0.5 0 0.1", "0 0 1", 2.4), ("0.4 0 0.1", "0 0 1", 0.3), ("0 0 -0.3", "0 0 1", 2.9),
)  # fmt: skip

SEVEN_AXES = (
    ("0 0 0.2", "0 0 1", 2.8), ("0 0 0.1", "0 1 0", 2.0), ("0 0 0.2", "0 0 1", 2.8), ("0 0 0.2", "0 -1 0", 2.4),
    ("0 0 0.2", "0 0 1", 2.8), ("0 0 0.2", "0 1 0", 2.0), ("0.05 0 0.1", "0 0 1", 2.8),
)  # fmt: skip
WIDE = (15.0, 40.0)  # deg

AXES = ("1 0 0", "0 1 0", "0 0 1")


def light_arm(axes: Sequence[tuple[str, str, float]], folder: Path) -> bp.Robot:
    """An arm of small balls, one at each hinge."""
    chain = [
        Axis(
            "prismatic" if axes is WITH_A_SLIDE and number == 2 else "revolute", axis, -most, most, place=place,
            ball=0.03,
        )
        for number, (place, axis, most) in enumerate(axes)
    ]  # fmt: skip
    return load_chain(folder, chain, tool="0.2 0 0")


ARMS = {"five axes": FIVE_AXES, "six in a plane": SIX_IN_A_PLANE, "with a slide": WITH_A_SLIDE}


@pytest.fixture
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> bp.Robot:
    """The machine of a name."""
    if request.param in ARMS:
        return light_arm(ARMS[request.param], tmp_path)
    return load_machine("telescope") if request.param == "telescope" else bp.load_robot(f"example:{request.param}")


def gantry(folder: Path) -> bp.Robot:
    """Three slides of 3 m either way and a continuous hinge: every position is reached at every angle of the hinge."""
    slides = [Axis("prismatic", axis, -3.0, 3.0) for axis in AXES]
    return load_chain(folder, [*slides, Axis("continuous", AXES[2], -3.0, 3.0)], tool="0.2 0 0", ball=0.02)


def known_path(
    robot: bp.Robot, seed: int, *, legs: int = 2, half: tuple[float, float] = (2.0, 10.0)
) -> tuple[Matrix, Matrix, Rotation, float]:
    """(W, 3) waypoints [m], (K, n) configurations along them, and the cone: its middle and its half-angle [rad].

    The middle is beside the first orientation, about any axis, so that the tip is nowhere in the middle exactly.

    Parameters
    ----------
    half: range of the half-angle [deg].
    """
    rng = np.random.default_rng(seed)
    kinematics = BatchKinematics(robot)
    lower, upper = robot.limits.lower + FAR, robot.limits.upper - FAR
    while True:
        q = rng.uniform(0.8 * lower + 0.2 * upper, 0.2 * lower + 0.8 * upper)
        at = kinematics.at(q[None])
        cone = np.radians(rng.uniform(*half))
        turn = rng.normal(size=3)
        middle = Rotation.from_rotvec(0.3 * cone * turn / np.linalg.norm(turn)) * Rotation.from_matrix(
            at.tip_rotation[0]
        )
        way, points = [q], [at.tip_position[0]]
        for _ in range(legs):
            ahead = kinematics.at(way[-1][None]).position_jacobian()[0] @ rng.normal(size=robot.n)
            ahead *= STEP / np.linalg.norm(ahead)
            begin, steps = points[-1], 0
            for number in range(1, 1 + int(rng.uniform(0.1, 0.3) * np.linalg.norm(at.tip_position[0]) / STEP)):
                target = TipTarget(begin + number * ahead, None, middle.as_matrix(), 0.9 * cone)
                after, reached = solve_batch(kinematics, TargetBatch.of([target]), way[-1][None])
                inside = np.all(after[0] >= lower) and np.all(after[0] <= upper)
                if not reached[0] or not inside or np.max(np.abs(after[0] - way[-1])) > 0.1:
                    break
                way.append(after[0])
                steps = number
            points.append(begin + steps * ahead)
        clear = bp.Proximity(robot)
        far = min(np.linalg.norm(np.diff(points, axis=0), axis=1)) > 5.0 * STEP
        if far and all(np.all(clear.distances(one) > clear.clearance + 0.02) for one in way):
            return np.array(points), np.array(way), middle, float(cone)


def scene_along(points: Matrix, middle: Rotation, cone: float, **keys: Any) -> Data:
    x, y, z, w = middle.as_quat().tolist()
    return {
        "version": 1,
        "clearance": 0.01,
        "task": {
            "path": {"waypoints": [{"position": point} for point in points.tolist()], "speed": 0.5},
            "keep": {"rotation": {"quaternion": [w, x, y, z], "tolerance": cone}},
        },
        **keys,
    }


def most_turned(plan: bp.Plan, robot: bp.Robot, middle: Rotation) -> float:
    """The largest angle of the tip from the middle of the cone, at and halfway between the samples of a motion."""
    q = plan.trajectory.q
    at = BatchKinematics(robot).at(np.vstack((q, 0.5 * (q[1:] + q[:-1]))))
    return float(np.max((middle.inv() * Rotation.from_matrix(at.tip_rotation)).magnitude()))


MACHINES = ("backhoe", "telescope", "planar4", *ARMS)


SLOW = ("telescope", "six in a plane")  # those of the four others assert the same


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in MORE)])
@pytest.mark.parametrize(
    "robot",
    [pytest.param(one, marks=pytest.mark.long) if one in SLOW else one for one in MACHINES],
    indirect=True,
)
def test_a_path_of_positions_is_followed_within_the_cone(robot: bp.Robot, seed: int) -> None:
    """With a corner for the backhoe and the long variants; without one planning takes half as long."""
    points, _, middle, cone = known_path(robot, seed, legs=2 if robot.name == "backhoe" or seed else 1)
    plan = bp.plan(robot, bp.scene_from_dict(scene_along(points, middle, cone)), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6
    assert not plan.findings.detours


@pytest.mark.parametrize("robot", ["backhoe", pytest.param("telescope", marks=pytest.mark.long)], indirect=True)
def test_the_law_alone_begins_within_the_cone_and_keeps_it(robot: bp.Robot) -> None:
    points, _, middle, cone = known_path(robot, 1)
    plan = bp.plan(robot, bp.scene_from_dict(scene_along(points, middle, cone)), method="reactive")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6


@pytest.mark.parametrize("robot", ["five axes", pytest.param("telescope", marks=pytest.mark.long)], indirect=True)
def test_from_a_given_start_the_way_to_the_path_keeps_the_cone_too(robot: bp.Robot) -> None:
    """The start is a third of the way along the path."""
    points, way, middle, cone = known_path(robot, 7, legs=1)
    start = {"joints": dict(zip(robot.joint_names, way[len(way) // 3].tolist(), strict=True))}
    plan = bp.plan(robot, bp.scene_from_dict(scene_along(points, middle, cone, start=start)), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6


@pytest.mark.parametrize("robot", ["telescope", pytest.param("backhoe", marks=pytest.mark.long)], indirect=True)
def test_a_band_of_the_pitch_and_a_cone_are_kept_together(robot: bp.Robot) -> None:
    """The band is that of the known configurations, which is narrower than the cone."""
    points, way, middle, cone = known_path(robot, 3, legs=1)
    pitches = [bp.Kinematics(robot).at(q).pitch for q in way]
    low, high = min(pitches) - 0.005, max(pitches) + 0.005
    content = scene_along(points, middle, cone)
    content["task"]["keep"]["pitch"] = [low, high]
    plan = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6
    found = [bp.Kinematics(robot).at(q).pitch for q in plan.trajectory.q]
    assert low - 1e-6 <= min(found) <= max(found) <= high + 1e-6


@pytest.mark.parametrize("robot", ["backhoe", pytest.param("telescope", marks=pytest.mark.long)], indirect=True)
def test_waypoints_with_their_own_pitch_are_followed_within_the_cone(robot: bp.Robot) -> None:
    """One waypoint has the pitch of the known configuration, the other leaves it to the cone."""
    points, way, middle, cone = known_path(robot, 4, legs=1)
    content = scene_along(points, middle, cone)
    content["task"]["path"]["waypoints"][0]["pitch"] = bp.Kinematics(robot).at(way[0]).pitch
    plan = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6
    assert bp.Kinematics(robot).at(plan.trajectory.q[0]).pitch == pytest.approx(
        bp.Kinematics(robot).at(way[0]).pitch, abs=1e-6
    )


@pytest.mark.parametrize("cone", [0.001, pytest.param(3.14, marks=pytest.mark.long)])
def test_a_machine_that_reaches_every_place_from_everywhere_keeps_a_cone(tmp_path: Path, cone: float) -> None:
    """So no sample of a layer is left to be searched once more."""
    robot, middle = gantry(tmp_path), Rotation.from_euler("z", 0.3)
    points = np.array([[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.5, 0.5]])
    plan = bp.plan(robot, bp.scene_from_dict(scene_along(points, middle, cone)), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6


NARROW, NARROW_SEEDS = (0.1, 0.2), (0, 9)  # deg


@pytest.mark.parametrize("seed", [NARROW_SEEDS[0], pytest.param(NARROW_SEEDS[1], marks=pytest.mark.long)])
def test_a_narrow_cone_is_used_up_to_a_tenth(backhoe: bp.Robot, seed: int) -> None:
    """The known configurations use up to 0.9 of the cone."""
    points, _, middle, cone = known_path(backhoe, seed, legs=1, half=NARROW)
    plan = bp.plan(backhoe, bp.scene_from_dict(scene_along(points, middle, cone)), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, backhoe, middle) <= cone + 1e-6


def test_a_place_that_is_reached_only_at_the_rim_of_the_cone_is_told_with_the_spare(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same path, with half of the cone spared."""
    points, _, middle, cone = known_path(backhoe, NARROW_SEEDS[0], legs=1, half=NARROW)
    monkeypatch.setattr(kept_cones, "_LEAST_PART", 0.5)
    plan = bp.plan(backhoe, bp.scene_from_dict(scene_along(points, middle, cone)), effort="quick")
    assert plan.reason == "goal_breaks_keep"
    assert "at best the tip is turned by" in plan.message
    spared = np.degrees(min(0.5 * cone, kept_cones.SPARE))
    assert f"of which the last {spared:.2g} deg are spared for the curve between postures" in plan.message


def test_a_path_past_a_ball_keeps_the_cone(backhoe: bp.Robot) -> None:
    """The ball is 0.1 m beside the known way of the bucket."""
    points, way, middle, cone = known_path(backhoe, 0, legs=1)
    tip = bp.Kinematics(backhoe).at(way[len(way) // 2]).tip_position
    rng = np.random.default_rng(0)
    while True:
        beside = rng.normal(size=3)
        ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": (tip + 0.4 * beside).tolist()}
        scene = bp.scene_from_dict(scene_along(points, middle, cone, obstacles=[ball]))
        clear = bp.Proximity(backhoe, bp.build_obstacles(scene, backhoe))
        least = min(float(np.min(clear.distances(q) - clear.clearance)) for q in way)
        if 0.01 < least < 0.1:
            break
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, backhoe, middle) <= cone + 1e-6


def test_a_path_whose_curve_leaves_the_cone_a_little_is_planned_in_a_narrower_one(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the curve leaves it because the configurations may be 0.001 rad outside, not inside."""
    points, _, middle, cone = known_path(backhoe, 5, legs=1)
    scene = bp.scene_from_dict(scene_along(points, middle, cone))
    monkeypatch.setattr(kept_cones, "SPARE", -0.001)
    with monkeypatch.context() as patch:
        patch.setattr(planner, "_NARROWER", 0)
        once = bp.plan(backhoe, scene, effort="quick")
    assert once.reason == "not_done"
    assert 0.0 < most_turned(once, backhoe, middle) - cone < 0.0015
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, backhoe, middle) <= cone + 1e-6


def test_a_place_between_waypoints_that_no_posture_within_the_cone_reaches_is_named(backhoe: bp.Robot) -> None:
    """The bucket reaches both ends with a pitch of -1.4 rad, but no posture between them with one within 0.06 rad.

    That is known from 200,000 postures with such pitches, none of which comes within 0.1 m of the middle.
    """
    low, high, middle, pitch, cone = (2.75, 0.0, 0.6), (2.75, 0.0, 2.8), (2.75, 0.0, 2.0), -1.4, 0.06
    kinematics = BatchKinematics(backhoe)
    ranges = zip(backhoe.limits.lower[1:3], backhoe.limits.upper[1:3], strict=True)
    boom, stick, turned = (
        part.ravel()
        for part in np.meshgrid(*(np.linspace(a, b, 200) for a, b in ranges), pitch + cone * np.linspace(-1, 1, 5))
    )
    q = np.column_stack((np.zeros(len(boom)), boom, stick, turned - boom - stick))
    q = q[(q[:, 3] >= backhoe.limits.lower[3]) & (q[:, 3] <= backhoe.limits.upper[3])]
    tips = kinematics.at(q).tip_position
    assert np.linalg.norm(tips - middle, axis=1).min() > 0.1
    assert all(np.linalg.norm(tips - end, axis=1).min() < 0.02 for end in (low, high))
    turn = Rotation.from_matrix(kinematics.at(q[:1]).tip_rotation[0])
    first = bp.Kinematics(backhoe).at(q[0]).pitch
    level = Rotation.from_euler("y", first - pitch) * turn
    content = scene_along(np.array([low, high]), level, cone)
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.reason == "goal_breaks_keep"
    assert "along the path that keeps it: at best the tip is turned by" in plan.message


# --- arms that can take any orientation at a position ---------------------------------------------


def in_middle(content: Data) -> Data:
    """The scene with the orientation in the middle of the cone given at every waypoint."""
    task = content["task"]
    turn = {"quaternion": task["keep"]["rotation"]["quaternion"]}
    waypoints = [waypoint | turn for waypoint in task["path"]["waypoints"]]
    return content | {"task": {**task, "path": {**task["path"], "waypoints": waypoints}}}


def test_a_path_that_is_out_of_reach_in_the_middle_of_the_cone_uses_the_rest(tmp_path: Path) -> None:
    robot = light_arm(SEVEN_AXES, tmp_path)
    points, _, middle, cone = known_path(robot, 6, legs=1, half=WIDE)
    content = scene_along(points, middle, cone)
    assert bp.plan(robot, bp.scene_from_dict(in_middle(content)), effort="quick").reason == "unreachable"
    plan = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert most_turned(plan, robot, middle) <= cone + 1e-6


@pytest.mark.parametrize("seed", [4, *(pytest.param(seed, marks=pytest.mark.long) for seed in (0, 7, 11))])
def test_a_motion_that_uses_the_cone_is_taken_if_it_costs_less_than_one_in_its_middle(
    tmp_path: Path, seed: int
) -> None:
    """Here it costs half or less, since the joints with the greatest loads hardly have to move."""
    robot = light_arm(SEVEN_AXES, tmp_path)
    points, _, middle, cone = known_path(robot, seed, legs=1, half=WIDE)
    scene = bp.scene_from_dict(scene_along(points, middle, cone))
    problem = build_problem(robot, scene)
    quick, proof = planner.plan_motion(problem, effort=EFFORTS["quick"])
    assert proof.verified
    found, proof = planner.plan_motion(problem, effort=replace(EFFORTS["quick"], other_ways=1))
    assert proof.verified
    kinematics = BatchKinematics(robot)
    off = [
        float(np.max((middle.inv() * Rotation.from_matrix(kinematics.at(one.trajectory.q).tip_rotation)).magnitude()))
        for one in (quick, found)
    ]
    assert off[0] < 1e-3
    assert 0.5 * cone < off[1] <= cone + 1e-6
    assert motion_cost(problem, found.trajectory) < 0.5 * motion_cost(problem, quick.trajectory)


def test_a_motion_in_the_middle_of_the_cone_is_told_if_time_runs_out_before_the_other_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second plan begins when no time is left."""
    robot = light_arm(SEVEN_AXES, tmp_path)
    points, _, middle, cone = known_path(robot, 4, half=WIDE)
    problem = build_problem(robot, bp.scene_from_dict(scene_along(points, middle, cone)))
    brake, plan, plans = Brake(1e6), planner._plan_slowed, []

    def late(*args: Any, **keys: Any) -> Any:
        plans.append(args)
        if len(plans) == 2:
            monkeypatch.setattr(brake, "is_used_up", lambda: True)
        return plan(*args, **keys)

    monkeypatch.setattr(planner, "_plan_slowed", late)
    outcome, proof = planner.plan_motion(problem, effort=replace(EFFORTS["quick"], other_ways=1), brake=brake)
    assert len(plans) == 2
    assert proof.verified
    assert outcome.message == f"{brake.message}; the search for a cheaper motion was not finished"


@pytest.mark.long
@pytest.mark.parametrize("seed", [57, 62, 69])
def test_a_path_that_is_blocked_only_in_the_middle_of_the_cone_is_not_left(tmp_path: Path, seed: int) -> None:
    """A small ball is where the last hinge is in the middle; the configurations of which the path is made pass it."""
    robot = light_arm(SEVEN_AXES, tmp_path)
    points, way, middle, cone = known_path(robot, seed, legs=1, half=WIDE)
    tool = np.array([0.2, 0.0, 0.0])
    at = BatchKinematics(robot).at(way)
    in_the_middle = at.tip_position - middle.apply(tool)
    hinges = at.tip_position - at.tip_rotation @ tool
    apart = np.linalg.norm(in_the_middle[:, None] - hinges, axis=2).min(axis=1)
    inner = slice(len(way) // 4, -(len(way) // 4))
    place = in_the_middle[inner][int(np.argmax(apart[inner]))]
    ball = {"name": "ball", "shape": "sphere", "radius": 0.002, "position": place.tolist()}
    content = scene_along(points, middle, cone, obstacles=[ball])
    near = bp.Proximity(robot, bp.build_obstacles(bp.scene_from_dict(content), robot))
    assert all(np.all(near.distances(q) > near.clearance) for q in way)
    beside = bp.plan(robot, bp.scene_from_dict(in_middle(content)), effort="quick")
    assert beside.verified
    assert beside.certificate.detours
    plan = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert not plan.certificate.detours


def test_waypoints_that_give_their_orientation_have_no_other_plan(tmp_path: Path) -> None:
    robot = light_arm(SEVEN_AXES, tmp_path)
    points, _, middle, cone = known_path(robot, 4, half=WIDE)
    content = in_middle(scene_along(points, middle, cone))
    assert in_middle_of_cone(build_problem(robot, bp.scene_from_dict(content))) is None
    del content["task"]["path"]["waypoints"][-1]["quaternion"]
    some = in_middle_of_cone(build_problem(robot, bp.scene_from_dict(content)))
    assert some is not None
    assert some.path is not None
    assert all(waypoint.rotation is not None for waypoint in some.path.waypoints)
