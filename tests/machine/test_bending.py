"""How far points deviate from the chord of a motion: known cases, and random chains of hinges and slides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Robot, bend_weights, load_robot, tip_travel_bound

CHAINS = ["HS", "SH", "HSH", "HHS", "SHS", "HSHS", "HHSHS", "SSHH"]  # hinges and slides, from the base


def chain(kinds: str, rng: np.random.Generator, file: Path) -> Robot:
    """An arm with random axes, offsets and ranges."""
    parts = ['<robot name="chain"><link name="link0"/>']
    for j, kind in enumerate(kinds, start=1):
        offset, turn, axis = rng.normal(size=3) * rng.choice([0.0, 0.05, 0.5]), rng.normal(size=3), rng.normal(size=3)
        low, high = (-2.0, 2.0) if kind == "H" else sorted(rng.uniform(-1.0, 1.0, 2))
        parts.append(
            f'<link name="link{j}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
            f'<joint name="joint{j}" type="{"revolute" if kind == "H" else "prismatic"}">'
            f'<parent link="link{j - 1}"/><child link="link{j}"/><axis xyz="{" ".join(map(str, axis))}"/>'
            f'<origin xyz="{" ".join(map(str, offset))}" rpy="{" ".join(map(str, turn))}"/>'
            f'<limit lower="{low}" upper="{high}" velocity="1" effort="1"/></joint>'
        )
    tip = rng.normal(size=3) * rng.choice([0.0, 0.1, 0.5])
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="link{len(kinds)}"/><child link="tip"/>'
        f'<origin xyz="{" ".join(map(str, tip))}"/></joint></robot>'
    )
    file.write_text("".join(parts))
    return load_robot(file)


def off_chord(robot: Robot, begin: Vector, end: Vector) -> float:
    """The tip's greatest distance from its position in straight, uniform motion [m]."""
    data = robot.model.createData()
    parts = np.linspace(0.0, 1.0, 65)
    places = []
    for part in parts:
        pin.forwardKinematics(robot.model, data, begin + part * (end - begin))
        places.append(pin.updateFramePlacement(robot.model, data, robot.tip_frame).translation.copy())
    straight = places[0] + parts[:, None] * (places[-1] - places[0])
    return float(np.linalg.norm(np.array(places) - straight, axis=1).max())


@pytest.mark.parametrize("kinds", CHAINS)
def test_the_tip_of_a_random_chain_deviates_from_its_chord_by_at_most_the_bound(kinds: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(CHAINS.index(kinds))
    used = []
    for _ in range(3):
        robot = chain(kinds, rng, tmp_path / "chain.urdf")
        reach, turning = tip_travel_bound(robot), np.where(robot.prismatic, 0.0, 1.0)
        for size in (0.02, 0.1, 0.5, 1.0) * 4:
            begin, other = robot.random_q(rng), robot.random_q(rng)
            delta = size * (other - begin)
            bound = float(reach @ bend_weights(delta, turning)) / 8.0
            off = off_chord(robot, begin, begin + delta)
            assert off <= bound + 1e-12
            used.append(off / bound if bound > 0.0 else 0.0)
    assert max(used) > 0.15, "the bound is not idle"


def test_a_slide_through_the_axis_of_its_turntable_by_hand() -> None:
    """From 0.1 m before the axis to 0.1 m behind it while the table turns by 1 rad."""
    weights = bend_weights(np.array([1.0, 0.2]), np.array([1.0, 0.0]))
    np.testing.assert_allclose(weights, [1.0, 0.2 * 2.0 * 1.0])  # the table alone; Coriolis, 2 omega v
    # with levers of 0.1 m and 1, 0.5 / 8; halfway the tip is on the axis, 0.1 sin(0.5) from the chord
    assert 0.1 * np.sin(0.5) < float(np.array([0.1, 1.0]) @ weights) / 8.0 == pytest.approx(0.0625)


def test_slides_alone_go_straight_and_a_hinge_bends_by_angle_squared() -> None:
    assert not bend_weights(np.array([0.3, -0.7]), np.zeros(2)).any()
    np.testing.assert_allclose(bend_weights(np.array([[0.5], [-0.5]]), np.ones(1)), [[0.25], [0.25]])
