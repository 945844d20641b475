"""The soil's force from the equilibrium of a wedge: known earth pressures, and the package's equation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Vector
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.site import GroundContact, Soil, SoilReaction
from validation.raw_soil import blade_force, soil_torques
from validation.raw_urdf import read_raw_urdf

SOILS: list[dict[str, Any]] = [
    {},
    {"cohesion": 0.0, "adhesion": 2000.0, "friction": 0.3, "surcharge": 3000.0, "tool_friction": 0.5, "surface": 0.4},
    {"cohesion": 30000.0, "friction": 0.7, "width": 0.9},
]


class Slope:
    """Ground that rises with x and falls with y, with a load on it, and a bucket that holds more the lower it is."""

    held_at = np.array([0.4, 0.05, -0.2])

    def contact(self, tip_position: Array) -> GroundContact:
        x, y, z = np.moveaxis(np.asarray(tip_position), -1, 0)
        gradient = np.broadcast_to([0.15, -0.1], (*x.shape, 2))
        return GroundContact(0.3 + 0.15 * x - 0.1 * y - z, gradient, np.full(x.shape, 1500.0), 40.0 + 10.0 * np.abs(z))


@pytest.mark.parametrize("cohesion", [0.0, 4000.0])
def test_a_smooth_upright_blade_meets_the_passive_pressure_of_rankine(cohesion: float) -> None:
    """F = w (g rho d^2 K / 2 + 2 c d sqrt K) with K = tan^2(pi / 4 + phi / 2); Rankine (1857), Bell (1915)."""
    soil = Soil(density=1800.0, cohesion=cohesion, friction=0.5, tool_friction=0.0)
    K = math.tan(0.25 * math.pi + 0.25) ** 2
    depth = np.array([0.1, 0.4])
    expected = 0.6 * (0.5 * 9.81 * 1800.0 * depth**2 * K + 2.0 * cohesion * depth * math.sqrt(K))
    found = blade_force(depth, np.full(2, 0.5 * math.pi), soil, width=0.6)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def moments(robot: bp.Robot) -> tuple[Array, Array]:
    rng = np.random.default_rng(8)
    q = np.array([robot.random_q(rng) for _ in range(80)])
    return q, 0.3 * rng.normal(size=q.shape)


def compared(problem: Problem, expected: Callable[[Array, Array], Array]) -> None:
    robot = problem.robot
    machine = read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)
    q, v = moments(robot)
    wanted = -expected(q, v)
    assert np.count_nonzero(np.abs(wanted).max(axis=1)) > 20
    np.testing.assert_allclose(soil_torques(machine, problem, q, v), wanted, atol=1e-8 * float(np.abs(wanted).max()))


def dug(robot: bp.Robot, soil: dict[str, Any], **keys: Any) -> Problem:
    middle: Vector = robot.middle
    at = {"joints": dict(zip(robot.joint_names, middle.tolist(), strict=True))}
    return build_problem(
        robot, bp.scene_from_dict({"version": 1, "start": at, "task": {"goal": at}, "soil": soil} | keys)
    )


@pytest.mark.parametrize("soil", SOILS)
def test_torques_are_those_of_the_earthmoving_equation(backhoe: bp.Robot, soil: dict[str, Any]) -> None:
    problem = dug(backhoe, soil, base={"position": [1.0, -2.0], "heading": 0.7})
    assert problem.scene.soil is not None
    compared(problem, SoilReaction(problem.robot, problem.scene.soil).torques)


@pytest.mark.parametrize("soil", SOILS)
def test_ground_that_slopes_and_a_bucket_that_fills_count(backhoe: bp.Robot, soil: dict[str, Any]) -> None:
    problem = dataclasses.replace(dug(backhoe, soil), ground=Slope())
    assert problem.scene.soil is not None
    compared(problem, SoilReaction(problem.robot, problem.scene.soil, Slope()).torques)
