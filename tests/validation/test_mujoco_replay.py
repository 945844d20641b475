"""Replays in MuJoCo: no contacts on verified plans, and the expected ones on unsafe motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from validation.mujoco_replay import replay
from validation.random_attacks import TURNS, random_attack, random_attacked

SCENES = Path(__file__).resolve().parents[2] / "scenes"


@pytest.mark.parametrize(("name", "machine"), [("paper_planar", "planar4"), ("yard", "backhoe")])
def test_a_verified_plan_has_no_contacts(name: str, machine: str) -> None:
    plan = bp.plan(bp.load_robot(f"example:{machine}"), bp.load_scene(SCENES / f"{name}.yaml"), effort="quick")
    assert plan.verified
    replayed = replay(plan.robot, plan.scene, plan.trajectory)
    assert replayed.moments == 10 * (len(plan.trajectory) - 1) + 1
    assert replayed.contacts == ()
    assert not replayed.skipped


def test_an_unsafe_motion_has_the_expected_contacts() -> None:
    """A stretched planar arm swings through a post 2.5 m away."""
    robot = bp.load_robot("example:planar4")
    content = {
        "version": 1,
        "start": {"joints": dict.fromkeys(robot.joint_names, 0.0)},
        "task": {"goal": {"position": [0.0, 4.0, 0.0]}},
        "obstacles": [
            {"name": "post", "shape": "cylinder", "radius": 0.1, "length": 1.0, "position": [1.8, 1.8, 0.0]},
            {"name": "later", "shape": "sphere", "radius": 0.1, "position": [2.0, 0.0, 0.0], "appears_at": 2.0},
            {"name": "mover", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [-3, 0.5, 0], "velocity": [1, 0, 0]},
            {"name": "tip's", "shape": "sphere", "radius": 0.1, "position": [0.6, 0.6, 0.0], "links": ["link4"]},
        ],
    }
    q = np.zeros((2, 4))
    q[1, 0] = np.pi / 2.0
    found = replay(robot, bp.scene_from_dict(content), bp.Trajectory.from_steps(np.array([0.0, 3.0]), q), refine=600)
    touched = {(contact.link, contact.other): contact for contact in found.contacts}
    # link3 meets the post, 2.546 m away, and link1 meets the mover near the vertical
    assert set(touched) == {("link3", "post"), ("link1", "mover")}
    # straight through its middle: half of it and half of the link, 0.08 m wide
    assert touched["link3", "post"].depth == pytest.approx(0.14, abs=1e-3)
    assert touched["link3", "post"].time == pytest.approx(1.5, abs=0.06)
    assert touched["link1", "mover"].time > 2.5


@pytest.mark.parametrize("first", [pytest.param(10, marks=pytest.mark.long), 80])
def test_mujoco_and_the_least_distances_agree_on_contacts(first: int, tmp_path: Path) -> None:
    """Random machines and sites with obstacles of every shape: the two methods share only the files."""
    machine = random_attacked(first, tmp_path)
    touching = 0
    for seed in range(first, first + TURNS):
        attack = random_attack(seed, machine, tmp_path)
        contacts = replay(machine.robot, attack.scene, attack.trajectory, refine=20).contacts
        sweep = machine.sweep(attack.trajectory.time, attack.trajectory.q)
        for obstacle in attack.obstacles:
            deepest = max((c.depth for c in contacts if c.other == obstacle.name), default=0.0)
            least = sweep.to_obstacle(obstacle)
            if least is not None and (deepest > 0.0 or least.distance > 1e-4):
                assert (least.distance <= 0.0) == (deepest > 0.0), (seed, obstacle.name, least, deepest)
                touching += deepest > 0.0
    assert touching > 0


def test_held_joints_keep_their_angles() -> None:
    """A planar arm with its second joint held at a right angle has contacts only in that configuration."""
    robot = bp.load_robot("example:planar4").with_hold({"joint2": np.pi / 2.0})
    content = {
        "version": 1,
        "hold": {"joint2": np.pi / 2.0},
        "start": {"joints": dict.fromkeys(robot.joint_names, 0.0)},
        "task": {"goal": {"position": [0.0, 2.0, 0.0]}},
        "obstacles": [
            {"name": "on the bend", "shape": "sphere", "radius": 0.1, "position": [1.0, 1.5, 0.0]},
            {"name": "straight on", "shape": "sphere", "radius": 0.1, "position": [2.0, 0.0, 0.0]},
        ],
    }
    still = bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.zeros((2, 3)))
    found = replay(robot, bp.scene_from_dict(content), still)
    assert {(contact.link, contact.other) for contact in found.contacts} == {("link3", "on the bend")}
    certificate = bp.certify(robot, bp.scene_from_dict(content), still)
    assert {entry.obstacle: entry.distance < 0.0 for entry in certificate.clearances if entry.kind == "obstacle"} == {
        "on the bend": True,
        "straight on": False,
    }
