"""The problems at a table, a shelf and a cage have their promised properties."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from validation.free_space import margins
from validation.habitats import load_machine
from validation.sites import SPARE, Site, SiteKey
from validation.tabletop import KINDS, tabletop_problem


@cache
def drawn(kind: str, index: int) -> Site:
    return tabletop_problem(load_machine("panda"), SiteKey("panda", kind, "goal", index))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.long
def test_a_problem_depends_only_on_its_name(kind: str) -> None:
    again = tabletop_problem(load_machine("panda"), drawn(kind, 2).key)
    assert again.scene == drawn(kind, 2).scene
    assert again.scene != drawn(kind, 5).scene


@pytest.mark.parametrize("kind", KINDS)
def test_start_and_goal_are_free_with_a_centimetre_to_spare_and_apart(kind: str) -> None:
    site = drawn(kind, 2)
    problem = build_problem(load_machine("panda"), site.scene)
    proximity = bp.Proximity(problem.robot, problem.obstacles)
    kinematics = bp.Kinematics(problem.robot)
    assert site.start_q is not None
    for q in (site.start_q, site.goal_q):
        assert np.min(margins(proximity, q)) >= SPARE
        assert np.all((q >= problem.limits.lower) & (q <= problem.limits.upper))
    start, goal = (kinematics.at(q).tip_position for q in (site.start_q, site.goal_q))
    assert np.linalg.norm(goal - start) >= 0.3
    assert site.scene.task.model_dump()["goal"]["position"] == pytest.approx(goal.tolist())


def test_a_shelf_board_crosses_the_straight_path_and_cage_tips_are_outside_the_bars() -> None:
    robot = load_machine("panda")
    # a point that moves straight from start to goal passes through a board of the shelf
    shelf = drawn("shelf", 2)
    kinematics = bp.Kinematics(robot)
    assert shelf.start_q is not None
    a, b = (kinematics.at(q).tip_position for q in (shelf.start_q, shelf.goal_q))
    assert len(shelf.scene.obstacles) == 7
    inside = 0
    for part in np.linspace(0.0, 1.0, 400):
        point = (1.0 - part) * a + part * b
        for spec in shelf.scene.obstacles:
            content = spec.model_dump()
            turn, local = content["rpy"][2], point - content["position"]
            c, s = np.cos(turn), np.sin(turn)
            local = np.array([c * local[0] + s * local[1], -s * local[0] + c * local[1], local[2]])
            inside += bool(np.all(np.abs(local) <= 0.5 * np.array(content["size"])))
    assert inside > 0
    # the tips of a cage are outside its bars, which are on a circle around the arm
    cage = drawn("cage", 2)
    bars = [spec.model_dump(by_alias=True) for spec in cage.scene.obstacles]
    radius = float(np.linalg.norm(bars[0]["from"][:2]))
    assert cage.start_q is not None
    for q in (cage.start_q, cage.goal_q):
        assert np.linalg.norm(kinematics.at(q).tip_position[:2]) > radius
