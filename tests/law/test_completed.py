"""The completed law: bounded, smooth, and without effect on the tip."""

from __future__ import annotations

import numpy as np
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.law import (
    CompletedLaw,
    CriticalRows,
    activation,
    link_chain,
    link_jacobian,
    link_velocities,
    null_space_term,
    push_factor,
)
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.site import Gains, Nearby, Proximity, build_obstacles, scene_from_dict

INFLUENCE = 0.6  # unity distance 0.2
EPSILON = 2e-2  # (m/rad)^2, the regularisation stated in the module


def around(robot: Robot, *positions: tuple[float, float, float], radius: float = 0.1) -> Proximity:
    """The machine among spheres, without self-collision."""
    scene = scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict.fromkeys(robot.joint_names, 0.0)},
            "task": {"goal": {"position": [1.0, 0.0, 0.0]}},
            "clearance": 0.0,
            "influence": INFLUENCE,
            "obstacles": [
                {"name": f"ball {index}", "shape": "sphere", "radius": radius, "position": list(position)}
                for index, position in enumerate(positions)
            ],
        }
    )
    return Proximity(robot, build_obstacles(scene, robot), self_collision=False)


def near(proximity: Proximity, q: Vector) -> Nearby:
    return proximity.at(q, within=INFLUENCE)


def one_pair(margin: float, gradient: Vector) -> Nearby:
    """A single critical point with a given margin and gradient."""
    flat = np.zeros((1, 3))
    return Nearby(
        pair=np.array([0]),
        distance=np.array([margin]),
        margin=np.array([margin]),
        normal=flat,
        point_link=flat,
        point_obstacle=flat,
        gradient=gradient[None, :],
        drift=np.zeros(1),
    )


BALLS = ((1.5, 1.0, 0.0), (-1.0, 1.8, 0.0), (0.5, -1.6, 0.0), (-2.0, -0.5, 0.0))


# --- weights ------------------------------------------------------------------------


def test_activation_equals_a_hand_calculation() -> None:
    found = activation(np.array([-0.5, 0.0, 0.1, 0.2, 0.3, 9.0]), 0.1, 0.3)
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-15)


def test_the_push_factor_equals_a_hand_calculation() -> None:
    """(0.1 / d)^2 - 1: 0 at the unity distance, 1 at 0.1 / sqrt 2, 3 at half of it, and never more."""
    found = push_factor(np.array([0.2, 0.1, 0.1 / np.sqrt(2.0), 0.05, 0.01, 0.0, -0.4]), 0.1)
    np.testing.assert_allclose(found, [0.0, 0.0, 1.0, 3.0, 3.0, 3.0, 3.0], atol=1e-12)


def test_weights_are_continuous_and_fall_with_distance() -> None:
    d = np.linspace(-0.1, 0.7, 8001)  # steps of 1e-4 m
    for values in (activation(d, 0.2, 0.6), push_factor(d, 0.2)):
        assert np.all(np.diff(values) <= 1e-12)
        assert np.max(np.abs(np.diff(values))) < 1e-2


# --- the null space ------------------------------------------------------------------


def test_null_space_terms_leave_the_tip_alone(any_robot: Robot) -> None:
    rng, kinematics = np.random.default_rng(8), Kinematics(any_robot)
    law = CompletedLaw(any_robot, influence=INFLUENCE)
    acted = 0
    for _ in range(40):
        q = any_robot.random_q(rng)
        at = kinematics.at(q)
        rows = np.max(np.abs(at.jacobian[:3]), axis=1) > 1e-9
        J_e = at.jacobian[:3][rows]
        nearest = at.points[2] + np.array([0.1, 0.2, 0.0])
        nearby = near(around(any_robot, (float(nearest[0]), float(nearest[1]), float(nearest[2]))), q)
        wish = law.wish(at, J_e, rng.normal(size=int(rows.sum())), nearby)
        assert np.max(np.abs(J_e @ wish.null)) < 1e-10
        np.testing.assert_allclose(wish.v, wish.primary + wish.null, atol=1e-15)
        acted += int(np.linalg.norm(wish.null) > 1e-4)
    assert acted > 10 or any_robot.n == 3


