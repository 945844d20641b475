"""The machine: a Pinocchio model of the joints that move the tip, and its shape.

`load_robot` is the only door. The model holds one number per joint: continuous
joints are angles without limits, and joints that do not move the tip are held still.
A robot does not change after loading.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_array, as_vector
from backhoe_planner.errors import InputError, check_kind, check_path
from backhoe_planner.machine.description.chain_model import chain_model
from backhoe_planner.machine.description.hydraulics_file import description_beside, read_hydraulics
from backhoe_planner.machine.description.link_shapes import LinkPiece, Visual, link_pieces, visuals_of
from backhoe_planner.machine.description.urdf import Urdf, axis_of, read_urdf
from backhoe_planner.machine.hydraulics.hydraulics import Hydraulics

_DEFAULT_VELOCITY = 1.0  # rad/s or m/s, where the URDF gives none; chosen
_FULL_RATE_AFTER = 0.5  # s from rest, where neither URDF nor scene gives an acceleration; chosen
_SEEDS_OF_AXIS = 8  # postures in which the last axis is looked at: one that leaves the level does so in nearly all
_SEEDS_OF_REACH = 64  # postures among which the furthest reach is sought; only its sign counts


@dataclass(frozen=True)
class JointLimits:
    """Limits of every joint, arrays (n,), read-only.

    Attributes
    ----------
    lower, upper: position [rad or m]; infinite for a continuous joint.
    velocity: [rad/s or m/s], symmetric.
    acceleration: [rad/s^2 or m/s^2], symmetric.
    effort: [N m or N], symmetric; infinite where the URDF gives none.
    """

    lower: Vector
    upper: Vector
    velocity: Vector
    acceleration: Vector
    effort: Vector

    def __post_init__(self) -> None:
        n = None
        for field in fields(self):
            array = as_array(getattr(self, field.name), n, key=f"limits.{field.name}", finite=False)
            if field.name not in ("lower", "upper") and (array < 0.0).any():
                raise InputError("is negative", key=f"limits.{field.name}", found=array.tolist(), allowed="0 or more")
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)
            n = len(array)


@dataclass(frozen=True)
class TrackingTube:
    """How far a machine may be off where it is commanded: all motions within the tube of a plan.

    Attributes
    ----------
    joints: (n,) of every joint [rad or m].
    tip: of the tip's position [m]; infinite where only the joints bound it.
    """

    joints: Vector
    tip: float = np.inf


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A machine whose tip is to be moved.

    Attributes
    ----------
    name: the URDF's name.
    urdf: the checked URDF from which it was built.
    tip: the link that is moved.
    tip_frame: its frame index in `model`.
    joint_names: the n joints from the machine outward.
    limits: of these joints.
    model: Pinocchio's model of them (nq = nv = n). Not to be written on.
    pieces: the collision shape of every link.
    visuals: what to draw.
    warnings: what the URDF does not say about its shape, in words.
    hydraulics: cylinders and pump, where the machine has a description of them.
    tube: how far it may be off where it is commanded; None where it is exact.
    """

    name: str
    urdf: Urdf
    tip: str
    tip_frame: int
    joint_names: tuple[str, ...]
    limits: JointLimits
    model: pin.Model
    pieces: tuple[LinkPiece, ...]
    visuals: tuple[Visual, ...]
    warnings: tuple[str, ...] = ()
    hydraulics: Hydraulics | None = None
    tube: TrackingTube | None = None

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, tip={self.tip!r}, joints={self.joint_names})"

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Links with a collision shape, in the order of the URDF."""
        return tuple(dict.fromkeys(piece.link for piece in self.pieces))

    @cached_property
    def moving_links(self) -> tuple[str, ...]:
        """Links with a shape that the joints move, in the order of the URDF."""
        return tuple(dict.fromkeys(piece.link for piece in self.pieces if piece.joint > 0))

    @cached_property
    def all_link_names(self) -> tuple[str, ...]:
        """Every link of the URDF."""
        return tuple(link.name for link in self.urdf.robot.links)

    @cached_property
    def prismatic(self) -> Flags:
        """(n,) which joints slide."""
        return np.array([self.urdf.joints[name].type == "prismatic" for name in self.joint_names])

    @cached_property
    def joint_axes(self) -> Matrix:
        """(n, 3) unit axis of each joint in its own frame."""
        return np.array([axis_of(self.urdf.joints[name]) for name in self.joint_names])

    @cached_property
    def support(self) -> Matrix:
        """(n + 1, n) 1 where a joint (column) moves the body of Pinocchio's joint (row); 0 elsewhere and in row 0."""
        mask = np.zeros((self.n + 1, self.n))
        for joint in range(1, self.n + 1):  # Pinocchio numbers joints from the root outward
            mask[joint] = mask[int(self.model.parents[joint])]
            mask[joint, joint - 1] = 1.0
        return mask

    @cached_property
    def middle(self) -> Vector:
        """(n,) the middle of each joint's range, 0 where there is no range [rad or m]."""
        lower, upper = self._finite_range
        return 0.5 * (lower + upper)

    @cached_property
    def nearest_zero(self) -> Vector:
        """(n,) every joint at 0, or at the limit nearest to it [rad or m]."""
        return np.clip(np.zeros(self.n), self.limits.lower, self.limits.upper)

    @cached_property
    def _finite_range(self) -> tuple[Vector, Vector]:
        """(n,), (n,) the limits of each joint; half a turn either way for continuous joints."""
        limits = self.limits
        return (
            np.where(np.isfinite(limits.lower), limits.lower, -np.pi),
            np.where(np.isfinite(limits.upper), limits.upper, np.pi),
        )

    @cached_property
    def continuous(self) -> Flags:
        """(n,) which joints turn without end: a turn more or less of them is the same configuration."""
        return np.isinf(self.limits.lower) & np.isinf(self.limits.upper)

    def reduce_unchecked(self, q: Array, near: Array | None = None) -> Array:
        """(..., n) positions or changes `q` [rad or m]; continuous joints within half a turn of `near` (0)."""
        if not self.continuous.any():
            return q
        turns = np.round((q if near is None else q - near) / (2.0 * np.pi))
        return np.asarray(q - 2.0 * np.pi * np.where(self.continuous, turns, 0.0))

    @cached_property
    def has_pitch(self) -> bool:
        """Whether the last joint's axis stays horizontal, so that pitch is defined."""
        data = self.model.createData()
        rng = np.random.default_rng(0)
        for _ in range(_SEEDS_OF_AXIS):
            q = self.random_q(rng)
            pin.computeJointJacobians(self.model, data, q)
            axis = data.J.reshape(6, self.n)[3:, -1]  # of one joint alone it is 1-D
            if np.linalg.norm(axis) < 0.5 or abs(axis[2]) > 1e-9:
                return False
        return True

    @cached_property
    def pitch_sense(self) -> float:
        """1 where turning the last joint forward lifts the tip, -1 where it lowers it.

        Forward is the direction in which the tip lies where the arm reaches out furthest,
        of 64 seeded postures. The axis of the last joint may point to either side of the arm.
        """
        data = self.model.createData()
        rng = np.random.default_rng(0)
        furthest, sense = 0.0, 1.0
        for _ in range(_SEEDS_OF_REACH):
            pin.computeJointJacobians(self.model, data, self.random_q(rng))
            tip = pin.updateFramePlacement(self.model, data, self.tip_frame).translation
            out = tip - data.oMi[1].translation
            axis = data.J.reshape(6, self.n)[3:, -1]
            reach = float(out[1] * axis[0] - out[0] * axis[1])
            if abs(reach) > furthest:
                furthest, sense = abs(reach), float(np.sign(reach))
        return sense

    def random_q(self, rng: np.random.Generator) -> Vector:
        """(n,) joint positions drawn evenly within the limits; for continuous joints, half a turn either way."""
        return np.asarray(check_kind(rng, np.random.Generator, key="rng").uniform(*self._finite_range))

    def with_tip(self, tip: str | None) -> Robot:
        """The same machine with another link as its tip; itself if `tip` is None or the same."""
        if tip is None or check_kind(tip, str, key="tip") == self.tip:
            return self
        return _build(self.urdf, tip, None if self.hydraulics is None else self.hydraulics.file)

    def check_q(self, q: object, *, what: str = "q") -> Vector:
        """(n,) a copy of `q`, checked.

        Parameters
        ----------
        q: n finite numbers.
        what: its name, for messages.

        Raises
        ------
        InputError: the length is wrong or a number is not finite.
        """
        return np.array(as_vector(q, self.n, key=what, names=self.joint_names))


