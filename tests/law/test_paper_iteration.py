"""The law as printed, iterated as in the paper: its figures on one scene, and its limits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from backhoe_planner import load_scene, plan, scene_from_dict
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import ITERATIONS, Magnification, Push, Reference, paper_gains, paper_step, run_iteration
from backhoe_planner.machine import Configuration, Kinematics, Robot, TipTarget
from backhoe_planner.motion import build_problem
from backhoe_planner.site import Gains, Pose, Proximity

REGION = 0.5
NO_TERMS = Gains(s_e=0.2)
PUSHED = Gains(s_e=0.2, s_o=0.2)
TURNED = Gains(s_e=0.2, s_o=0.2, s_k={"joint1": 0.01, "joint2": 0.01})


@dataclass(frozen=True)
class Task:
    """Start, goal and point obstacle of a planar scene."""

    start: tuple[float, ...]
    goal: tuple[float, float]
    obstacle: tuple[float, float]


NAMED = Task((-2.0, -0.85, -1.83, -1.57), (2.2, -2.33), (1.78, -1.34))
SHOWN = Task((1.42, 1.86, 1.71, 1.16), (0.45, -2.16), (0.63, 0.59))  # scenes/paper_planar.yaml


@dataclass(frozen=True)
class Run:
    """The result of a hundred iterations."""

    arrival: int | None
    error: float
    closest: float
    largest_step: float


def nearest(at: Configuration, obstacle: Vector) -> tuple[float, Vector, int]:
    """Distance, point and link, of the centre lines, nearest to the obstacle."""
    best: tuple[float, Vector, int] = (np.inf, np.zeros(3), 0)
    for link, (a, b) in enumerate(zip(at.points, at.points[1:], strict=False)):
        part = np.clip((obstacle - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        point = a + part * (b - a)
        distance = float(np.linalg.norm(point - obstacle))
        if distance < best[0]:
            best = distance, point, link
    return best


def iterated(
    robot: Robot,
    task: Task,
    gains: Gains,
    *,
    magnification: Magnification = "printed",
    reference: Reference = "tip_referenced",
) -> Run:
    kinematics = Kinematics(robot)
    goal = TipTarget(np.array([*task.goal, 0.0]))
    obstacle = np.array([*task.obstacle, 0.0])
    q = np.array(task.start)
    arrival, closest, largest = None, np.inf, 0.0
    for iteration in range(ITERATIONS):
        at = kinematics.at(q)
        if arrival is None and goal.distances(at)[0] < 0.01:
            arrival = iteration
        distance, point, link = nearest(at, obstacle)
        closest = min(closest, distance)
        push = None
        if distance < REGION:
            J_o = at.J_world[:3] + np.cross(at.J_world[3:].T, point).T
            J_o[:, link + 1 :] = 0.0
            push = Push(J_o=J_o, xdot_o=0.2 * (point - obstacle) / distance)
        step = paper_step(at, goal, push, gains, magnification=magnification, reference=reference)
        largest = max(largest, float(np.max(np.abs(step))))
        q = q + step
    return Run(arrival, goal.distances(kinematics.at(q))[0], closest, largest)


# --- golden numbers -----------------------------------------------------------------------


def test_without_terms_the_arm_passes_through_the_obstacle(planar4: Robot) -> None:
    found = iterated(planar4, NAMED, NO_TERMS)
    assert found.error < 1e-8
    assert found.closest == pytest.approx(0.163, abs=5e-4)


def test_with_directionality_the_arm_arrives_and_keeps_its_distance_but_jumps(planar4: Robot) -> None:
    """No nearer than 0.487 m; one joint turns 1.82 rad in one iteration."""
    found = iterated(planar4, NAMED, TURNED)
    assert found.error < 1e-8
    assert found.closest == pytest.approx(0.487, abs=5e-4)
    assert found.largest_step == pytest.approx(1.82, abs=5e-3)


def test_rounding_in_the_obstacle_term_does_not_throw_the_arm(planar4: Robot) -> None:
    """Once the tip itself is the critical point, J_o N is 0; its rounding, inverted, threw the arm by 1e15 rad."""
    found = iterated(planar4, NAMED, PUSHED)
    assert found.largest_step == pytest.approx(1.417, abs=5e-3)
    assert found.arrival == 31


@pytest.mark.parametrize(
    ("magnification", "reference", "closest", "largest"),
    [
        ("printed", "standard", 0.498, 0.379),
        ("norm_preserving", "tip_referenced", 0.487, 1.578),
        ("norm_preserving", "standard", 0.487, 0.387),
    ],
)
def test_other_readings_of_the_directionality_equal_an_independent_implementation(
    planar4: Robot, magnification: Magnification, reference: Reference, closest: float, largest: float
) -> None:
    """The figures were computed once in plain numpy, without Pinocchio."""
    found = iterated(planar4, NAMED, TURNED, magnification=magnification, reference=reference)
    assert found.closest == pytest.approx(closest, abs=1e-3)
    assert found.largest_step == pytest.approx(largest, abs=5e-3)


def test_the_shown_scene_has_the_pattern_of_the_paper(planar4: Robot) -> None:
    """Without terms: through the obstacle; with the obstacle term: no arrival; with all: after about 25 iterations."""
    plain, pushed, turned = (iterated(planar4, SHOWN, gains) for gains in (NO_TERMS, PUSHED, TURNED))
    assert plain.closest < 0.06
    assert plain.error < 1e-8
    assert pushed.arrival is None
    assert pushed.error > 0.01
    assert turned.arrival == 26
    assert turned.error < 1e-8
    assert turned.closest == pytest.approx(0.4987, abs=1e-3)
    assert turned.largest_step == pytest.approx(0.236, abs=2e-3)


def test_the_gain_of_the_primary_term_equals_a_hand_calculation(planar4: Robot) -> None:
    """The error shrinks to 1 - s_e of itself per iteration: 0.8^25 is 0.4 %, the paper's 25 iterations."""
    task = Task((0.3, 0.9, -1.1, 0.6), (2.3, 1.2), (9.0, 9.0))
    kinematics, goal = Kinematics(planar4), TipTarget(np.array([2.3, 1.2, 0.0]))
    q = np.array(task.start)
    for _ in range(5):
        at = kinematics.at(q)
        step = paper_step(at, goal, None, NO_TERMS)
        np.testing.assert_allclose(at.jacobian[:3] @ step, 0.2 * goal.error(at), atol=1e-12)
        q = q + step


