"""Steps that keep a cone to first order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Keep, build_problem
from backhoe_planner.planning.search.first_order import FirstOrder

Data = dict[str, Any]

CONES: list[Data] = [
    {"tilt": {"axis": [0, 0.1, -1], "direction": [0.1, 0, 1], "tolerance": 0.05}},
    {"rotation": {"rpy": [3.0, 0.1, 0.4], "tolerance": 0.05}},
]


def keep_of(robot: bp.Robot, keep: Data) -> Keep:
    start = dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start}, "keep": keep}}
    found = build_problem(robot, bp.scene_from_dict(content)).keep
    assert found is not None
    return found


def within(robot: bp.Robot, keep: Keep, count: int) -> list[Any]:
    """Random configurations at the edge of a cone."""
    rng, limits = np.random.default_rng(3), robot.limits
    tried = (keep.project(robot.random_q(rng), limits.lower, limits.upper) for _ in range(10 * count))
    return [q for q in tried if q is not None][:count]


@pytest.mark.parametrize("kept", CONES)
def test_a_step_along_the_edge_of_a_cone_leaves_it_unless_all_facets_are_kept(panda: bp.Robot, kept: Data) -> None:
    """Beyond the corners of the facets, the steps that keep these miss a cone by half of their square at most.

    The corners of an octagon are 1.083 radii from its middle, those of a cube 1.733.
    """
    keep = keep_of(panda, kept)
    rng, left = np.random.default_rng(1), 0
    for q in within(panda, keep, 20):
        step = 0.02 * rng.choice([-1.0, 1.0], panda.n)
        turned = FirstOrder.at(keep, q).kept_by(step)
        left += not keep.holds(q + step)
        corner = (1.083 if "tilt" in kept else 1.733) * 0.05
        bent = 0.5 * float(np.sum(np.abs(turned))) ** 2
        assert float(np.min(keep.margins(q + turned))) > 0.05 - corner - bent
    assert left > 5
