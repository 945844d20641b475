"""Boxes of configurations and a goal: no test may rule out a configuration that is on the goal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import TURNING_SLIDE
from scipy.spatial.transform import Rotation

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import build_problem
from backhoe_planner.proof.box_tests import DirectionTest, Quadratic, best_directions, contracted
from backhoe_planner.proof.goal_features import Features, goal_regions
from validation.habitats import load_machine

BOXES = 600
WIDEST = 1.0  # rad or m, half of a box
GOALS = ("position", "joints", "pitch", "pose")


def goal_near(robot: bp.Robot, q: Vector, kind: str, rng: np.random.Generator) -> Any:
    """A goal of that kind that q (n,) misses by nearly as much as the certificate allows: 1 mm, 0.01 rad, 0.001."""
    if kind == "joints":
        off = 0.999e-3 * rng.choice([-1.0, 1.0], robot.n)
        return {"joints": dict(zip(robot.joint_names, (q + off).tolist(), strict=True))}
    at = bp.Kinematics(robot).at(q)
    aside, about = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    goal: dict[str, Any] = {"position": (at.tip_position + 0.999e-3 * aside).tolist()}
    if kind == "pitch":
        goal["pitch"] = at.pitch + 0.00999 * float(rng.choice([-1.0, 1.0]))
    if kind == "pose":
        turned = Rotation.from_rotvec(0.00999 * about).as_matrix() @ at.tip_rotation
        goal["quaternion"] = Rotation.from_matrix(turned).as_quat(scalar_first=True).tolist()
    return goal


def features_around(robot: bp.Robot, q: Vector, goal: Any, half: Matrix, d: Matrix) -> Features:
    """The features over boxes of half widths `half` (B, n) that have q (n,) at `d` (B, n) from their middles."""
    start = dict(zip(robot.joint_names, q.tolist(), strict=True))
    problem = build_problem(
        robot, bp.scene_from_dict({"version": 1, "start": {"joints": start}, "task": {"goal": goal}})
    )
    assert problem.goals[0].shortfall(bp.Kinematics(robot).at(q)) == ""
    (region,) = goal_regions(problem)
    return region.features(q - d - half, q - d + half)


def random_boxes(n: int, rng: np.random.Generator) -> tuple[Matrix, Matrix]:
    """(B, n) half widths from 1 mrad to 1 rad, and (B, n) places in these boxes, half of them at a corner."""
    wide = np.exp(rng.uniform(np.log(1e-3), np.log(WIDEST), (BOXES, 1)))
    half = wide * rng.uniform(0.2, 1.0, (BOXES, n))
    half[: BOXES // 4] *= np.eye(n)[rng.integers(n, size=BOXES // 4)]  # one joint alone
    part = rng.uniform(-1.0, 1.0, (BOXES, n))
    part[::2] = np.sign(part[::2])
    return half, half * part


def assert_never_ruled_out(features: Features, half: Matrix, d: Matrix, rng: np.random.Generator) -> None:
    """Every box contains a configuration on the goal, at d (B, n) from its middle."""
    found = np.einsum("bmn,bn->bm", features.J, d) + 0.5 * np.einsum("bmij,bi,bj->bm", features.H, d, d)
    for group in range(features.slack.shape[1]):
        own = features.group == group
        off = np.linalg.norm((found - features.error)[:, own], axis=1)
        assert np.all(off <= features.slack[:, group] + 1e-12)
    for w in (best_directions(features, -half, half), rng.normal(size=features.error.shape)):
        # a part of the box with the configuration at a corner of it
        low, high = np.where(d > 0.0, -half, d), np.where(d > 0.0, d, half)
        test = DirectionTest(features, w)
        assert not test.misses(-half, half).any()
        assert not test.misses(low, high).any()
    least, most = contracted(*features.tests, half)
    assert np.all(least <= d + 1e-9)
    assert np.all(d <= most + 1e-9)


@pytest.mark.parametrize(
    ("machine", "kind"),
    [
        *((machine, kind) for machine in ("planar4", "backhoe", "panda", "telescope") for kind in GOALS[:2]),
        *((machine, "pitch") for machine in ("backhoe", "telescope")),  # the others have none
        *((machine, "pose") for machine in ("planar4", "panda", "telescope")),
    ],
)
def test_a_box_with_a_configuration_on_the_goal_is_never_ruled_out(machine: str, kind: str) -> None:
    robot, rng = load_machine(machine), np.random.default_rng([1, GOALS.index(kind)])
    for _ in range(3):
        q = robot.random_q(rng)
        half, d = random_boxes(robot.n, rng)
        features = features_around(robot, q, goal_near(robot, q, kind, rng), half, d)
        assert_never_ruled_out(features, half, d, rng)


def test_a_box_of_more_than_a_turn_is_not_ruled_out_by_its_pitch(backhoe: bp.Robot) -> None:
    rng = np.random.default_rng(2)
    q = backhoe.random_q(rng)
    half = np.zeros((BOXES, 4))
    half[:, 1:] = rng.uniform(0.5, 3.0, (BOXES, 3))
    d = half * rng.uniform(-1.0, 1.0, (BOXES, 4))
    assert_never_ruled_out(features_around(backhoe, q, goal_near(backhoe, q, "pitch", rng), half, d), half, d, rng)


@pytest.mark.parametrize("turn", [0.1, 0.5, 1.0, 1.4])
def test_the_remainder_of_a_turn_of_the_stretched_arm_is_that_of_its_taylor_series(
    planar4: bp.Robot, turn: float
) -> None:
    """Four links of 1 m turned by x about the base: x - sin x and cos x - 1 + x^2/2, times 4 m, from 4 x^3 / 6."""
    d = np.array([[turn, 0.0, 0.0, 0.0]])
    end = d[0]
    tip = [4.0 * np.cos(turn), 4.0 * np.sin(turn), 0.0]
    features = features_around(planar4, end, {"position": tip}, np.abs(d), d)
    off = features.error[0] - features.J[0] @ d[0] - 0.5 * np.einsum("mij,i,j->m", features.H[0], d[0], d[0])
    expected = 4.0 * np.array([np.cos(turn) - 1.0 + 0.5 * turn**2, np.sin(turn) - turn, 0.0])
    np.testing.assert_allclose(off, expected, atol=1e-12)
    assert features.slack[0, 0] == pytest.approx(1e-3 + 4.0 * turn**3 / 6.0, abs=1e-8)


@pytest.mark.parametrize(("turn", "slide"), [(0.5, 0.3), (-0.8, 0.1)])
def test_the_remainder_of_a_slide_on_a_hinge_is_that_of_its_taylor_series(
    tmp_path: Path, turn: float, slide: float
) -> None:
    """A tip that slides out of the hinge's axis: s (cos x - 1) and s (sin x - x), from s x^2 / 2 and s x^3 / 6."""
    file = tmp_path / "turning_slide.urdf"
    file.write_text(TURNING_SLIDE)
    robot, d = bp.load_robot(file), np.array([[turn, slide]])
    tip = [slide * np.cos(turn), slide * np.sin(turn), 0.0]
    features = features_around(robot, d[0], {"position": tip}, np.abs(d), d)
    off = features.error[0] - features.J[0] @ d[0] - 0.5 * np.einsum("mij,i,j->m", features.H[0], d[0], d[0])
    np.testing.assert_allclose(off, slide * np.array([np.cos(turn) - 1.0, np.sin(turn) - turn, 0.0]), atol=1e-12)
    rest = slide * abs(turn) ** 2 / 2.0 + slide * abs(turn) ** 3 / 6.0
    assert features.slack[0, 0] == pytest.approx(1e-3 + rest, abs=1e-8)