def test_gains_are_those_of_the_paper() -> None:
    found = paper_gains(("swing", "boom", "stick", "bucket"))
    assert (found.s_e, found.s_o, found.s_k) == (0.2, 0.2, {"swing": 0.01, "boom": 0.01})


# --- run_iteration, on solid links -----------------------------------------------------------


def document(start: Vector, goal: list[float], obstacle: list[float]) -> dict[str, object]:
    return {
        "version": 1,
        "start": {"joints": {f"joint{index}": float(angle) for index, angle in enumerate(start, start=1)}},
        "task": {"goal": {"position": goal}},
        "clearance": 0.1,
        "influence": REGION,
        "obstacles": [{"name": "point", "shape": "sphere", "radius": 0.01, "position": obstacle}],
    }


def run(robot: Robot, start: Vector, goal: list[float], obstacle: list[float]) -> Matrix:
    problem = build_problem(robot, scene_from_dict(document(start, goal, obstacle)))
    return run_iteration(
        problem,
        start,
        problem.goals[0].target,
        proximity=Proximity(problem.robot, problem.obstacles),
        kinematics=Kinematics(problem.robot),
    )


def test_without_an_obstacle_near_there_is_no_push(planar4: Robot) -> None:
    """A folded arm is near itself all along, but the paper knows no self-contact."""
    start = np.array([0.2, 2.4, -2.2, 2.0])
    kinematics, goal = Kinematics(planar4), TipTarget(np.array([0.6, 1.4, 0.0]))
    found = run(planar4, start, [0.6, 1.4, 0.0], [9.0, 9.0, 0.0])
    q = start
    for expected in found[1:20]:
        q = q + paper_step(kinematics.at(q), goal, None, paper_gains(planar4.joint_names))
        np.testing.assert_allclose(expected, q, atol=1e-12)