def test_the_null_space_term_is_bounded_where_the_printed_law_explodes(planar4: Robot) -> None:
    """In every configuration |H| <= |sqrt(w) missing| / (2 sqrt(epsilon)), a property of the damped problem.

    With a tip that wants 1 m/s and four balls this stays below 20 rad/s over 800 random
    configurations, while (J_o N)^+ of equation (10) asks for over 1,000 somewhere among them.
    """
    rng, kinematics = np.random.default_rng(9), Kinematics(planar4)
    law = CompletedLaw(planar4, influence=INFLUENCE, directionality=False)
    proximity = around(planar4, *BALLS)
    largest = printed = 0.0
    for _ in range(800):
        q = planar4.random_q(rng)
        at = kinematics.at(q)
        nearby = near(proximity, q)
        J_e, angle = at.jacobian[:2], rng.uniform(0.0, 2.0 * np.pi)
        xdot_e = np.array([np.cos(angle), np.sin(angle)])
        wish = law.wish(at, J_e, xdot_e, nearby)
        if not len(nearby):
            np.testing.assert_array_equal(wish.null, 0.0)
            continue
        weight = activation(nearby.margin, law.unity, INFLUENCE)
        missing = np.maximum(law.nominal * push_factor(nearby.margin, law.unity) - nearby.gradient @ wish.primary, 0.0)
        size = float(np.linalg.norm(wish.null))
        assert size <= np.linalg.norm(np.sqrt(weight) * missing) / (2.0 * np.sqrt(EPSILON)) + 1e-9
        largest = max(largest, size)
        row = int(np.argmin(nearby.distance))
        J_o = at.J_world[:3] + np.cross(at.J_world[3:].T, nearby.point_link[row]).T
        J_o = np.where(proximity.moves[nearby.pair[row]], J_o, 0.0)[:2]
        H_o = null_space_term(J_e, xdot_e, J_o, -0.2 * nearby.normal[row, :2])
        printed = max(printed, float(np.linalg.norm(H_o)))
    assert largest < 20.0
    assert printed > 1e3


def test_the_obstacle_term_increases_the_distance(planar4: Robot) -> None:
    """Inside the unity distance the nearest point is moved away, to first order, if it can be moved."""
    rng, kinematics = np.random.default_rng(10), Kinematics(planar4)
    law = CompletedLaw(planar4, influence=INFLUENCE, directionality=False)
    proximity = around(planar4, BALLS[0])
    tried = 0
    for _ in range(2500):
        q = planar4.random_q(rng)
        at, nearby = kinematics.at(q), near(proximity, q)
        if not len(nearby):
            continue
        nearby = nearby.only(np.arange(len(nearby)) == np.argmin(nearby.margin))
        wish = law.wish(at, at.jacobian[:2], np.zeros(2), nearby)
        served = float(np.linalg.norm(nearby.gradient[0] @ wish.task.projector))
        if nearby.margin[0] > 0.9 * law.unity or nearby.margin[0] < 1e-3 or served < 0.2:
            continue
        rate = float(nearby.gradient[0] @ wish.null)
        assert rate > 0.0
        h = 1e-5 / max(float(np.linalg.norm(wish.null)), 1e-3)
        pair = int(nearby.pair[0])
        grown = proximity.distance_of(pair, q + h * wish.null) - proximity.distance_of(pair, q)
        assert grown == pytest.approx(h * rate, rel=1e-2, abs=1e-9)
        tried += 1
    assert tried >= 20


def test_velocities_do_not_jump_as_an_obstacle_enters_the_influence(planar4: Robot) -> None:
    at = Kinematics(planar4).at(np.array([0.3, 0.8, -1.2, 0.7]))
    law = CompletedLaw(planar4, influence=INFLUENCE)
    gradient = np.array([0.8, -0.9, 0.4, 0.0])
    xdot_e = np.array([-0.4, -0.3])  # towards it

    def v(margin: float) -> Vector:
        return law.wish(at, at.jacobian[:2], xdot_e, one_pair(margin, gradient)).v

    without = law.wish(at, at.jacobian[:2], xdot_e, one_pair(1.0, gradient).only(np.array([False]))).v
    np.testing.assert_allclose(v(INFLUENCE + 1e-9), without, atol=1e-12)
    np.testing.assert_allclose(v(INFLUENCE - 1e-4), without, atol=1e-5)
    margins = np.linspace(-0.1, INFLUENCE, 3501)
    wishes = np.array([v(float(margin)) for margin in margins])
    assert np.max(np.abs(np.diff(wishes, axis=0))) < 0.02  # for 0.2 mm
    assert np.max(np.abs(wishes[0] - without)) > 0.03