def load_robot(
    source: str | os.PathLike[str], *, tip: str | None = None, hydraulics: str | os.PathLike[str] | None = None
) -> Robot:
    """Load a machine from a URDF, and its hydraulic description where it has one.

    Parameters
    ----------
    source: a path, or ``example:NAME``.
    tip: the link to be moved; by default ``bucket_tip``, else the only leaf link.
    hydraulics: the description of cylinders and pump; by default ``NAME.hydraulics.yaml``
        beside ``NAME.urdf``, if there is such a file.

    Raises
    ------
    RobotError: see `read_urdf`, `read_hydraulics` and `chain_model`.

    Examples
    --------
    >>> robot = load_robot("example:backhoe")
    >>> robot.joint_names
    ('swing', 'boom', 'stick', 'bucket')
    """
    urdf = read_urdf(source if isinstance(source, str) else check_path(source, key="source"))
    tip = None if tip is None else check_kind(tip, str, key="tip")
    beside = description_beside(urdf.path)
    description = (
        check_path(hydraulics, key="hydraulics") if hydraulics is not None else beside if beside.is_file() else None
    )
    return _build(urdf, tip, description)


def _build(urdf: Urdf, tip: str | None, hydraulics: Path | None) -> Robot:
    tip, model = chain_model(urdf, tip)
    joint_names = tuple(str(name) for name in model.names[1:])
    pieces, warnings = link_pieces(urdf, model)
    return Robot(
        name=str(urdf.robot.name),
        urdf=urdf,
        tip=tip,
        tip_frame=int(model.getFrameId(tip, pin.FrameType.BODY)),
        joint_names=joint_names,
        limits=_limits(urdf, model),
        model=model,
        pieces=pieces,
        visuals=visuals_of(urdf, model),
        warnings=warnings,
        hydraulics=None if hydraulics is None else read_hydraulics(hydraulics, urdf, joint_names),
    )


def _limits(urdf: Urdf, model: pin.Model) -> JointLimits:
    rows = []
    for name in model.names[1:]:
        joint = urdf.joints[name]
        limit = joint.limit
        ends = (-np.inf, np.inf) if joint.type == "continuous" else (limit.lower, limit.upper)
        rate = limit.velocity if limit is not None and limit.velocity else _DEFAULT_VELOCITY
        effort = limit.effort if limit is not None and limit.effort else np.inf
        rows.append((*ends, rate, urdf.acceleration.get(name, rate / _FULL_RATE_AFTER), effort))
    return JointLimits(*np.array(rows, dtype=float).T.copy())
