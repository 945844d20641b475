"""The planner: every outcome is a plan, and a plan called verified is."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time as clock
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from reasons import nearest, obstruction, span

import backhoe_planner as bp
from backhoe_planner.planning import plan_to_dict
from backhoe_planner.planning.world.outcome import _spans
from validation.independent_check import refutations
from validation.planar_scenes import random_planar_scene

Data = dict[str, Any]

SCENES = Path(__file__).resolve().parents[2] / "scenes"
STRETCHED: Data = {"joints": {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0, "joint4": 0.0}}
LINE = [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0]]


def site(task: Data, *, start: Data | None = STRETCHED, obstacles: list[Data] | None = None, **keys: Any) -> bp.Scene:
    content = {"version": 1, "task": task, "clearance": 0.02, "influence": 0.4, "obstacles": obstacles or []} | keys
    return bp.scene_from_dict(content if start is None else content | {"start": start})


def goal(x: float, y: float, z: float = 0.0) -> Data:
    return {"goal": {"position": [x, y, z]}}


def path(points: list[list[float]] = LINE, **keys: Any) -> Data:
    return {"path": {"waypoints": [{"position": point} for point in points]} | keys}


def ball(x: float, y: float, radius: float) -> Data:
    return {"name": "ball", "shape": "sphere", "radius": radius, "position": [x, y, 0.0]}


def tips(plan: bp.Plan) -> NDArray[np.float64]:
    return plan.tip_path()


# --- successes --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "machine", "refine"),
    [
        pytest.param("levelling", "backhoe", 0, marks=pytest.mark.long),
        ("level_bucket", "backhoe", 0),
        pytest.param("loaded_swing", "backhoe", 0, marks=pytest.mark.long),
        ("paper_planar", "planar4", 10),
        ("pole", "backhoe", 1),
        pytest.param("trench", "backhoe", 0, marks=pytest.mark.long),
        pytest.param("trench_cut", "backhoe", 0, marks=pytest.mark.long),
        ("truck", "backhoe", 0),
        ("wall", "backhoe", 1),
        pytest.param("worker", "backhoe", 1, marks=pytest.mark.long),
    ],
)
def test_every_scene_of_the_project_is_solved(
    name: str, machine: str, refine: int, request: pytest.FixtureRequest
) -> None:
    """A check of distances that shares no code with the planner does not refute the plan."""
    scene = bp.load_scene(SCENES / f"{name}.yaml")
    assert scene.tip is None
    robot: bp.Robot = request.getfixturevalue(machine)
    plan = bp.plan(robot, scene, effort="quick")
    assert plan.verified, plan.message
    assert plan.reason == ""
    assert plan.message == ""
    assert plan.certificate.verified
    if scene.task.goals:
        asked = [goal.target.position for goal in plan.problem.goals]
        assert min(np.linalg.norm(tips(plan)[-1] - place) for place in asked) < 1e-3
    else:
        points = [np.array(waypoint.position) for waypoint in scene.waypoints()]
        assert np.linalg.norm(tips(plan)[-1] - points[-1]) < 0.005
        for point in points:
            assert np.min(np.linalg.norm(tips(plan) - point, axis=1)) < 0.01
    if refine:
        assert refutations(plan, refine=refine, itself=False) == []


@pytest.mark.parametrize("seed", range(2, 8))
def test_no_verified_plan_of_a_random_scene_is_refuted(planar4: bp.Robot, seed: int) -> None:
    scene = random_planar_scene(planar4, np.random.default_rng(seed))
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.verified == (plan.reason == "") == plan.certificate.verified
    assert refutations(plan, refine=4) == []
    if seed in (2, 3, 4, 5, 7):
        assert plan.verified, plan.message


def test_a_path_with_nothing_in_the_way_is_followed_exactly(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(path(speed=0.4), start=None), effort="quick")
    assert plan.verified, plan.message
    at = tips(plan)
    assert np.max(np.abs(at[:, [0, 2]] - [2.0, 0.0])) < 1e-4
    assert plan.certificate.tracking.max_error < 1e-4
    assert np.all(np.diff(at[:, 1]) > -1e-6)
    np.testing.assert_allclose(at[[0, -1], 1], [-1.0, 1.0], atol=1e-4)
    assert plan.certificate.detours == ()
    # the requested speed is kept and used: 2 m at 0.4 m/s plus the time to accelerate
    speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(plan.trajectory.time)
    assert np.max(speed) <= 0.4 * 1.01
    assert 5.0 <= plan.trajectory.duration < 8.0


def test_the_requested_pitch_is_kept_along_a_path(backhoe: bp.Robot) -> None:
    points = [{"position": [4.2, 0.3, -0.2], "pitch": -1.5}, {"position": [3.2, 0.3, -0.5], "pitch": -1.9}]
    plan = bp.plan(
        backhoe,
        bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": points, "speed": 0.4}}}),
        effort="quick",
    )
    assert plan.verified, plan.message
    kinematics = bp.Kinematics(backhoe)
    for q in plan.trajectory.q:
        at = kinematics.at(q)
        asked = -1.5 - 0.4 * float(np.clip((4.2 - at.tip_position[0]) / 1.0, 0.0, 1.0))
        assert at.pitch == pytest.approx(asked, abs=0.01)


def test_without_detours_the_blocked_stretch_is_named(planar4: bp.Robot) -> None:
    scene = site(path(speed=0.4, detour=False), start=None, obstacles=[ball(2.1, 0.0, 0.15)])
    plan = bp.plan(planar4, scene, effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "blocked")
    assert obstruction(plan).obstacle == "ball"
    assert 0.6 < span(obstruction(plan))[0] < 1.0
    assert "ball" in plan.message
    assert f"{span(obstruction(plan))[0]:.2f} m" in plan.message
    assert "detours are not allowed" in plan.message
    assert plan.certificate.safe


def test_an_obstacle_in_the_way_is_not_reported_as_a_joint_limit(planar4: bp.Robot) -> None:
    """The law stops some centimetres before the ball, and no joint is near its limit."""
    line = [[3.0, -0.5, 0.0], [3.0, 0.5, 0.0]]
    scene = site(path(line, speed=0.4, detour=False), start=None, obstacles=[ball(3.0, 0.0, 0.1)])
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.reason == "blocked"
    assert obstruction(plan).obstacle == "ball"


def test_the_start_may_be_given_by_the_tip(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(goal(2.0, -1.0), start={"tip": {"position": [2.0, 1.0, 0.0]}}), effort="quick")
    assert plan.verified, plan.message
    np.testing.assert_allclose(tips(plan)[0], [2.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(tips(plan)[-1], [2.0, -1.0, 0.0], atol=1e-3)


# --- failures ---------------------------------------------------------------------


def test_a_goal_out_of_reach_is_reported_with_the_nearest_pose(planar4: bp.Robot) -> None:
    """The arm is 4 m long, the goal at 5 m in the direction (3, 4): the nearest point is 4 m along it."""
    plan = bp.plan(planar4, site(goal(3.0, 4.0)), effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "unreachable")
    assert nearest(plan).position_error == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(nearest(plan).position, [2.4, 3.2, 0.0], atol=1e-4)
    assert plan.message.endswith("1.000 m away, at (2.40, 3.20, 0.00)")
    assert bp.plan(planar4, site(goal(3000.0, 4000.0)), effort="quick").message.endswith(" (positions are in metres)")
    assert len(plan.trajectory) == 1


def test_a_pitch_out_of_reach_is_reported_with_the_pitches_in_reach(backhoe: bp.Robot) -> None:
    """The tip is there at a pitch of boom + stick + bucket = -2.1 rad; beyond the arm's length no pitch will do."""
    posture = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    at = bp.Kinematics(backhoe).at(np.array(list(posture.values()))).tip_position.tolist()
    messages = []
    for position in (at, [40.0, 0.0, 1.0]):
        task = {"goal": {"position": position, "pitch": 1.4}}
        scene = bp.scene_from_dict({"version": 1, "start": {"joints": posture}, "task": task})
        plan = bp.plan(backhoe, scene, effort="quick")
        assert plan.reason == "unreachable"
        messages.append(plan.message)
    told = messages[0].partition("alone can be reached, with a pitch of ")[2]
    spans = [[float(number) for number in re.findall(r"-?[\d.]+", span)] for span in told.split(" or ")]
    assert any(low <= -2.0 <= high for low, *_, high in spans), messages[0]
    assert not any(low <= 1.4 <= high for low, *_, high in spans), messages[0]
    assert "alone can be reached" not in messages[1]