def test_velocities_do_not_jump_as_the_nearest_obstacle_changes(planar4: Robot) -> None:
    """Between two balls, 0.1 mrad at a time: both act, so that it does not matter which is nearer."""
    kinematics = Kinematics(planar4)
    law = CompletedLaw(planar4, influence=INFLUENCE)
    proximity = around(planar4, (2.5, 0.45, 0.0), (2.5, -0.45, 0.0))
    q = np.array([0.1, -0.2, 0.2, -0.1])
    nearest, before, largest = set(), None, 0.0
    for shift in np.linspace(-0.05, 0.05, 1001):
        moved = q + np.array([shift, 0.0, 0.0, 0.0])
        nearby = near(proximity, moved)
        nearest.add(proximity.pairs[int(nearby.pair[np.argmin(nearby.margin)])].obstacle)
        at = kinematics.at(moved)
        v = law.wish(at, at.jacobian[:2], np.array([0.2, 0.1]), nearby).v
        if before is not None:
            largest = max(largest, float(np.max(np.abs(v - before))))
        before = v
    assert nearest == {"ball 0", "ball 1"}
    assert largest < 0.02


@pytest.mark.parametrize("copies", [1, 40])  # few rows and many are computed in different ways
@pytest.mark.parametrize(("s_e", "s_o"), [(1.0, 1.0), (0.5, 3.0)])
def test_the_answer_to_moving_obstacles_equals_a_hand_calculation(
    planar4: Robot, copies: int, s_e: float, s_o: float
) -> None:
    """The task needs the first three joints, so that H = z is the fourth: sum w g missing / (epsilon + sum w g^2).

    At 0.4 m, w = 0.5: the cosine is half way. The obstacle there comes nearer by 0.3 m/s and the tip's task takes the
    point away from it by 0.1 s_e, so 0.3 - 0.1 s_e m/s are missing. Of the other two, one is beyond the influence, and
    one moves away: it has no speed missing, but counts in the sum below. Each is there `copies` times.
    """
    at = Kinematics(planar4).at(np.array([0.3, 0.8, -1.2, 0.7]))
    law = CompletedLaw(planar4, influence=INFLUENCE, gains=Gains(s_e=s_e, s_o=s_o), directionality=False)
    J_e, xdot_e = np.eye(3, 4), np.array([0.1, 0.0, 0.0])
    gradient = np.array([[0.0, 0.0, 0.0, 5.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 0.4]])
    margin, drift = np.array([0.7, 0.4, 0.4]), np.array([-9.0, -0.3, 0.2])
    rows = CriticalRows(np.tile(margin, copies), np.tile(gradient, (copies, 1)), np.tile(drift, copies))
    below = EPSILON + s_o * copies * 0.5 * (2.0**2 + 0.4**2)
    expected = s_o * copies * 0.5 * 2.0 * (0.3 - 0.1 * s_e) / below
    wish, quick = law.wish(at, J_e, xdot_e, rows), law.quick_terms_unchecked(at.q, J_e, xdot_e, rows)
    assert quick is not None
    for primary, null in ((wish.primary, wish.null), quick[:2]):
        np.testing.assert_allclose(null, [0.0, 0.0, 0.0, expected], atol=1e-12)
        np.testing.assert_allclose(primary, [0.1 * s_e, 0.0, 0.0, 0.0], atol=1e-12)


# --- directionality -------------------------------------------------------------------