# --- quadratic forms over boxes ---------------------------------------------------------


def greatest_sampled(g: Vector, h: Array, low: Vector, high: Vector, rng: np.random.Generator) -> float:
    """The greatest of g . d + d^T h d / 2 over a grid of 21 places along each axis, and random places."""
    axes = [np.linspace(a, b, 21) for a, b in zip(low, high, strict=True)]
    places = np.stack([part.ravel() for part in np.meshgrid(*axes)], axis=1)
    places = np.vstack((places, rng.uniform(low, high, (2000, len(low)))))
    return float(np.max(places @ g + 0.5 * np.einsum("pi,ij,pj->p", places, h, places)))


@pytest.mark.parametrize("seed", range(4))
def test_no_value_in_a_box_exceeds_the_greatest_of_a_quadratic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(40):
        g, h = rng.normal(size=3), rng.normal(size=(3, 3))
        h = 0.5 * (h + h.T)
        low, high = np.sort(rng.normal(size=(2, 3)), axis=0)
        most = float(Quadratic(g[None], h[None]).greatest(low[None], high[None])[0])
        assert greatest_sampled(g, h, low, high, rng) <= most + 1e-12


def test_the_greatest_of_a_quadratic_without_products_is_exact() -> None:
    """3 x - x^2 is 2.25 at 1.5; y + y^2 is 2 at 1, and 6 at -3; 2 z is 8 at 4."""
    g, h = np.array([[3.0, 1.0, 2.0]]), np.diag([-2.0, 2.0, 0.0])[None]
    for low, high, most in (
        ([0.0, -1.0, 0.0], [2.0, 1.0, 4.0], 2.25 + 2.0 + 8.0),
        ([2.0, -3.0, -1.0], [3.0, 1.0, 4.0], 2.0 + 6.0 + 8.0),
    ):
        found = Quadratic(g, h).greatest(np.array([low]), np.array([high]))
        assert found[0] == pytest.approx(most, abs=1e-12)


def test_boxes_far_from_the_goal_are_ruled_out_and_near_ones_contracted(planar4: bp.Robot) -> None:
    """A goal given by joints: a box that ends 2 mrad before it misses it, one that contains it shrinks to it."""
    q = np.array([0.2, 0.4, -0.3, 0.1])
    goal = {"joints": dict(zip(planar4.joint_names, q.tolist(), strict=True))}
    half = np.full((2, 4), 0.1)
    d = np.array([[0.102, 0.0, 0.0, 0.0], [0.05, 0.0, 0.02, -0.1]])
    features = features_around(planar4, q, goal, half, d)
    missed = DirectionTest(features, best_directions(features, -half, half)).misses(-half, half)
    assert missed.tolist() == [True, False]
    least, most = contracted(*features.tests, half)
    assert np.all(np.abs(least[1] - np.maximum(d[1] - 1e-3, -0.1)) < 1e-4)
    assert np.all(np.abs(most[1] - np.minimum(d[1] + 1e-3, 0.1)) < 1e-4)