def test_the_pitches_in_reach_have_no_gap_where_every_pitch_is_reached(backhoe: bp.Robot) -> None:
    """At this position every pitch from -2.355 to -0.17 rad is reached, by a scan of all pitches."""
    task = {"goal": {"position": [3.8, -1.0, 0.8], "pitch": -3.1}}
    posture = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": posture}, "task": task})
    message = bp.plan(backhoe, scene, effort="quick").message
    found = re.search(r"with a pitch of (\S+) to (\S+) rad$", message)
    assert found is not None, message
    assert float(found[1]) == pytest.approx(-2.355, abs=0.05)
    assert float(found[2]) == pytest.approx(-0.17, abs=0.05)


def test_what_narrows_the_reach_is_named(backhoe: bp.Robot) -> None:
    """A goal at the left, with the swing kept within 1 rad by a zone, and with the swing held straight ahead."""
    posture = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    sector = {"kind": "swing_sector", "name": "road", "from": -1.0, "to": 1.0, "stop": 0.0}
    content = {"version": 1, "start": {"joints": posture}, "task": {"goal": {"position": [0.5, 4.0, 0.8]}}}
    message = bp.plan(backhoe, bp.scene_from_dict({**content, "zones": [sector]}), effort="quick").message
    assert "with swing at the limit (swing within road)" in message
    own = {"limits": {"position": {"swing": [-0.9, 0.9]}}}
    message = bp.plan(backhoe, bp.scene_from_dict({**content, "zones": [sector], **own}), effort="quick").message
    assert "with swing at the limit (swing within limits.position)" in message
    beyond = {**content, "start": {"joints": posture | {"swing": -0.95}}, "zones": [sector], **own}
    message = bp.plan(backhoe, bp.scene_from_dict(beyond), effort="quick").message
    assert message == "swing starts at -0.95 rad, allowed -0.9 to 0.9 rad (within limits.position)"
    del beyond["limits"]
    off = {"tracking": {"joints": 0.06}}
    message = bp.plan(backhoe, bp.scene_from_dict(beyond | off), effort="quick").message
    assert message == "swing starts at -0.95 rad, allowed -0.94 to 0.94 rad (within road)"
    message = bp.plan(backhoe, bp.scene_from_dict({**content, "hold": {"swing": 0.0}}), effort="quick").message
    assert message.endswith("; swing is held at 0")