def test_the_push_moves_the_near_link_away_and_not_the_tip(planar4: Robot) -> None:
    """An obstacle 0.2 m below the middle of link 1: from the first iteration on, the motion differs."""
    start = np.array([0.0, 0.9, -1.1, 0.6])
    goal = [2.6, 1.0, 0.0]
    away, near = run(planar4, start, goal, [9.0, 9.0, 0.0]), run(planar4, start, goal, [0.5, -0.25, 0.0])
    assert len(away) == len(near) == ITERATIONS + 1
    first = near[1] - away[1]
    assert first[0] > 0.01  # link 1 up, away from it
    J = Kinematics(planar4).at(start).jacobian[:2]
    np.testing.assert_allclose(J @ first, 0.0, atol=1e-9)


def test_iterates_are_finite_for_random_goals_and_obstacles(planar4: Robot) -> None:
    rng = np.random.default_rng(14)
    for _ in range(8):
        goal = [*rng.uniform(-4.5, 4.5, 2).tolist(), 0.0]
        found = run(planar4, planar4.random_q(rng), goal, [*rng.uniform(-2.0, 2.0, 2).tolist(), 0.0])
        assert np.all(np.isfinite(found))
        assert 1 <= len(found) <= ITERATIONS + 1


# --- the scene file ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def paper_scene() -> Path:
    return Path(__file__).parents[2] / "scenes" / "paper_planar.yaml"


def test_the_scene_file_holds_the_shown_scene(paper_scene: Path) -> None:
    scene = load_scene(paper_scene)
    assert scene.start is not None
    assert scene.start.joints == {f"joint{k}": angle for k, angle in enumerate(SHOWN.start, start=1)}
    (goal,) = scene.task.goals
    assert isinstance(goal, Pose)
    assert goal.position == (*SHOWN.goal, 0.0)


def test_the_planner_verifies_the_scene_of_the_paper(planar4: Robot, paper_scene: Path) -> None:
    found = plan(planar4, load_scene(paper_scene))
    assert found.verdict == "verified"
    from_point = [proven.distance for proven in found.certificate.clearances if proven.obstacle == "point"]
    assert from_point
    assert min(from_point) >= 0.3


def test_the_method_paper_runs_all_iterations_on_the_scene_of_the_paper(planar4: Robot, paper_scene: Path) -> None:
    """As above with all terms: centre lines stay 0.499 m away, and links and point are 0.04 and 0.01 m thick."""
    found = plan(planar4, load_scene(paper_scene), method="paper")
    assert (found.method, found.verdict) == ("paper", "verified"), found.message
    assert found.findings.iterations == ITERATIONS
    from_point = [proven.distance for proven in found.certificate.clearances if proven.obstacle == "point"]
    assert min(from_point) >= 0.499 - 0.04 * np.sqrt(2.0) - 0.01


def test_without_the_obstacle_term_the_method_paper_is_refuted_at_the_point(planar4: Robot, paper_scene: Path) -> None:
    """As above without terms: the tip arrives, but a centre line passes the point within 0.06 m."""
    content = load_scene(paper_scene).to_dict() | {"gains": {"s_e": 0.2}}
    found = plan(planar4, scene_from_dict(content), method="paper")
    assert found.verdict == "failed"
    assert found.certificate.tracking.done
    assert found.certificate.min_clearance is not None
    assert found.certificate.min_clearance.obstacle == "point"
    assert found.certificate.min_clearance.distance < 0.06
