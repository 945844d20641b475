"""Motions that begin or end nearer to something than a descent keeps elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from backhoe_planner.planning.descent.tight_ends import TightEnds

NEAR_WALL, AWAY = [0.0, 0.0, 0.0, 0.0], [1.8, 0.3, -0.4, 0.3]
GAP = 0.0002  # m beyond the clearance


def site(
    robot: bp.Robot, wall: float, *, start: list[float] = NEAR_WALL, end: list[float] = AWAY, **keys: Any
) -> bp.Scene:
    """The planar arm, stretched along x, with a wall at y = -`wall` [m], and a ball around which it must go."""
    names = robot.joint_names
    content: dict[str, Any] = {
        "version": 1, "clearance": 0.02,
        "start": {"joints": dict(zip(names, start, strict=True))},
        "task": {"goal": {"joints": dict(zip(names, end, strict=True))}},
        "obstacles": [
            {"name": "wall", "shape": "halfspace", "point": [0.0, -wall, 0.0], "normal": [0.0, 1.0, 0.0],
             "links": ["link2", "link3", "link4"]},
            {"name": "ball", "shape": "sphere", "radius": 0.4, "position": [2.0, 2.6, 0.0]},
        ],
    }  # fmt: skip
    return bp.scene_from_dict(content | keys)


def touching(robot: bp.Robot) -> float:
    """How far the wall is from the x axis [m] if the stretched arm is `GAP` beyond the clearance from it."""
    proximity = bp.Proximity(robot, build_problem(robot, site(robot, 0.3)).obstacles)
    found = proximity.tightest(np.array(NEAR_WALL))
    assert found is not None
    assert found.name == "wall"
    return 0.3 - found.margin + GAP


def test_the_spare_grows_with_the_way_from_a_tight_end(planar4: bp.Robot) -> None:
    """Half of the 0.2 mm at the end, then 1 mm for each centimetre that the link may have moved, up to 3 mm."""
    proximity = bp.Proximity(planar4, build_problem(planar4, site(planar4, touching(planar4))).obstacles)
    end = np.array(NEAR_WALL)
    at_end = proximity.tightest(end)
    assert at_end is not None
    pairs = np.arange(len(proximity.pairs))
    tight = TightEnds(proximity, [end], spare=0.003, time=0.0)
    assert tight
    least = tight.spares(end, pairs)
    assert np.min(least) == pytest.approx(0.5 * GAP, abs=1e-6)
    first = pairs[least < 0.003]
    turned = np.array([0.002, 0.0, 0.0, 0.0])
    way = proximity.travel[first] @ turned
    np.testing.assert_allclose(tight.spares(turned, first), np.minimum(least[first] + 0.1 * way, 0.003))
    assert np.all(tight.spares(np.array([0.5, 0.0, 0.0, 0.0]), pairs) == 0.003)
    assert not TightEnds(proximity, [np.array(AWAY)], spare=0.003, time=0.0)


# times what the motion costs without the wall; the rest is what quick searches differ by
@pytest.mark.parametrize("leaves", [True, False], ids=["start", "end"])
@pytest.mark.parametrize(
    ("objective", "most"), [("time", 1.3), pytest.param("effort", 4.0, marks=pytest.mark.long), ("work", 2.0)]
)
def test_a_wall_that_a_motion_leaves_at_once_costs_little(
    planar4: bp.Robot, objective: str, most: float, leaves: bool
) -> None:
    """The arm stands 0.2 mm beyond the clearance from the wall, and swings away from it or towards it."""
    ends = {"start": NEAR_WALL, "end": AWAY} if leaves else {"start": AWAY, "end": NEAR_WALL}
    near, far = (
        bp.plan(planar4, site(planar4, wall, objective=objective, **ends), effort="quick")
        for wall in (touching(planar4), 1.0)
    )
    assert near.verified, near.message
    assert far.verified, far.message
    assert 0.0 <= min(one.margin for one in near.certificate.clearances if one.name == "wall") <= GAP + 1e-6
    assert near.metrics.cost is not None
    assert far.metrics.cost is not None
    assert near.metrics.cost.value <= most * far.metrics.cost.value