def test_a_path_that_begins_out_of_reach_is_reported_with_its_beginning(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(path([[5.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), start=None), effort="quick")
    assert plan.reason == "unreachable"
    assert "beginning of the path" in plan.message


@pytest.mark.parametrize(
    ("angles", "spans"),
    [
        ([0.1, 0.2, 0.3], [(0.1, 0.3)]),
        ([-0.7, 0.6, -0.5, 0.8], [(-0.7, -0.5), (0.6, 0.8)]),
        ([3.1, -3.1, 0.5], [(-np.pi, -3.1), (0.5, 0.5), (3.1, np.pi)]),
        (np.arange(-3.1, 3.2, 0.2).tolist(), [(-np.pi, np.pi)]),
    ],
)
def test_neighbouring_angles_are_described_by_ranges(angles: list[float], spans: list[tuple[float, float]]) -> None:
    np.testing.assert_allclose(_spans(angles), spans, atol=1e-12)


def test_a_link_that_cannot_leave_an_obstacle_is_reported_with_the_links_that_can(backhoe: bp.Robot) -> None:
    """The swing post only turns on the spot; the bucket in a slab could be lifted, and not if the post is in it too."""
    posture = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    task = {"goal": {"joints": posture | {"swing": 0.5}}}
    messages = []
    small, large = [0.6, 0.6, 0.6], [3.4, 2.0, 1.68]
    for at, size in (([0.0, 0.0, 0.0], small), ([2.8, 0.0, -1.0], small), ([1.5, 0.0, -0.66], large)):
        slab = {"name": "slab", "shape": "box", "size": size, "position": at}
        content = {"version": 1, "start": {"joints": posture}, "task": task, "obstacles": [slab]}
        plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
        assert plan.reason == "start_in_collision"
        messages.append(plan.message)
    assert "swing alone moves swing_post: if that belongs there" in messages[0]
    assert messages[0].endswith("must keep from slab, with links: [boom, stick, bucket]")
    assert "alone moves" not in messages[1]
    assert "at the start swing_post" not in messages[2]
    assert "; swing alone moves swing_post, which touches it too: if that belongs there" in messages[2]


def test_an_obstacle_far_deeper_than_any_machine_is_asked_for_in_metres(backhoe: bp.Robot) -> None:
    """A box of 90 m around the machine, whose size may be in millimetres: its nearest face is 45 m from its centre."""
    posture = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    box = {"name": "box", "shape": "box", "size": [90.0, 90.0, 90.0], "position": [0.0, 0.0, 0.0]}
    task = {"goal": {"joints": posture | {"swing": 0.5}}}
    content = {"version": 1, "start": {"joints": posture}, "task": task, "obstacles": [box]}
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.reason == "start_in_collision"
    assert plan.message.endswith(" m inside box (positions and sizes are in metres)")


def test_a_start_in_collision_is_reported_with_its_depth(planar4: bp.Robot) -> None:
    """The ball's centre is 0.1 m from the axis of link 3: 0.06 m outside, so 0.14 m of the radius are inside."""
    plan = bp.plan(planar4, site(goal(2.0, 2.0), obstacles=[ball(2.5, 0.1, 0.2)]), effort="quick")
    assert plan.reason == "start_in_collision"
    assert (obstruction(plan).link, obstruction(plan).obstacle) == ("link3", "ball")
    assert -obstruction(plan).distance == pytest.approx(0.14, abs=1e-9)
    assert "link3 is 0.140 m inside ball" in plan.message
    np.testing.assert_array_equal(plan.trajectory.q, [[0.0, 0.0, 0.0, 0.0]])


def test_a_start_in_collision_is_reported_with_the_least_move_of_one_joint(planar4: bp.Robot) -> None:
    """The link's axis must be 0.263 m from the ball's centre: radius, half of the link, clearance and 3 mm to spare.

    Seen from joint1 the centre is atan(0.1 / 2.5) = 0.040 rad to the left and 2.502 m away, so that joint1 turns to
    0.040 - asin(0.263 / 2.502) = -0.065 rad; from joint2, 1 m further, it would have to be -0.109 rad.
    """
    task, obstacles = goal(2.0, 2.0), [ball(2.5, 0.1, 0.2)]
    plan = bp.plan(planar4, site(task, obstacles=obstacles), effort="quick")
    assert plan.message.endswith("inside ball; with joint1 at -0.07 rad instead of 0 it keeps its clearances")
    moved = {"joints": STRETCHED["joints"] | {"joint1": -0.07}}
    assert bp.plan(planar4, site(task, start=moved, obstacles=obstacles), effort="quick").verified


def test_a_start_that_no_single_joint_clears_is_reported_without_a_move(planar4: bp.Robot) -> None:
    """A ring of radius 1.5 m, 0.4 m thick, crosses link 2, whose end is 2 cos(0.75) = 1.46 m or more from joint1."""
    angles = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    around = [ball(1.5 * np.cos(a), 1.5 * np.sin(a), 0.2) | {"name": f"ball {i}"} for i, a in enumerate(angles)]
    plan = bp.plan(planar4, site(goal(2.0, 2.0), obstacles=around), effort="quick")
    assert plan.reason == "start_in_collision"
    assert "instead of" not in plan.message


def test_a_start_closer_than_the_clearance_is_reported(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(goal(2.0, 2.0), obstacles=[ball(2.5, 0.25, 0.2)]), effort="quick")
    assert plan.reason == "start_in_collision"
    assert obstruction(plan).distance == pytest.approx(0.01, abs=1e-9)
    assert "0.010 m closer than allowed" in plan.message


def test_a_goal_in_collision_is_told_with_a_free_place_nearby(backhoe: bp.Robot) -> None:
    """The tip is part of the bucket: around a ball of 0.3 m with 0.1 m of clearance it keeps 0.4 m or more."""
    content: Data = {
        "version": 1, "start": {"joints": {"swing": 0.6, "boom": 0.3, "stick": -1.2, "bucket": -1.2}},
        "task": {"goal": {"position": [4.0, 0.0, 1.0], "pitch": [-2.0, -1.0]}}, "clearance": 0.1,
        "obstacles": [{"name": "ball", "shape": "sphere", "radius": 0.3, "position": [4.0, 0.0, 1.0]}],
    }  # fmt: skip
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.reason == "goal_in_collision"
    found = re.search(r"free place that was found is ([0-9.]+) m away, at \(([^)]*)\), by \(([^)]*)\) m", plan.message)
    assert found is not None, plan.message
    place, by = (np.array([float(one) for one in found[group].split(",")]) for group in (2, 3))
    np.testing.assert_allclose(place - by, [4.0, 0.0, 1.0], atol=0.011)
    assert 0.4 <= float(found[1]) <= 1.6
    assert float(found[1]) == pytest.approx(np.linalg.norm(by), abs=0.01)
    further = (place + 0.03 * by).tolist()  # the printed place is rounded
    content["task"] = {"goal": {"position": further, "pitch": [-2.0, -1.0]}}
    assert bp.plan(backhoe, bp.scene_from_dict(content), effort="quick").verified


def test_a_goal_in_collision_names_the_obstacle_and_the_link(planar4: bp.Robot) -> None:
    """Every configuration has the middle of link 4's end face at the goal, 0.1 m inside the ball's surface."""
    plan = bp.plan(planar4, site(goal(2.0, 2.0), obstacles=[ball(2.0, 2.1, 0.2)]), effort="quick")
    assert plan.reason == "goal_in_collision"
    assert obstruction(plan).obstacle == "ball"
    assert obstruction(plan).link == "link4"
    assert -obstruction(plan).distance >= 0.1 - 1e-6


def test_a_start_outside_the_limits_names_the_joint(planar4: bp.Robot) -> None:
    start = {"joints": STRETCHED["joints"] | {"joint2": 4.0}}
    plan = bp.plan(planar4, site(goal(2.0, 2.0), start=start), effort="quick")
    assert plan.reason == "outside_limits"
    assert plan.findings.joints == ("joint2",)
    assert "joint2 starts at 4" in plan.message
    assert "degrees" not in plan.message
    start = {"joints": STRETCHED["joints"] | {"joint2": 23.0}}
    plan = bp.plan(planar4, site(goal(2.0, 2.0), start=start), effort="quick")
    assert plan.message.endswith(" rad (23 degrees are 0.4014 rad)")


# link 1 cannot pass two walls that leave a slit of 1.4 m around the base
WALLS: list[Data] = [
    {"name": f"wall {side}", "shape": "box", "size": [0.1, 7.0, 0.5], "position": [0.0, side * 4.2, 0.0]}
    for side in (-1.0, 1.0)
]


@pytest.mark.long
def test_a_goal_behind_walls_is_blocked_after_all_attempts(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(goal(-3.0, 1.0), obstacles=WALLS), effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "blocked")
    assert obstruction(plan).obstacle.startswith("wall")
    assert "attempts" in plan.message
    assert "--method" not in plan.message
    assert plan.certificate.safe
    assert not plan.certificate.verified


def test_the_law_alone_is_blocked_by_walls_and_names_the_method_that_searches(planar4: bp.Robot) -> None:
    plan = bp.plan(planar4, site(goal(-3.0, 1.0), obstacles=WALLS), method="reactive", effort="quick")
    assert (plan.verdict, plan.reason) == ("failed", "blocked")
    assert obstruction(plan).obstacle.startswith("wall")
    assert plan.message.endswith("the law alone was tried: --method auto searches for other ways as well")
    assert plan.certificate.safe
    assert not plan.certificate.verified


def test_without_time_the_plan_holds_the_start_and_says_so(planar4: bp.Robot) -> None:
    scene = site(path(speed=0.4), start=None, obstacles=[ball(2.1, 0.0, 0.15)])
    plan = bp.plan(planar4, scene, budget=1e-6)
    assert plan.reason == "budget"
    assert plan.message.startswith("time ran out after 1e-06 s of computing; --budget gives more")
    assert plan.certificate.safe
    assert len(plan.trajectory) == 1


# --- arguments --------------------------------------------------------------------


def test_the_method_paper_takes_no_path(planar4: bp.Robot) -> None:
    with pytest.raises(bp.InputError) as caught:
        bp.plan(planar4, site(path(), start=None), method="paper")
    assert caught.value.key == "method"


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ({"method": "reactiv"}, "method"),
        ({"effort": "quickly"}, "effort"),
        ({"budget": 0.0}, "budget"),
        ({"budget": float("nan")}, "budget"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**64}, "seed"),
    ],
)
def test_errors_in_arguments_name_the_argument(planar4: bp.Robot, keys: Data, key: str) -> None:
    with pytest.raises(bp.InputError) as caught:
        bp.plan(planar4, site(goal(2.0, 2.0)), **keys)
    assert caught.value.key == key
    if key == "effort":
        assert "did you mean 'quick'" in str(caught.value)
    if key == "method":
        assert "did you mean 'reactive'" in str(caught.value)


