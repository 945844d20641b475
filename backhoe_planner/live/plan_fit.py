"""The checks that a plan is for the machine and the site of the servo that is to follow it, and did not fail."""

from __future__ import annotations

from typing import Any

import numpy as np

from backhoe_planner.errors import InputError
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.machine import Robot
from backhoe_planner.planning import Plan
from backhoe_planner.site import Scene

_OF_SITE = ("hold", "base", "clearance", "tracking", "limits")  # keys of a scene by which motions are clear or not
_NAMED = ("obstacles", "zones")
_LIMITS = ("lower", "upper", "velocity", "acceleration")
_HINT = "a plan is followed by a servo of its own machine and scene; obstacles that are new go to servo.add"
_SAME = 1e-9  # rad, m, and per s, s^2: limits that differ by less are the same; rounding


def check_fits(plan: Plan, servo: Servo) -> None:
    """Check that a plan is for the servo's machine and scene; tasks, names and starts may differ.

    Raises
    ------
    InputError: it is not; the key names what differs.
    """
    _check_machine(plan, servo.robot)
    ours, theirs = plan.scene, servo.scene
    for key in _OF_SITE:
        _check_same(f"plan.scene.{key}", getattr(ours, key), getattr(theirs, key))
    for key in _NAMED:
        _check_named(f"plan.scene.{key}", getattr(ours, key), getattr(theirs, key))
    _check_files(ours, theirs)
    for key in _LIMITS:
        planned, own = getattr(plan.problem.limits, key), getattr(servo.limits, key)
        if not np.allclose(planned, own, rtol=0.0, atol=_SAME):
            raise _differs(f"plan.robot.limits.{key}", planned.tolist(), own.tolist())


def refuse_failed(plan: Plan, *, allowed: bool) -> None:
    """Refuse a failed plan unless it is `allowed`, and always if it is only the start: that would count as arrived."""
    why = f"{plan.verdict}: {plan.reason}" + (f" ({plan.message})" if plan.message else "")
    if not allowed:
        raise InputError(
            "a plan that failed is not followed", key="plan", found=why, allowed="verified",
            hint="allow_failed=True follows what motion it has",
        )  # fmt: skip
    if len(plan.trajectory) < 2:
        raise InputError("the plan failed and has no motion", key="plan", found=why)


def _check_machine(plan: Plan, robot: Robot) -> None:
    if plan.robot.joint_names != robot.joint_names:
        found, own = ", ".join(plan.robot.joint_names), ", ".join(robot.joint_names)
        raise InputError(
            "is a plan for other joints than the machine's", key="plan.robot", found=found, allowed=own, hint=_HINT
        )
    _check_same("plan.robot.tip", plan.robot.tip, robot.tip)
    planned, own_file = plan.robot.urdf, robot.urdf
    if planned.sha256 != own_file.sha256:
        found, there = (f"{one.path} ({one.sha256[:12]})" for one in (planned, own_file))
        raise _differs("plan.robot.urdf", found, there)


def _check_named(key: str, ours: Any, theirs: Any) -> None:
    """Check obstacles or zones, by their names: their order does not matter."""
    planned, own = ({one.name: one.model_dump(by_alias=True) for one in some} for some in (ours, theirs))
    if planned.keys() != own.keys():
        raise _differs(key, ", ".join(planned) or "none", ", ".join(own) or "none")
    for name, record in planned.items():
        if record.keys() != own[name].keys():
            raise _differs(f"{key}[{name}].shape", record.get("shape"), own[name].get("shape"))
        for part, value in record.items():
            _check_same(f"{key}[{name}].{part}", value, own[name][part])


def _check_files(ours: Scene, theirs: Scene) -> None:
    """Check that obstacles are read from the same files."""
    for one in ours.obstacles:
        file = getattr(one, "file", None)
        if file is not None and (ours.folder / file).resolve() != (theirs.folder / file).resolve():
            raise _differs(f"plan.scene.obstacles[{one.name}].file", str(ours.folder / file), str(theirs.folder / file))


def _check_same(key: str, ours: object, theirs: object) -> None:
    if ours != theirs:
        raise _differs(key, ours, theirs)


def _differs(key: str, ours: object, theirs: object) -> InputError:
    return InputError("is not that of the servo", key=key, found=ours, allowed=f"{theirs}", hint=_HINT)
