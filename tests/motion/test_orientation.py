"""The bound of the angle error between samples against dense sampling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.motion import TipPath, angle_bounds
from backhoe_planner.site import Waypoint

Data = dict[str, Any]

PITCHES: list[Data] = [{"pitch": [-0.5, 0.2]}, {"pitch": 1.0}, {}, {"pitch": [-3.0, -2.0]}, {}]
ROTATIONS: list[Data] = [{"rpy": [0, 0, 0]}, {"rpy": [0.3, -2, 1]}, {}, {"rpy": [2, 0, 1]}, {"rpy": [2, 0, 1]}]


def path_of(asked: list[Data]) -> TipPath:
    """Legs of 1 m along x."""
    points = [{"position": [float(k), 0.0, 0.0]} | extra for k, extra in enumerate(asked)]
    return TipPath([Waypoint.model_validate(point) for point in points])


def errors(robot: bp.Robot, path: TipPath, q: Vector, station: Vector) -> Vector:
    kinematics = bp.Kinematics(robot)
    found = [path.target(s).distances(kinematics.at(row))[1] for row, s in zip(q, station.tolist(), strict=True)]
    return np.array(found)


@pytest.mark.parametrize(("name", "asked"), [("backhoe", PITCHES), ("planar4", ROTATIONS), ("ur5", ROTATIONS)])
def test_the_bound_of_the_angle_error_is_just_above_dense_sampling(
    name: str, asked: list[Data], request: pytest.FixtureRequest
) -> None:
    robot: bp.Robot = request.getfixturevalue(name)
    rng = np.random.default_rng(3)
    path = path_of(asked)
    for size in (0.05, 0.6, 3.0):
        station = np.array([0.4, 0.9, 0.9, 1.5, 3.6, 3.2])  # forward, at rest, over a waypoint, over two, and back
        q = np.cumsum(np.vstack((robot.random_q(rng), rng.uniform(-size, size, (5, robot.n)))), axis=0)
        angle = errors(robot, path, q, station)
        chosen = np.array([True, True, True, True, True])
        bounds = angle_bounds(path, robot, q=q, station=station, angle=angle, segments=chosen, allowed=np.inf)
        part = np.linspace(0.0, 1.0, 201)[:, None]
        for k, bound in enumerate(bounds.tolist()):
            dense = (1.0 - part) * q[k] + part * q[k + 1]
            places = (1.0 - part[:, 0]) * station[k] + part[:, 0] * station[k + 1]
            most = float(np.max(errors(robot, path, dense, places)))
            spacing = 0.5 * (float(np.sum(np.abs(q[k + 1] - q[k]))) + 2.0 * np.pi) / 200.0
            assert most - 1e-9 <= bound <= most + spacing + 1e-3


def test_only_requested_segments_are_checked(backhoe: bp.Robot) -> None:
    path = path_of(PITCHES)
    q = np.zeros((3, 4))
    angle = errors(backhoe, path, q, np.zeros(3))
    only = np.array([False, True])
    bounds = angle_bounds(path, backhoe, q=q, station=np.zeros(3), angle=angle, segments=only, allowed=np.inf)
    np.testing.assert_allclose(bounds, [0.0, angle[1]])