def test_the_same_seed_gives_the_same_plan(planar4: bp.Robot) -> None:
    scene = bp.load_scene(SCENES / "paper_planar.yaml")
    first, second = (plan_to_dict(bp.plan(planar4, scene, seed=3, effort="quick")) for _ in range(2))
    for content in (first, second):
        assert content["metrics"].pop("planning_time") > 0.0
    assert first == second


REPEATED = ("paper_planar", "pole", "truck")
SCENES_AGAIN = f"""
import sys
import backhoe_planner as bp
for name in {REPEATED}:
    robot = bp.load_robot("example:planar4" if name == "paper_planar" else "example:backhoe")
    plan = bp.plan(robot, bp.load_scene(f"{{sys.argv[1]}}/{{name}}.yaml"), effort="quick")
    print(name, plan.reason, plan.trajectory.time.tobytes().hex(), plan.trajectory.q.tobytes().hex(), sep=",")
"""


@pytest.mark.long
def test_a_busy_computer_gives_the_same_plan_bit_for_bit() -> None:
    """The second process may run a third of the time only, as if among four others on two cores."""
    code = [sys.executable, "-c", SCENES_AGAIN, str(SCENES)]
    undisturbed = subprocess.run(code, stdout=subprocess.PIPE, text=True, check=True).stdout
    assert len(undisturbed.splitlines()) == len(REPEATED)
    with subprocess.Popen(code, stdout=subprocess.PIPE, text=True) as process, ThreadPoolExecutor() as reader:
        assert process.stdout is not None
        printed = reader.submit(process.stdout.read)
        while process.poll() is None:
            clock.sleep(0.1)
            process.send_signal(signal.SIGSTOP)
            clock.sleep(0.2)
            process.send_signal(signal.SIGCONT)
        assert printed.result() == undisturbed
    assert process.returncode == 0


