"""Paths within a tenth of a millimetre: samples as dense as the tolerance needs, and a bound as tight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import backhoe_planner as bp

Data = dict[str, Any]

TOLERANCE = 1e-4  # m
SCENES = Path(__file__).resolve().parents[2] / "scenes"
LINE: list[Data] = [{"position": [0.5, y, 0.4], "rpy": [np.pi, 0.0, 0.0]} for y in (-0.3, 0.3)]
BENT: list[Data] = [
    {"position": [0.5, -0.2, 0.4], "rpy": [np.pi, 0.0, 0.0]},
    {"position": [0.5, 0.2, 0.4], "rpy": [np.pi, 0.0, 0.8]},
    {"position": [0.4, 0.2, 0.5], "rpy": [np.pi, 0.0, 0.8]},
]


def largest_error(plan: bp.Plan) -> float:
    """Distance of the tip from the path at eight moments between any two samples, at most [m]."""
    path, kinematics, q = plan.problem.path, bp.Kinematics(plan.robot), plan.trajectory.q
    assert path is not None
    begin = int(np.searchsorted(plan.trajectory.time, plan.certificate.tracking.approach_time))
    found, low = 0.0, 0.0
    for a, b in zip(q[begin:-1], q[begin + 1 :], strict=True):
        for part in np.linspace(0.0, 1.0, 9):
            tip = kinematics.at((1.0 - part) * a + part * b).tip_position
            low, off = path.nearest(tip, low=low, high=min(low + 0.1, path.length))
            found = max(found, off)
    return found


@pytest.mark.parametrize("waypoints", [pytest.param(LINE, marks=pytest.mark.long), BENT], ids=["line", "bent"])
def test_a_seven_joint_arm_follows_a_path_within_a_tenth_of_a_millimetre(
    panda: bp.Robot, waypoints: list[Data]
) -> None:
    path = {"waypoints": waypoints, "tolerance": TOLERANCE, "detour": False}
    plan = bp.plan(panda, bp.scene_from_dict({"version": 1, "task": {"path": path}}), effort="quick")
    assert plan.verified, plan.message
    assert largest_error(plan) <= plan.certificate.tracking.max_error <= TOLERANCE


@pytest.mark.long
def test_a_backhoe_follows_corners_within_a_tenth_of_a_millimetre(backhoe: bp.Robot) -> None:
    content = yaml.safe_load((SCENES / "trench.yaml").read_text(encoding="utf-8"))
    content["task"]["path"] |= {"tolerance": TOLERANCE, "detour": False}
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert largest_error(plan) <= plan.certificate.tracking.max_error <= TOLERANCE


@pytest.mark.parametrize(
    "tolerance", [1e-4, *(pytest.param(t, marks=pytest.mark.long) for t in (1e-3, 1.2555e-4, 1e-5))]
)
@pytest.mark.parametrize(
    "points",
    [
        [[4.2, 1.0, 0.2], [4.2, 1.0, 0.6], [4.2, 0.5, 0.6]],
        pytest.param(
            [[3.99, -0.319, -0.219], [4.255, 0.376, 0.358], [4.161, -0.397, 0.365], [3.611, 0.008, 0.11]],
            marks=pytest.mark.long,
        ),
    ],
    ids=["a right angle", "sharp corners"],
)
def test_sharp_corners_are_followed_within_the_tolerance_without_obstacles(
    backhoe: bp.Robot, points: list[list[float]], tolerance: float
) -> None:
    """Rounded corners may be shorter than the distance between samples."""
    path = {"waypoints": [{"position": point} for point in points], "tolerance": tolerance, "detour": False}
    start = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
    scene = bp.scene_from_dict({"version": 1, "start": start, "task": {"path": path}})
    plan = bp.plan(backhoe, scene, effort="quick")
    assert plan.verified, plan.message
    assert largest_error(plan) <= plan.certificate.tracking.max_error <= tolerance


@pytest.mark.long
def test_a_motion_is_certified_for_a_tolerance_above_its_error_only(panda: bp.Robot) -> None:
    """With 1.5 times the error of the tip as the tolerance, but not with 0.9 times."""
    path = {"waypoints": LINE, "tolerance": 0.005, "detour": False}
    plan = bp.plan(panda, bp.scene_from_dict({"version": 1, "task": {"path": path}}), effort="quick")
    off = largest_error(plan)
    for tolerance, done in ((1.5 * off, True), (0.9 * off, False)):
        tight = bp.scene_from_dict({"version": 1, "task": {"path": path | {"tolerance": tolerance}}})
        certificate = bp.certify(panda, tight, plan.trajectory)
        assert (certificate.tracking.done and not certificate.detours) is done