def test_the_nearness_of_a_joint_limit_equals_a_hand_calculation(planar4: Robot) -> None:
    """The zone is 0.15 of the range of 2 pi; half a zone away and moving towards the limit is 0.5."""
    law = CompletedLaw(planar4, influence=INFLUENCE)
    zone = 0.15 * 2.0 * np.pi
    q = np.array([np.pi - 0.5 * zone, np.pi, -np.pi + 0.25 * zone, 0.0])
    np.testing.assert_allclose(law.near_limit(q, np.ones(4)), [0.5, 1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(law.near_limit(q, -np.ones(4)), [0.0, 0.0, 0.75, 0.0], atol=1e-9)
    np.testing.assert_array_equal(law.near_limit(q, np.zeros(4)), np.zeros(4))
    np.testing.assert_allclose(law.near_limit(q + 0.1 * zone, np.ones(4))[1], 1.0)  # beyond it, too


def test_the_hold_of_a_joint_near_its_limit_equals_a_hand_calculation(planar4: Robot) -> None:
    """Joints 3 and 4 share a task, so that z = (0, 0, 1, -1) / sqrt 2 and both have the rate a / sqrt 2.

    Joint 3 is half a zone from its limit: h = 0.5^2, and H = -z h z_3 v_3 / (epsilon + h z_3^2).
    """
    q = np.array([0.0, 0.0, np.pi - 0.5 * 0.15 * 2.0 * np.pi, 0.0])
    law, a, z = CompletedLaw(planar4, influence=INFLUENCE), 0.3, np.array([0.0, 0.0, 1.0, -1.0]) / np.sqrt(2.0)
    J_e = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    xdot_e, nothing = np.array([0.0, 0.0, a]), CriticalRows(np.zeros(0), np.zeros((0, 4)), np.zeros(0))
    expected = -z * 0.25 * 0.5 * a / (EPSILON + 0.25 * 0.5)
    quick = law.quick_terms_unchecked(q, J_e, xdot_e, nothing)
    assert quick is not None
    for null in (law.wish(Kinematics(planar4).at(q), J_e, xdot_e, nothing).null, quick[1]):
        np.testing.assert_allclose(null, expected, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_near_its_limit_is_slowed(planar4: Robot, joint: int) -> None:
    """In every configuration: the joint's own rate is reduced, not a predicted turn of its link."""
    rng, kinematics = np.random.default_rng(11), Kinematics(planar4)
    with_it = CompletedLaw(planar4, influence=INFLUENCE)
    without = CompletedLaw(planar4, influence=INFLUENCE, directionality=False)
    nothing = one_pair(1.0, np.zeros(4)).only(np.array([False]))
    changes: list[float] = []
    while len(changes) < 300:
        q = rng.uniform(-2.0, 2.0, 4)  # the other joints are far from their limits
        q[joint] = np.pi - 0.05
        at = kinematics.at(q)
        J_e = at.jacobian[:2]
        if np.linalg.svd(J_e, compute_uv=False)[-1] < 0.3:
            continue
        angle = rng.uniform(0.0, 2.0 * np.pi)
        xdot_e = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        plain = without.wish(at, J_e, xdot_e, nothing)
        if plain.v[joint] < 0.02:
            continue
        held = with_it.wish(at, J_e, xdot_e, nothing)
        np.testing.assert_allclose(J_e @ held.v, J_e @ plain.v, atol=1e-10)
        changes.append(float((held.v[joint] - plain.v[joint]) / plain.v[joint]))
    assert np.max(changes) < 1e-9
    assert np.median(changes) < -0.5


def test_links_to_be_turned_give_the_least_sum_of_squares(planar4: Robot) -> None:
    """H = N y with the least epsilon |H|^2 + sum_k s_k |J_k (v_e + H) - xdot_k|^2, D = +1, by another solver."""
    at, weights = Kinematics(planar4).at(np.array([0.3, 0.8, -1.2, 0.7])), {"joint1": 0.2, "joint2": 3.0, "joint3": 0.7}
    law = CompletedLaw(planar4, influence=INFLUENCE, gains=Gains(s_k=weights))
    nothing = CriticalRows(np.zeros(0), np.zeros((0, 4)), np.zeros(0))
    found = law.wish(at, at.jacobian[:2], np.array([0.3, 0.2]), nothing)
    chain, N = link_chain(at), np.eye(4) - np.linalg.pinv(at.jacobian[:2]) @ at.jacobian[:2]
    asked = link_velocities(
        chain, at.jacobian[:3] @ found.primary, D=np.ones(3), magnification="norm_preserving", follow_bend=True,
        as_rates=True,
    )  # fmt: skip
    left, right = [np.sqrt(EPSILON) * N], [np.zeros(4)]
    for k, weight in enumerate(weights.values(), start=1):
        J_k = link_jacobian(chain, k, reference="standard")
        left.append(np.sqrt(weight) * J_k @ N)
        right.append(np.sqrt(weight) * (asked[k - 1] - J_k @ found.primary))
    expected = N @ np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=1e-10)[0]
    assert np.linalg.norm(expected) > 0.01
    np.testing.assert_allclose(found.null, expected, atol=1e-9)


def test_a_task_with_as_many_rows_as_joints_has_no_null_space_terms(planar4: Robot) -> None:
    """There is no null space, so H is 0."""
    at = Kinematics(planar4).at(np.array([0.3, 0.8, -1.2, 0.7]))
    law = CompletedLaw(planar4, influence=INFLUENCE)
    J = np.eye(4)
    found = law.wish(at, J, np.array([0.1, 0.2, 0.3, 0.4]), one_pair(0.0, np.ones(4)))
    np.testing.assert_allclose(found.null, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.v, [0.1, 0.2, 0.3, 0.4], atol=1e-12)