def test_the_watcher_receives_the_steps_of_the_search(planar4: bp.Robot) -> None:
    seen: list[bp.PlannerStep] = []
    plan = bp.plan(planar4, bp.load_scene(SCENES / "paper_planar.yaml"), watch=seen.append)
    assert plan.verified
    assert len(seen) > 10
    assert all(step.q.shape == (4,) and np.all(np.isfinite(step.q)) for step in seen)
    np.testing.assert_allclose(seen[-1].q, plan.trajectory.q[-1], atol=0.05)


@pytest.mark.long
def test_a_detour_keeps_the_acceleration_limits_at_its_seams(planar4: bp.Robot) -> None:
    """Path, detour, path: each piece is from rest to rest, and limits hold over all of them."""
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "task": {
                "path": {
                    "waypoints": [{"position": [1.5, 1.5, 0.0]}, {"position": [3.0, 1.5, 0.0]}],
                    "speed": 0.4,
                }
            },
            "clearance": 0.02,
            "influence": 0.4,
            "obstacles": [{"name": "ball", "shape": "sphere", "radius": 0.1, "position": [2.2, 1.6, 0.0]}],
        }
    )
    plan = bp.plan(planar4, scene, effort="quick")
    assert plan.certificate.acceleration.ratio <= 1.0 + 1e-6
    assert plan.verified, plan.message


