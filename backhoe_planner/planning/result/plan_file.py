"""The plan file: JSON, written whole or not at all, read with every field checked."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from backhoe_planner.errors import InputError, PlanFileError, RobotError
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.machine import load_robot
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning.result.plan import METHODS, Plan
from backhoe_planner.proof import certify
from backhoe_planner.site import Obstruction, Scene, scene_from_dict

__all__ = ["certificate_to_dict", "load_plan", "plan_to_dict", "save_plan"]

FORMAT = "backhoe-planner/plan"
VERSION = 1
_LIMITS = ("position", "velocity", "acceleration", "effort", "hydraulics", "tip_speed")


def save_plan(plan: Plan, path: str | os.PathLike[str]) -> None:
    """Write the plan file, whole or not at all. See `Plan.save`."""
    text = json.dumps(plan_to_dict(plan, relative_to=Path(path).parent), allow_nan=False, separators=(",", ":"))
    with whole_file(path) as stream:
        stream.write(text + "\n")


def plan_to_dict(plan: Plan, *, relative_to: Path | None = None) -> dict[str, Any]:
    """The plan as plain data, in the layout of the plan file.

    Parameters
    ----------
    relative_to: the folder from which files are to be found again; paths are kept
        relative to it where that is possible.
    """
    urdf = plan.robot.urdf
    source = urdf.source if urdf.source.startswith("example:") else _relative(urdf.path, relative_to)
    return {
        "format": FORMAT,
        "version": VERSION,
        "verdict": plan.verdict,
        "reason": plan.reason,
        "message": plan.message,
        "robot": {
            "urdf": source,
            "sha256": urdf.sha256,
            "joints": list(plan.robot.joint_names),
            "tip": plan.robot.tip,
        },
        "scene": plan.scene.to_dict(),
        "scene_folder": _relative(plan.scene.folder, relative_to),
        "method": plan.method,
        "seed": plan.seed,
        "versions": _versions(),
        "trajectory": {
            "time": plan.trajectory.time.tolist(),
            "q": plan.trajectory.q.tolist(),
            "v": plan.trajectory.v.tolist(),
        },
        "dynamics": _dynamics(plan),
        "certificate": certificate_to_dict(plan),
        "metrics": _plain(plan.metrics),
        "details": _plain(plan.details),
    }


def _dynamics(plan: Plan) -> dict[str, Any]:
    """Over the samples of the trajectory: torque [T][n], then power and energy [T]."""
    energy = plan.energy()
    found: dict[str, Any] = {"torque": energy.torque, "power": energy.power, "work": energy.work}
    if energy.hydraulic is not None:
        found |= {"hydraulic_power": energy.hydraulic_power, "hydraulic": energy.hydraulic}
    return {key: _plain(values) for key, values in found.items()}


def certificate_to_dict(plan: Plan) -> dict[str, Any]:
    """The certificate as plain data."""
    certificate = plan.certificate
    tightest = certificate.min_clearance
    tracking = certificate.tracking
    return {
        "min_clearance": None if tightest is None else _clearance(tightest),
        "clearances": [_clearance(clearance) for clearance in certificate.clearances],
        "limits": {kind: asdict(use) for kind in _LIMITS if (use := getattr(certificate, kind)) is not None},
        "tip_error": {"max": tracking.max_error, "mean": tracking.mean_error, "max_angle": tracking.max_angle_error},
        "path": {"length": tracking.path_length, "followed": tracking.followed},
        "detours": [asdict(detour) for detour in tracking.detours],
        "problems": list(certificate.problems),
    }


def _clearance(found: Obstruction) -> dict[str, Any]:
    """As the contract has it: a link of the machine is named ``self: LINK``."""
    obstacle = f"self: {found.obstacle}" if found.kind == "machine" else found.obstacle
    return {
        "value": found.distance, "margin": found.margin, "obstacle": obstacle, "link": found.link, "time": found.time,
    }  # fmt: skip


def load_plan(path: str | os.PathLike[str], *, urdf: str | os.PathLike[str] | None = None) -> Plan:
    """Read a plan file. The certificate is computed anew, not believed.

    Parameters
    ----------
    urdf: where the machine's URDF lies now, if not where the plan says.

    Raises
    ------
    PlanFileError: not a plan file, or damaged; names the key.
    RobotError: the URDF is missing or has changed since the plan was made.
    SceneError: a file that the scene names is missing.
    """
    file = Path(path)
    content = _read(file)
    robot_record = _field(content, "robot", dict, file)
    source = _field(robot_record, "urdf", str, file, "robot.urdf")
    robot = load_robot(
        _locate(source, file) if urdf is None else urdf, tip=_field(robot_record, "tip", str, file, "robot.tip")
    )
    if robot.urdf.sha256 != robot_record.get("sha256"):
        raise RobotError(
            "the URDF is not the one with which the plan was made",
            file=file,
            key="robot.sha256",
            found=f"{robot.urdf.path} has {robot.urdf.sha256[:12]}...",
            allowed=f"{str(robot_record.get('sha256'))[:12]}...",
        )
    joints = _field(robot_record, "joints", list, file, "robot.joints")
    if joints != list(robot.joint_names):
        raise PlanFileError(
            "are not those of the URDF",
            file=file,
            key="robot.joints",
            found=joints,
            allowed=", ".join(robot.joint_names),
        )
    scene = _scene(content, file)
    trajectory = _trajectory(content, file, robot.n)
    method = _field(content, "method", str, file)
    known = (*METHODS, "teleop")
    if method not in known:
        raise PlanFileError("unknown method", file=file, key="method", found=method, allowed=", ".join(known))
    verdict = _field(content, "verdict", str, file)
    if verdict not in ("verified", "failed"):
        raise PlanFileError("unknown verdict", file=file, key="verdict", found=verdict, allowed="verified, failed")
    certificate = certify(robot, scene, trajectory)
    reason = _field(content, "reason", str, file)
    message = _field(content, "message", str, file)
    if verdict == "verified" and not certificate.verified:
        verdict, reason, message = (
            "failed",
            "blocked",
            "the file says verified, but: " + "; ".join(certificate.problems),
        )
    return Plan(
        verdict=verdict,
        reason=reason,
        message=message,
        robot=robot,
        scene=scene,
        method=method,
        seed=_field(content, "seed", int, file),
        trajectory=trajectory,
        certificate=certificate,
        metrics=_field(content, "metrics", dict, file),
        details=content.get("details", {}),
    )


# --- reading ----------------------------------------------------------------------


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PlanFileError("no such plan file", file=file) from None
    except OSError as error:
        raise PlanFileError(f"cannot be read: {error.strerror}", file=file) from error
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"is not a plan file: not JSON: {error}", file=file) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise PlanFileError("is not a plan file", file=file, key="format", found=repr(found), allowed=FORMAT)
    if content.get("version") != VERSION:
        raise PlanFileError(
            "was written in a version that is not known", file=file, key="version", found=content.get("version"),
            allowed=str(VERSION),
        )  # fmt: skip
    return content


def _field(record: Mapping[str, Any], key: str, kind: type, file: Path, name: str | None = None) -> Any:
    value = record.get(key)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise PlanFileError(
            "is missing" if value is None else "is of the wrong kind",
            file=file,
            key=name or key,
            found=None if value is None else type(value).__name__,
            allowed=kind.__name__,
        )
    return value


def _scene(content: Mapping[str, Any], file: Path) -> Scene:
    folder = content.get("scene_folder", ".")
    if not isinstance(folder, str):
        raise PlanFileError("is of the wrong kind", file=file, key="scene_folder", allowed="a folder")
    try:
        return scene_from_dict(_field(content, "scene", dict, file), folder=file.parent / folder)
    except InputError as error:
        raise PlanFileError(str(error), file=file, key="scene") from None


def _trajectory(content: Mapping[str, Any], file: Path, n: int) -> Trajectory:
    record = _field(content, "trajectory", dict, file)
    arrays = {}
    for key in ("time", "q", "v"):
        try:
            arrays[key] = np.array(_field(record, key, list, file, f"trajectory.{key}"), dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise PlanFileError("is not a table of numbers", file=file, key=f"trajectory.{key}") from None
    for key in ("q", "v"):
        if arrays[key].ndim != 2 or arrays[key].shape[1] != n:
            raise PlanFileError(
                "does not fit the machine", file=file, key=f"trajectory.{key}", found=f"shape {arrays[key].shape}",
                allowed=f"(T, {n})",
            )  # fmt: skip
    try:
        return Trajectory(**arrays)
    except InputError as error:
        raise PlanFileError(str(error), file=file) from None


# --- writing ----------------------------------------------------------------------


def _relative(path: Path, folder: Path | None) -> str:
    if folder is None:
        return str(path)
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return str(path.resolve())


def _locate(source: str, file: Path) -> str:
    """A URDF's path as stored: relative to the plan file, or to where we are."""
    if source.startswith("example:"):
        return source
    beside = file.parent / source
    return str(beside) if beside.is_file() else source


def _plain(value: Any) -> Any:
    """Numbers and lists that JSON can hold; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("backhoe_planner", "pin", "coal", "numpy"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found
