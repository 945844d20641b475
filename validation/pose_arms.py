"""Redundant arms for paths of full poses, written as URDF text: dimensions as published, shapes simplified.

    gen3       seven joints, every other one continuous (as the Kinova Gen3)
    iiwa       seven joints with limits (as the KUKA LBR iiwa 14)
    lift       seven joints with limits (as the Franka Panda) on a lift

Every link is a cylinder from its joint to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Vector

_H = np.pi / 2.0


@dataclass(frozen=True)
class _Joint:
    """A joint, and the shape of the link behind it.

    Attributes
    ----------
    xyz, rpy: its placement on the previous link [m], [rad]; it turns about, or slides along, its own z.
    limits: [rad or m]; None if it is continuous.
    rate: [rad/s or m/s].
    shape: the ends of the link's cylinder [m]; None for no shape.
    radius: of the cylinder [m].
    kind: ``revolute`` or ``prismatic``; ignored if it is continuous.
    """

    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    limits: tuple[float, float] | None
    rate: float
    shape: tuple[tuple[float, float, float], tuple[float, float, float]] | None
    radius: float = 0.055
    kind: str = "revolute"


_O = (0.0, 0.0, 0.0)
_GEN3 = (
    _Joint((0, 0, 0.15643), (np.pi, 0, 0), None, 1.39, (_O, (0, 0, -0.12838)), 0.045),
    _Joint((0, 0.005375, -0.12838), (_H, 0, 0), (-2.41, 2.41), 1.39, (_O, (0, -0.21038, 0)), 0.045),
    _Joint((0, -0.21038, -0.006375), (-_H, 0, 0), None, 1.39, (_O, (0, 0, -0.21038)), 0.045),
    _Joint((0, 0.006375, -0.21038), (_H, 0, 0), (-2.66, 2.66), 1.39, (_O, (0, -0.20843, 0)), 0.045),
    _Joint((0, -0.20843, -0.006375), (-_H, 0, 0), None, 1.22, (_O, (0, 0, -0.10593)), 0.04),
    _Joint((0, 0.000175, -0.10593), (_H, 0, 0), (-2.23, 2.23), 1.22, (_O, (0, -0.10593, 0)), 0.04),
    _Joint((0, -0.10593, -0.000175), (-_H, 0, 0), None, 1.22, (_O, (0, 0, -0.05)), 0.04),
)
_IIWA = (
    _Joint((0, 0, 0.1575), (0, 0, 0), (-2.967, 2.967), 1.48, (_O, (0, 0, 0.2025)), 0.07),
    _Joint((0, 0, 0.2025), (_H, 0, np.pi), (-2.094, 2.094), 1.48, (_O, (0, 0.2045, 0)), 0.07),
    _Joint((0, 0.2045, 0), (_H, 0, np.pi), (-2.967, 2.967), 1.74, (_O, (0, 0, 0.2155)), 0.06),
    _Joint((0, 0, 0.2155), (_H, 0, 0), (-2.094, 2.094), 1.31, (_O, (0, 0.1845, 0)), 0.06),
    _Joint((0, 0.1845, 0), (-_H, np.pi, 0), (-2.967, 2.967), 2.27, (_O, (0, 0, 0.2155)), 0.055),
    _Joint((0, 0, 0.2155), (_H, 0, 0), (-2.094, 2.094), 2.35, (_O, (0, 0.081, 0)), 0.055),
    _Joint((0, 0.081, 0), (-_H, np.pi, 0), (-3.054, 3.054), 2.35, (_O, (0, 0, 0.045)), 0.04),
)
_LIFT = (
    _Joint((0, 0, 0.1), (0, 0, 0), (0.0, 0.5), 0.3, ((0, 0, -0.05), (0, 0, 0.1)), 0.08, "prismatic"),
    _Joint((0, 0, 0.333), (0, 0, 0), (-2.897, 2.897), 2.17, ((0, 0, -0.18), _O), 0.06),
    _Joint(_O, (-_H, 0, 0), (-1.763, 1.763), 2.17, (_O, (0, -0.2, 0)), 0.06),
    _Joint((0, -0.316, 0), (_H, 0, 0), (-2.897, 2.897), 2.17, ((0, 0, -0.1), (0.0825, 0, 0)), 0.055),
    _Joint((0.0825, 0, 0), (_H, 0, 0), (-3.072, -0.07), 2.17, (_O, (-0.0825, 0.2, 0)), 0.055),
    _Joint((-0.0825, 0.384, 0), (-_H, 0, 0), (-2.897, 2.897), 2.61, ((0, 0, -0.17), _O), 0.05),
    _Joint(_O, (_H, 0, 0), (-0.017, 3.752), 2.61, (_O, (0.088, 0, 0)), 0.045),
    _Joint((0.088, 0, 0), (_H, 0, 0), (-2.897, 2.897), 2.61, (_O, (0, 0, 0.09)), 0.04),
)
_ENDS = {"gen3": ((0.0, 0.0, -0.0615), (np.pi, 0.0, 0.0)), "iiwa": ((0, 0, 0.045), _O), "lift": ((0, 0, 0.107), _O)}
_JOINTS: dict[str, Sequence[_Joint]] = {"gen3": _GEN3, "iiwa": _IIWA, "lift": _LIFT}

ARMS = tuple(_JOINTS)


def write_arm(name: str, folder: Path) -> Path:
    """Write one of `ARMS` into a folder and return the file of its URDF. Its tip is the link ``tip``."""
    parts = [_link("base", (_O, (0.0, 0.0, 0.1)), 0.08)]
    before = "base"
    for number, joint in enumerate(_JOINTS[name], 1):
        link = f"link{number}"
        kind = joint.kind if joint.limits is not None else "continuous"
        ends = "" if joint.limits is None else f' lower="{joint.limits[0]}" upper="{joint.limits[1]}"'
        inner = f'<axis xyz="0 0 1"/><limit velocity="{joint.rate}" effort="300"{ends}/>'
        parts += [
            _link(link, joint.shape, joint.radius),
            _joint(f"joint{number}", kind, before, link, joint.xyz, joint.rpy, inner),
        ]
        before = link
    parts += [_link("tip", None, 0.0), _joint("to_tip", "fixed", before, "tip", *_ENDS[name], "")]
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">' + "".join(parts) + "</robot>\n")
    return path


def _link(name: str, shape: tuple[Sequence[float], Sequence[float]] | None, radius: float) -> str:
    inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    return (
        f'<link name="{name}"><inertial><mass value="2"/>{inertia}</inertial>'
        + ("" if shape is None else _cylinder(np.asarray(shape[0], float), np.asarray(shape[1], float), radius))
        + "</link>"
    )


def _cylinder(a: Vector, b: Vector, radius: float) -> str:
    along = (b - a) / np.linalg.norm(b - a)
    rpy = (0.0, float(np.arccos(along[2])), float(np.arctan2(along[1], along[0])))
    return (
        f'<collision>{_origin(0.5 * (a + b), rpy)}<geometry><cylinder radius="{radius}" '
        f'length="{float(np.linalg.norm(b - a)):.5f}"/></geometry></collision>'
    )


def _joint(
    name: str, kind: str, parent: str, child: str, xyz: Sequence[float], rpy: Sequence[float], inner: str
) -> str:
    return (
        f'<joint name="{name}" type="{kind}">{_origin(xyz, rpy)}'
        f'<parent link="{parent}"/><child link="{child}"/>{inner}</joint>'
    )


def _origin(xyz: Sequence[float] | Vector, rpy: Sequence[float]) -> str:
    return f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'


def _text(values: Sequence[float] | Vector) -> str:
    return " ".join(f"{value:.9f}" for value in values)