def test_a_waypoint_out_of_reach_is_named(planar4: bp.Robot) -> None:
    waypoints = [{"position": [2.0, 0.0, 0.0]}, {"position": [3.0, 0.0, 0.0]}, {"position": [5.0, 0.0, 0.0]}]
    plan = bp.plan(
        planar4, bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": waypoints}}}), effort="quick"
    )
    assert plan.reason == "unreachable"
    assert "waypoint 3" in plan.message
    assert nearest(plan).position_error == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    "obstacle", [{}, {"appears_at": 0.5}, {"velocity": [-0.1, 0.0, 0.0]}, {"shape": "none"}], ids=str
)
def test_a_machine_that_cannot_collide_is_planned(backhoe: bp.Robot, obstacle: dict[str, Any]) -> None:
    """Only its swing moves, so its links are fixed to each other; any obstacle is far away or appears later."""
    ball = {"name": "far", "shape": "sphere", "radius": 0.1, "position": [9.0, 9.0, 9.0]} | obstacle
    scene = bp.scene_from_dict(
        {
            "version": 1, "start": {"joints": {"swing": 0.0}}, "hold": {"boom": 0.4, "stick": -1.6, "bucket": -0.9},
            "task": {"goal": {"joints": {"swing": 1.0}}},
            "obstacles": [ball] if obstacle.get("shape") != "none" else [],
        }
    )  # fmt: skip
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    np.testing.assert_allclose(plan.trajectory.q[-1], 1.0, atol=1e-9)
