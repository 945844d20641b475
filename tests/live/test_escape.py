"""Ways out of obstacles where descent alone finds none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.live import MOST_LOOKS, EscapeRoute, EscapeSearch, RouteSearch, Servo
from backhoe_planner.machine import Robot
from backhoe_planner.site import Proximity, build_obstacles

DT = 0.004  # s, the time step: long ways out are simulated
BESIDE_THE_POST = {
    "name": "wall", "shape": "box", "size": [0.3, 3.0, 2.0], "position": [0.837, -1.48, 0.31],
}  # fmt: skip
IN_THE_STICK = {"name": "ball", "shape": "sphere", "radius": 0.134, "position": [3.19, 0.689, 0.207]}
AROUND_THE_POST = {"name": "wall", "shape": "box", "size": [0.3, 3.0, 2.0], "position": [0.221, -1.532, -0.253]}
PINCHED_BY_THE_POST = [0.228, 0.007, -1.941, -0.988]  # in BESIDE_THE_POST
PINCHED_BY_THE_STICK = [0.21, -0.116, -1.384, -0.433]  # in IN_THE_STICK
NOWHERE_TO_GO = [1.545, 0.414, -2.279, 0.289]  # in AROUND_THE_POST: no angle of the swing is clear of it


def site(robot: Robot, obstacles: list[dict[str, Any]], q: list[float]) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, q, strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "clearance": 0.05,
            "obstacles": obstacles,
        }
    )


class Violation:
    """The largest shortfall of any clearance [m], by Proximity."""

    def __init__(self, robot: Robot, scene: bp.Scene) -> None:
        self._proximity = Proximity(robot, build_obstacles(scene, robot))

    def __call__(self, q: Vector) -> float:
        return float(np.max(self._proximity.clearance - self._proximity.distances(q)))


def search_from(servo: Servo) -> EscapeSearch:
    # opens the wall: the ceiling is that of the servo's own start
    separation, inside = servo._separation, servo._bounds.inside
    ceiling = np.full(len(separation), np.max(separation.clearance[inside] - servo._bounds._distance[inside]))
    return EscapeSearch(
        servo.robot, servo.limits, separation, servo.q,
        watched=np.arange(len(separation)), inside=inside, ceiling=ceiling, rng=np.random.default_rng(1),
    )  # fmt: skip


def ended(search: RouteSearch) -> tuple[EscapeRoute | None, int]:
    """The result of a search and the number of its looks."""
    looks = 0
    while True:
        try:
            next(search)
        except StopIteration as found:
            return found.value, looks
        looks += 1


def along(route: EscapeRoute, step: float = 0.002) -> list[Vector]:
    """Configurations along a route; no joint moves by more than a step from one to the next."""
    found = [route.nodes[0]]
    for a, b in zip(route.nodes[:-1], route.nodes[1:], strict=True):
        count = max(int(np.ceil(np.max(np.abs(b - a)) / step)), 1)
        found += [a + part / count * (b - a) for part in range(1, count + 1)]
    return found


# --- the search -----------------------------------------------------------------------------


def test_the_violation_falls_along_a_falling_route(backhoe: Robot) -> None:
    """From a configuration where steepest descent is pinched."""
    scene = site(backhoe, [IN_THE_STICK], PINCHED_BY_THE_STICK)
    servo, violation = Servo(backhoe, scene), Violation(backhoe, scene)
    search = search_from(servo)
    route, looks = ended(search.descent(servo.q))
    assert route is None
    route, more = ended(search.falling(servo.q))
    assert route is not None
    assert route.falling
    depths = [violation(q) for q in route.nodes]
    assert depths[0] > 0.1
    assert np.all(np.diff(depths) < 0.0)
    assert depths[-1] <= 1e-6
    assert looks + more <= MOST_LOOKS
    assert np.all(route.nodes <= backhoe.limits.upper)
    assert np.all(route.nodes >= backhoe.limits.lower)


def test_a_route_below_the_ceiling_is_nowhere_deeper_than_its_start(backhoe: Robot) -> None:
    scene = site(backhoe, [BESIDE_THE_POST], PINCHED_BY_THE_POST)
    servo, violation = Servo(backhoe, scene), Violation(backhoe, scene)
    route, looks = ended(search_from(servo).below(servo.q))
    assert route is not None
    assert not route.falling
    depths = np.array([violation(q) for q in along(route)])
    assert np.max(depths) <= depths[0] + 1e-4  # between two looks
    assert depths[-1] <= 0.0
    assert looks <= MOST_LOOKS


@pytest.mark.long
def test_no_route_is_found_where_no_configuration_is_clear(backhoe: Robot) -> None:
    scene = site(backhoe, [AROUND_THE_POST], NOWHERE_TO_GO)
    servo, violation = Servo(backhoe, scene), Violation(backhoe, scene)
    swings = np.linspace(backhoe.limits.lower[0], backhoe.limits.upper[0], 200)
    assert min(violation(np.array([swing, 1.2, -0.5, 0.0])) for swing in swings) > 0.1
    escape = search_from(servo)
    for search in (escape.descent(servo.q), escape.falling(servo.q), escape.below(servo.q)):
        route, looks = ended(search)
        assert route is None
        assert looks <= MOST_LOOKS


# --- the servo ------------------------------------------------------------------


@pytest.mark.long
def test_the_violation_falls_at_every_step_where_descent_is_pinched(backhoe: Robot) -> None:
    scene = site(backhoe, [IN_THE_STICK], PINCHED_BY_THE_STICK)
    servo, violation = Servo(backhoe, scene, DT), Violation(backhoe, scene)
    before, v = violation(servo.q), servo.v
    for _ in range(1000):
        state = servo.step([0.3, -0.2, 0.4])
        now = violation(state.q)
        assert now < before
        assert np.all(np.abs(state.v - v) <= backhoe.limits.acceleration * servo.dt * (1.0 + 1e-9))
        before, v = now, state.v
        if now <= 1e-6:
            break
    assert before <= 1e-6


@pytest.mark.long
def test_past_a_hump_the_way_to_go_shrinks_and_the_violation_never_exceeds_the_first(backhoe: Robot) -> None:
    """The swing post is in a wall that is deeper on either side: no route falls all the way."""
    scene = site(backhoe, [BESIDE_THE_POST], PINCHED_BY_THE_POST)
    servo, violation = Servo(backhoe, scene, DT), Violation(backhoe, scene)
    first = before = violation(servo.q)
    to_go = np.inf
    passed = 0
    for _ in range(1000):
        state = servo.step(joint_velocity=[0.0, 0.1, 0.0, 0.0])
        now = violation(state.q)
        assert now <= first
        if servo.way_to_go is None:
            assert now <= max(before, 1e-6)
        else:
            assert servo.way_to_go < to_go
            assert now <= servo.way_to_go
            to_go = servo.way_to_go
            passed += now > before
        before = now
        if now <= 1e-6:
            break
    assert before <= 1e-6
    assert passed * DT > 0.05


def test_without_a_way_out_the_violation_does_not_grow(backhoe: Robot) -> None:
    scene = site(backhoe, [AROUND_THE_POST], NOWHERE_TO_GO)
    servo, violation = Servo(backhoe, scene, DT), Violation(backhoe, scene)
    first = violation(servo.q)
    for step in range(150):
        state = servo.step([0.5, 0.5, 0.5])
        if step % 5 == 0:
            assert violation(state.q) <= first
    assert servo.way_to_go is None


@pytest.mark.parametrize("joint", [1, pytest.param(3, marks=pytest.mark.long)])
def test_violations_of_a_limit_and_of_an_obstacle_shrink_together(backhoe: Robot, joint: int) -> None:
    q = np.array([0.0, 0.3, -0.9, -0.5])
    q[joint] = backhoe.limits.lower[joint] - 0.06
    tip = bp.Kinematics(backhoe).at(q).tip_position
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": (tip + np.array([0.0, 0.05, -0.1])).tolist()}
    scene = site(backhoe, [ball], [0.0, 0.3, -0.9, -0.5])
    servo, violation = Servo(backhoe, scene, DT, q=q), Violation(backhoe, scene)
    before, outside = violation(q), 0.06
    assert before > 0.05
    for _ in range(2000):
        state = servo.step([0.3, 0.0, 0.3])
        now, left = violation(state.q), float(backhoe.limits.lower[joint] - state.q[joint])
        assert now < before or now <= 1e-6
        assert left < outside or left <= 1e-9
        before, outside = now, left
        if now <= 1e-6 and left <= 1e-9:
            break
    assert before <= 1e-6
    assert outside <= 1e-9


@pytest.mark.long
def test_a_way_out_is_found_after_the_obstacle_was_moved_during_the_escape(backhoe: Robot) -> None:
    scene = site(backhoe, [IN_THE_STICK], PINCHED_BY_THE_STICK)
    servo = Servo(backhoe, scene, DT)
    shift = np.zeros(3)
    for k in range(12):
        by = 0.01 * np.array([np.cos(k), np.sin(k), np.cos(2 * k)])
        servo.move("ball", by)
        shift += by
        for _ in range(4):
            assert np.all(np.isfinite(servo.step([0.3, -0.2, 0.4]).q))
    moved = {**IN_THE_STICK, "position": (np.array(IN_THE_STICK["position"]) + shift).tolist()}
    violation = Violation(backhoe, site(backhoe, [moved], PINCHED_BY_THE_STICK))
    before = violation(servo.q)
    assert before > 0.01
    for step in range(1120):
        servo.step([0.3, -0.2, 0.4])
        if step % 12 == 0 and violation(servo.q) <= 1e-6:
            break
    assert violation(servo.q) <= 1e-6


def test_a_joint_held_outside_its_limit_by_obstacles_returns(backhoe: Robot) -> None:
    """The stick has to move out by 5 mrad, but the bucket is on the ground and the boom next to a stabilizer."""
    ground = {"name": "ground", "shape": "halfspace", "point": [0.0, 0.0, -1.2683], "normal": [0.0, 0.0, 1.0]}
    scene = site(backhoe, [ground], [0.0, 0.3, -0.9, -0.5])
    violation = Violation(backhoe, scene)
    q = np.array([-1.5584, -0.3660, -2.4494, -1.0140])
    outside = float(backhoe.limits.lower[2] - q[2])
    assert 0.004 < outside < 0.007
    assert violation(q) <= 0.0
    servo = Servo(backhoe, scene, q=q)
    for step in range(4000):
        state = servo.step(joint_velocity=[0.0, 0.0, 0.0, 0.0])
        left = float(backhoe.limits.lower[2] - state.q[2])
        assert left <= outside + 1e-12
        if step % 20 == 0:
            assert violation(state.q) <= 1e-6
        outside = left
        if left <= 1e-9:
            break
    assert outside <= 1e-9


@pytest.mark.long
def test_the_same_start_gives_the_same_motion(backhoe: Robot) -> None:
    scene = site(backhoe, [IN_THE_STICK], PINCHED_BY_THE_STICK)
    ends = []
    for _ in range(2):
        servo = Servo(backhoe, scene)
        ends.append([servo.step([0.3, -0.2, 0.4]).q for _ in range(150)][-1])
    np.testing.assert_array_equal(ends[0], ends[1])


def test_a_failing_search_raises_nothing_and_descent_continues(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> RouteSearch:
        yield
        raise ZeroDivisionError

    monkeypatch.setattr(EscapeSearch, "descent", fails)
    tip = bp.Kinematics(backhoe).at(np.array([0.0, 0.3, -0.9, -0.5])).tip_position
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": (tip + np.array([0.0, 0.0, -0.1])).tolist()}
    scene = site(backhoe, [ball], [0.0, 0.3, -0.9, -0.5])
    servo, violation = Servo(backhoe, scene), Violation(backhoe, scene)
    first = violation(servo.q)
    for _ in range(300):
        servo.step([0.0, 0.0, -0.3])
    assert violation(servo.q) < first - 0.01
