"""Following plans in which the machine carries something: the load counts in its leg only."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest

from backhoe_planner import InputError, Kinematics, Plan, PlanFollower, Robot, Scene, Servo, plan, scene_from_dict
from backhoe_planner.live import Placements, RejoiningQuery, Separation, renew_plane
from backhoe_planner.site import Obstacle, Proximity, build_obstacles, with_carried

ROD, THICK = 1.2, 0.05  # m: how far the rod sticks out of the bucket to the left, and its radius
CLEAR = 0.05  # m
POSTURE = {"boom": 0.4, "stick": -1.6, "bucket": -0.9}
CARRIES = {"name": "rod", "shape": "capsule", "from": [0, 0, 0], "to": [0, ROD, 0], "radius": THICK}
SWINGS = (-0.3, 0.0, 0.35, 0.0)  # rad, from leg to leg
WALL = {"name": "wall", "shape": "halfspace", "normal": [0, -1, 0]}
DT = 0.02  # s


def scene_of(carries: dict[str, Any] | None) -> Scene:
    """An empty, a laden and an empty swing; the arm keeps its angles."""
    goals = [{"joints": POSTURE | {"swing": swing}} for swing in SWINGS[1:]]
    legs: list[dict[str, Any]] = [
        {"name": name, "goal": goal} for name, goal in zip(("there", "laden", "back"), goals, strict=True)
    ]
    if carries is not None:
        legs[1]["carries"] = carries
    start = {"joints": POSTURE | {"swing": SWINGS[0]}}
    return scene_from_dict({"version": 1, "start": start, "clearance": CLEAR, "task": {"sequence": legs}})


def planned(robot: Robot, carries: dict[str, Any] | None) -> Plan:
    found = plan(robot, scene_of(carries), effort="quick")
    assert found.verified, found.message
    return found


@pytest.fixture(scope="module")
def with_rod(backhoe: Robot) -> Plan:
    return planned(backhoe, CARRIES)


class NoAnswer(Executor):
    """Keeps the arguments of its calls and never answers."""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.asked += args
        return Future()


def end_of_rod(robot: Robot, swing: float) -> np.ndarray:
    """(3,) the middle of the rod's far end, by the tip's own frame: the arm's axes are level."""
    at = Kinematics(robot).at(robot.check_q([swing, *POSTURE.values()]))
    return np.asarray(at.tip_position + ROD * np.array([-np.sin(swing), np.cos(swing), 0.0]))


def wall_at(robot: Robot, swing: float) -> dict[str, Any]:
    """A wall to the left, at its clearance from the rod's end at `swing` [rad]."""
    return WALL | {"point": [0.0, float(end_of_rod(robot, swing)[1]) + THICK + CLEAR, 0.0]}


@pytest.mark.parametrize(("carries", "gets_there"), [(CARRIES, False), (None, True)])
def test_a_rod_that_is_too_long_stops_the_machine_at_the_wall(
    backhoe: Robot, with_rod: Plan, carries: dict[str, Any] | None, gets_there: bool
) -> None:
    """By hand: the rod's end comes to the wall at a swing of 0.2 rad, and the machine without it does not stop.

    The detour is searched for the machine with the rod.
    """
    found = with_rod if carries else planned(backhoe, None)
    servo = Servo(backhoe, found.scene, dt=DT)
    servo.add(wall_at(backhoe, 0.2))
    swung, executor = [], NoAnswer()
    with PlanFollower(servo, found, executor=executor) as follower:
        for _ in range(int((found.trajectory.duration + 2.0) / DT)):
            state = follower.step()
            swung.append(state.state.q[0])
    assert state.done is gets_there
    queries = [one for one in executor.asked if isinstance(one, RejoiningQuery)]
    assert [one.robot.carried is not None and one.robot.carried[0] == "rod" for one in queries] == [True] * len(queries)
    assert bool(queries) is not gets_there
    if gets_there:
        assert max(swung) == pytest.approx(0.35, abs=1e-3)
        return
    assert 0.18 < max(swung) < 0.2 + 1e-6
    nearest = state.state.nearest
    assert nearest is not None
    assert (nearest.link, nearest.name) == ("rod", "wall")
    assert nearest.margin >= 0.0


