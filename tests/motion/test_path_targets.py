"""The targets of a path at many stations equal those at each of them."""

from __future__ import annotations

import numpy as np
import pytest

from backhoe_planner.machine import TargetBatch
from backhoe_planner.motion import TipPath, targets_along
from backhoe_planner.site import Waypoint

QUARTER = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)


def _path(kind: str) -> TipPath:
    rng = np.random.default_rng(5)
    points = np.cumsum(rng.uniform(0.05, 0.4, (9, 3)), axis=0).tolist()
    rows = []
    for number, point in enumerate(points):
        extra = {}
        if kind == "poses":
            turn = rng.standard_normal(4)
            extra = {"quaternion": (turn / np.linalg.norm(turn)).tolist()}
        elif kind == "some poses" and number % 3:
            extra = {"quaternion": QUARTER}
        elif kind == "pitches" and number % 3:
            low = float(rng.uniform(-3.0, 3.0))
            extra = {"pitch": (low, low + float(rng.uniform(0.0, 1.0)))}
        elif kind == "doubles":
            extra = {"pitch": (0.2 * number, 0.2 * number)}
            rows += [Waypoint(position=tuple(point))] * (number % 2)
        rows.append(Waypoint(position=tuple(point), **extra))
    return TipPath(rows)


@pytest.mark.parametrize("kind", ["positions", "poses", "some poses", "pitches", "doubles"])
def test_targets_together_equal_targets_one_by_one(kind: str) -> None:
    path = _path(kind)
    rng = np.random.default_rng(1)
    s = np.concatenate(([-0.1, path.length + 0.1], path.stations, rng.uniform(0.0, path.length, 60)))
    many, single = targets_along(path, s), TargetBatch.of([path.target(one) for one in s.tolist()])
    for name, values in vars(single).items():
        assert np.asarray(vars(many)[name]) == pytest.approx(np.asarray(values), abs=1e-12), name


def test_the_target_halfway_along_a_quarter_turn_is_turned_by_45_degrees() -> None:
    path = TipPath([Waypoint(position=(0, 0, 0), rpy=(0, 0, 0)), Waypoint(position=(4, 0, 0), rpy=(0, 0, np.pi / 2))])
    found = targets_along(path, np.array([2.0]))
    half = np.sqrt(0.5)
    assert found.rotation[0] == pytest.approx(np.array([[half, -half, 0], [half, half, 0], [0, 0, 1]]), abs=1e-12)
    assert found.position[0] == pytest.approx([2.0, 0.0, 0.0])