@pytest.mark.long
def test_margins_in_each_leg_are_those_of_the_machine_with_its_load(backhoe: Robot, with_rod: Plan) -> None:
    servo = Servo(backhoe, with_rod.scene, dt=DT)
    servo.add(wall_at(backhoe, 0.37))  # near enough to be checked, and never reached
    compared: dict[tuple[str, bool], int] = {}
    with PlanFollower(servo, with_rod) as follower:
        for _ in range(int(with_rod.trajectory.duration / DT) + 50):
            state = follower.step()
            leg = [one for one in with_rod.legs if one.begins <= max(state.plan_time - DT, 0.0)][-1]
            exact = Proximity(leg.problem.robot, servo.snapshot()).tightest(state.state.q)
            near = state.state.nearest
            assert exact is not None
            if near is not None:
                assert near.margin <= exact.margin + 1e-6
                assert near.margin >= exact.margin - 0.05
                compared[leg.name, near.link == "rod"] = compared.get((leg.name, near.link == "rod"), 0) + 1
            if state.done:
                break
    assert state.done
    assert state.behind < 0.1
    assert compared["laden", True] > 5
    assert not compared.get(("there", True), 0)
    assert not compared.get(("back", True), 0)


def test_pairs_and_distances_are_those_of_the_laden_machine(backhoe: Robot) -> None:
    """Two loads in turn, and none: as `Proximity` has them for that machine, pair by pair."""
    content = scene_of(CARRIES).to_dict()
    content["task"]["sequence"][2]["carries"] = {"name": "ball", "shape": "sphere", "radius": 0.4}
    content["obstacles"] = [
        {"name": "post", "shape": "capsule", "radius": 0.1, "from": [3, 2, -1], "to": [3, 2, 2]},
        {"name": "heap", "shape": "box", "size": [1, 1, 1], "position": [3, -2, 0], "links": ["boom", "stick"]},
        {"name": "kerb", "shape": "box", "size": [1, 1, 1], "position": [4, 2, 0], "links": ["bucket"]},
    ]
    scene = scene_from_dict(content)
    built: tuple[Obstacle, ...] = build_obstacles(scene, backhoe)
    laden = tuple(with_carried(backhoe, scene, index) for index in (1, 2))
    separation, at = Separation(backhoe, laden=laden), Placements(backhoe, 1)
    separation.add(dict(enumerate(built)))
    rng = np.random.default_rng(3)
    for load, robot in ((-1, backhoe), (0, laden[0]), (1, laden[1]), (-1, backhoe)):
        separation.carry(load)
        proximity = Proximity(robot, built)
        counting = np.flatnonzero(separation.clearance >= 0.0)
        assert len(counting) == len(proximity.pairs)
        for _ in range(4):
            q = backhoe.random_q(rng)
            at.place(0, q)
            found = [renew_plane(separation, pair, at, 0) for pair in counting.tolist()]
            np.testing.assert_allclose(np.sort(found), np.sort(proximity.distances(q)), atol=2e-6)


def test_a_load_counts_from_the_step_in_which_it_is_taken_up(backhoe: Robot) -> None:
    """The rod's end is inside a ball: the machine may only leave it, and is free again without the rod."""
    scene = scene_of(CARRIES)
    servo = Servo(backhoe, scene, dt=DT)
    servo.add({"name": "ball", "shape": "sphere", "radius": 0.2, "position": end_of_rod(backhoe, -0.25).tolist()})
    assert servo.step(joint_velocity=np.zeros(4)).margin > 0.1
    servo.carry("laden")
    assert servo.robot.carried is not None
    held = [servo.step(joint_velocity=[0.3, 0.0, 0.0, 0.0]) for _ in range(20)]
    exact = Proximity(servo.robot, servo.snapshot()).tightest(held[-1].q)
    assert exact is not None
    assert (exact.link, exact.name) == ("rod", "ball")
    assert held[-1].q[0] <= SWINGS[0] + 1e-6  # it does not move towards the ball
    servo.carry(None)
    free = [servo.step(joint_velocity=[0.3, 0.0, 0.0, 0.0]) for _ in range(20)]
    gained = 20 * DT * servo.limits.acceleration[0]
    assert free[-1].v[0] == pytest.approx(held[-1].v[0] + gained, abs=1e-9)
    with pytest.raises(InputError, match="no such leg"):
        servo.carry("nowhere")


def test_a_servo_whose_scene_lacks_the_load_is_refused(backhoe: Robot, with_rod: Plan) -> None:
    with pytest.raises(InputError, match="rod in leg 'laden'"):
        PlanFollower(Servo(backhoe, scene_of(None), dt=DT), with_rod)
