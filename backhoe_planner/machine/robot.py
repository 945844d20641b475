"""The machine: a Pinocchio model of the joints that move the tip, and its shape.

`load_robot` is the only way to make one. The model holds one number per joint: continuous
joints are angles without limits, and joints that do not move the tip are held still.
A robot does not change after loading.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import InputError, RobotError, check_kind, check_path
from backhoe_planner.machine.description.base import ORIGIN, Base
from backhoe_planner.machine.description.chain_model import chain_model
from backhoe_planner.machine.description.held_joints import HeldJoint
from backhoe_planner.machine.description.hydraulics_file import description_beside, read_hydraulics
from backhoe_planner.machine.description.link_shapes import (
    LinkPiece,
    LinkSolid,
    Visual,
    link_pieces,
    link_solids,
    visuals_of,
)
from backhoe_planner.machine.description.urdf import Urdf, axis_of, read_urdf
from backhoe_planner.machine.hydraulics.hydraulics import Hydraulics
from backhoe_planner.machine.shape.shapes import Piece, moved

DEFAULT_VELOCITY = 1.0  # rad/s or m/s, if the URDF gives none; chosen
FULL_RATE_AFTER = 0.5  # s from rest, if neither URDF nor scene gives an acceleration; chosen
_INERTIA_ROUNDING = 1e-3  # part of the largest principal moment; chosen: files give few digits
_PARALLEL = 1e-6  # sine of the angle between axes that count as parallel: rounding of a URDF's numbers
_SEEDS_OF_AXIS = 8  # random configurations that test the last axis: one that is not always level tilts in nearly all
_SEEDS_OF_REACH = 64  # random configurations among which the furthest reach is sought; only its sign counts


@dataclass(frozen=True)
class JointLimits:
    """Limits of every joint, arrays (n,), read-only.

    Attributes
    ----------
    lower, upper: position [rad or m]; infinite for a continuous joint.
    velocity: [rad/s or m/s], symmetric.
    acceleration: [rad/s^2 or m/s^2], symmetric.
    effort: [N m or N], symmetric; infinite if the URDF gives none.
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
    """The largest tracking error of a machine: all motions within this tube around a plan are allowed for.

    Attributes
    ----------
    joints: (n,) error of every joint [rad or m].
    tip: error of the tip's position [m]; infinite if only the joints bound it.
    """

    joints: Vector
    tip: float = np.inf


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A machine whose tip is to be moved.

    Attributes
    ----------
    name: the name in the URDF.
    urdf: the checked URDF from which it was built.
    tip: the link that is moved.
    tip_frame: the frame index of the tip in `model`.
    joint_names: the n joints that move the tip, from the machine outward.
    hold: the joints that the caller wants held, and their positions [rad or m].
    held: these and all other joints that do not move, with their positions.
    limits: of the n joints.
    model: Pinocchio's model of the n joints (nq = nv = n). Do not modify it.
    solids: the collision shape of every link, in the frame of the link.
    pieces: the same shapes in the frames of the joints of `model`.
    visuals: what to draw.
    warnings: what the URDF does not say about its shape, in words.
    hydraulics: cylinders and pump, if the machine has a description of them.
    tube: the largest tracking error; None if the machine follows its commands exactly.
    base: placement of the root link in the site.
    carried: the load: its name among the links, and its pieces in the tip's frame; None if there is no load.
    """

    name: str
    urdf: Urdf
    tip: str
    tip_frame: int
    joint_names: tuple[str, ...]
    hold: Mapping[str, float]
    held: tuple[HeldJoint, ...]
    limits: JointLimits
    model: pin.Model
    solids: tuple[LinkSolid, ...]
    pieces: tuple[LinkPiece, ...]
    visuals: tuple[Visual, ...]
    warnings: tuple[str, ...] = ()
    hydraulics: Hydraulics | None = None
    tube: TrackingTube | None = None
    base: Base = ORIGIN
    carried: tuple[str, tuple[Piece, ...]] | None = None

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, tip={self.tip!r}, joints={self.joint_names})"

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The files it was read from: the URDF, its meshes, the description of the hydraulics."""
        return self.urdf.files if self.hydraulics is None else (*self.urdf.files, self.hydraulics.file)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Links with a collision shape, in the order of the URDF."""
        return tuple(dict.fromkeys(piece.link for piece in self.pieces))

    @cached_property
    def moving_links(self) -> tuple[str, ...]:
        """Links with a shape that the joints move, in the order of the URDF."""
        return tuple(dict.fromkeys(piece.link for piece in self.pieces if piece.joint > 0))

    @cached_property
    def fixed_outlines(self) -> tuple[tuple[Matrix, float], ...]:
        """Of each convex part that does not move: (k, 2) x, y of its corners [m], world, and its radius around them."""
        fixed = (one.piece for one in self.pieces if one.joint == 0 and len(one.piece.hull))
        return tuple((np.asarray(one.hull)[:, :2], one.radius) for one in fixed)

    @cached_property
    def all_link_names(self) -> tuple[str, ...]:
        """Every link of the URDF."""
        return tuple(link.name for link in self.urdf.robot.links)

    @cached_property
    def prismatic(self) -> Flags:
        """(n,) which joints slide."""
        return np.array([self.urdf.joints[name].type == "prismatic" for name in self.joint_names])

    @cached_property
    def joint_units(self) -> tuple[str, ...]:
        """The unit of each joint's position: rad, or m for one that slides."""
        return tuple("m" if slides else "rad" for slides in self.prismatic.tolist())

    @cached_property
    def joint_axes(self) -> Matrix:
        """(n, 3) unit axis of each joint in its own frame."""
        return np.array([axis_of(self.urdf.joints[name]) for name in self.joint_names])

    @cached_property
    def without_velocity(self) -> tuple[str, ...]:
        """Moving joints whose velocity limit is missing or 0 in the URDF: `DEFAULT_VELOCITY` is assumed."""
        return tuple(name for name in self.joint_names if not getattr(self.urdf.joints[name].limit, "velocity", None))

    @cached_property
    def without_acceleration(self) -> tuple[str, ...]:
        """Moving joints without an acceleration limit in the URDF: the full rate after `FULL_RATE_AFTER` is assumed."""
        return tuple(name for name in self.joint_names if name not in self.urdf.acceleration)

    @cached_property
    def without_effort(self) -> tuple[str, ...]:
        """Moving joints whose torque or force is limited neither by the URDF nor by a cylinder."""
        driven = () if self.hydraulics is None else self.hydraulics.joint_of.tolist()
        return tuple(
            name
            for j, name in enumerate(self.joint_names)
            if j not in driven and not getattr(self.urdf.joints[name].limit, "effort", None)
        )

    @cached_property
    def soft_limits(self) -> dict[str, tuple[float, float]]:
        """The soft limits (``<safety_controller>``) of moving joints that are narrower than the limits [rad or m]."""
        found = {}
        for name in self.joint_names:
            joint = self.urdf.joints[name]
            soft = joint.safety_controller
            if soft is None or joint.type == "continuous":
                continue
            low = joint.limit.lower if soft.soft_lower_limit is None else max(soft.soft_lower_limit, joint.limit.lower)
            high = joint.limit.upper if soft.soft_upper_limit is None else min(soft.soft_upper_limit, joint.limit.upper)
            if low < high and (low, high) != (joint.limit.lower, joint.limit.upper):
                found[name] = (float(low), float(high))
        return found

    @cached_property
    def support(self) -> Matrix:
        """(n + 1, n) 1 if a joint (column) moves the body of Pinocchio's joint (row), otherwise 0; row 0 is 0."""
        mask = np.zeros((self.n + 1, self.n))
        for joint in range(1, self.n + 1):  # Pinocchio numbers joints from the root outward
            mask[joint] = mask[int(self.model.parents[joint])]
            mask[joint, joint - 1] = 1.0
        return mask

    @cached_property
    def middle(self) -> Vector:
        """(n,) the middle of each joint's range, 0 if it has no range [rad or m]."""
        lower, upper = self.finite_range
        return 0.5 * (lower + upper)

    @cached_property
    def nearest_zero(self) -> Vector:
        """(n,) every joint at 0, or at the limit nearest to it [rad or m]."""
        return np.clip(np.zeros(self.n), self.limits.lower, self.limits.upper)

    @cached_property
    def finite_range(self) -> tuple[Vector, Vector]:
        """(n,), (n,) the limits of each joint; half a turn either way for continuous joints."""
        limits = self.limits
        return (
            np.where(np.isfinite(limits.lower), limits.lower, -np.pi),
            np.where(np.isfinite(limits.upper), limits.upper, np.pi),
        )

    @cached_property
    def continuous(self) -> Flags:
        """(n,) which joints turn without end: one turn more or less is the same configuration."""
        return np.isinf(self.limits.lower) & np.isinf(self.limits.upper)

    def reduce_unchecked(self, q: Array, near: Array | None = None) -> Array:
        """(..., n) `q`, positions or changes [rad or m], with continuous joints within half a turn of `near` (or 0)."""
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
            axis = data.J.reshape(6, self.n)[3:, -1]  # with one joint J is 1-D
            if np.linalg.norm(axis) < 0.5 or abs(axis[2]) > 1e-9:
                return False
        return True

    @cached_property
    def pitch_sense(self) -> float:
        """1 if turning the last joint forward lifts the tip, -1 if it lowers the tip.

        Forward is the direction from the base to the tip where the arm reaches out furthest
        among 64 seeded configurations. The axis of the last joint may point to either side of the arm.
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

    @cached_property
    def pitch_pin(self) -> Vector | None:
        """(3,) the pin from which `Configuration.pitch` is measured, in the frame of the last joint that moves [m].

        None if the pin is that last joint itself. If hinges parallel to it are held between it and the
        tip, such as that of a held bucket, the pin is the outermost of them.
        """
        hinges = {joint.name for joint in self.held if self.urdf.joints[joint.name].type != "prismatic"}
        for joint in reversed(self.urdf.chain(self.tip)):
            if joint.name == self.joint_names[-1]:
                return None
            if joint.name not in hinges:
                continue
            placement = self.model.frames[self.model.getFrameId(joint.name, pin.FrameType.FIXED_JOINT)].placement
            if np.linalg.norm(np.cross(placement.rotation @ axis_of(joint), self.joint_axes[-1])) < _PARALLEL:
                return np.array(placement.translation)
        return None

    @cached_property
    def first_held_at(self) -> float | None:
        """The position at which the first joint between the root and the tip is held [rad or m]; None if it moves."""
        first = next(joint.name for joint in self.urdf.chain(self.tip) if joint.type != "fixed")
        return next((joint.position for joint in self.held if joint.name == first), None)

    def random_q(self, rng: np.random.Generator) -> Vector:
        """(n,) joint positions drawn evenly within the limits; for continuous joints, half a turn either way."""
        return np.asarray(check_kind(rng, np.random.Generator, key="rng").uniform(*self.finite_range))

    def with_tip(self, tip: str | None) -> Robot:
        """The same machine with another link as its tip; itself if `tip` is None or the same."""
        if tip is None or check_kind(tip, str, key="tip") == self.tip:
            return self
        return self._rebuilt(tip, self.hold, self.base)

    def with_hold(self, hold: Mapping[str, float]) -> Robot:
        """The same machine with these joints held, and no other that can move the tip; itself if nothing changes.

        Parameters
        ----------
        hold: any joints of the URDF by name, and their positions [rad or m].

        Raises
        ------
        InputError: see `held_joints`, or no joint is left that moves the tip.
        """
        hold = _checked_hold(hold)
        return self if hold == self.hold else self._rebuilt(self.tip, hold, self.base)

    def with_base(self, base: Base) -> Robot:
        """The same machine at another place; itself if it is already there."""
        return self if check_kind(base, Base, key="base") == self.base else self._rebuilt(self.tip, self.hold, base)

    def pieces_of(self, links: Collection[str] | None) -> tuple[int, ...]:
        """Rows of `pieces` that move and belong to these links, or to any if None; a load belongs to what holds it."""
        moving = [row for row, piece in enumerate(self.pieces) if piece.joint > 0]
        if links is None:
            return tuple(moving)
        links = check_kind(links, Collection, key="links")  # type: ignore[type-abstract]
        load = None if self.carried is None else self.carried[0]
        holding = {piece.joint for piece in self.pieces if piece.link in links}
        return tuple(
            row
            for row in moving
            if self.pieces[row].link in links or (self.pieces[row].link == load and self.pieces[row].joint in holding)
        )

    def carrying(self, name: str, pieces: Iterable[Piece]) -> Robot:
        """The same machine with a load that is fixed to its tip, as a part of its shape.

        Parameters
        ----------
        name: the load's name among the links.
        pieces: convex pieces of the load, at placements T_tip_piece.

        Raises
        ------
        InputError: a link has that name, or the machine already carries something.
        """
        given = check_kind(pieces, Iterable, key="pieces")  # type: ignore[type-abstract]
        pieces = tuple(check_kind(one, Piece, key="pieces") for one in given)
        if check_kind(name, str, key="name") in self.all_link_names:
            raise InputError("is the name of a link", key="name", found=name)
        if self.carried is not None:
            raise InputError("something is carried already", key="name", found=self.carried[0])
        tip = self.model.frames[self.tip_frame]
        placed = tuple(
            LinkPiece(f"{name}/{number}", name, int(tip.parentJoint), moved(piece, tip.placement))
            for number, piece in enumerate(pieces)
        )
        return replace(self, pieces=(*self.pieces, *placed), carried=(name, pieces))

    @cached_property
    def at_origin(self) -> Robot:
        """The same machine with its root link's frame equal to the world's; itself if that is so already."""
        if self.base.is_origin:
            return self
        there = replace(self._unladen._rebuilt(self.tip, self.hold, ORIGIN), limits=self.limits, tube=self.tube)
        return there if self.carried is None else there.carrying(*self.carried)

    @cached_property
    def as_described(self) -> Robot:
        """The same machine with nothing held and the URDF's own limits; itself if that is so already.

        Joints stay held if the machine cannot be built otherwise, because another joint copies one of them.
        """
        if self.carried is not None:
            bare = self._unladen
            return self if bare.as_described is bare else bare.as_described.carrying(*self.carried)
        own = _limits(self.urdf, self.model)
        same = np.array_equal(own.lower, self.limits.lower) and np.array_equal(own.upper, self.limits.upper)
        if same and not self.hold:
            return self
        with contextlib.suppress(RobotError):
            return self._rebuilt(self.tip, {}, self.base)
        return self._rebuilt(self.tip, self.hold, self.base)

    @property
    def _unladen(self) -> Robot:
        """The same machine with nothing carried."""
        return (
            self if self.carried is None else replace(self, pieces=self.pieces[: -len(self.carried[1])], carried=None)
        )

    def _rebuilt(self, tip: str, hold: Mapping[str, float], base: Base) -> Robot:
        if self.carried is not None:
            raise InputError(
                "tip, held joints and base cannot be changed while the machine carries a load", found=self.carried[0]
            )
        hydraulics = None if self.hydraulics is None else self.hydraulics.file
        return _build(self.urdf, tip, hydraulics, solids=self.solids, warnings=self.warnings, hold=hold, base=base)

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
    source: str | os.PathLike[str],
    *,
    tip: str | None = None,
    hold: Mapping[str, float] | None = None,
    hydraulics: str | os.PathLike[str] | None = None,
) -> Robot:
    """Load a machine from a URDF, and its hydraulic description if it has one.

    Parameters
    ----------
    source: a path, or ``example:NAME``.
    tip: the link to be moved; by default ``bucket_tip``, otherwise the only leaf link. It must be given for a machine
        with several, such as the fingers of a gripper; the error lists them.
    hold: joints by name, and their positions [rad or m]. Usually the scene names the joints to hold
        (`hold` in the scene file) and replaces these; this parameter is for a machine that cannot be
        loaded otherwise, because a joint copies one that would move.
    hydraulics: the description of cylinders and pump; by default ``NAME.hydraulics.yaml``
        beside ``NAME.urdf``, if there is such a file.

    Raises
    ------
    RobotError: see `read_urdf`, `read_hydraulics` and `chain_model`; a body that moves has a negative principal
        moment of inertia.
    InputError: see `with_hold`.

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
    solids, warnings = link_solids(urdf)
    return _build(
        urdf, tip, description, solids=solids, warnings=warnings, hold=_checked_hold({} if hold is None else hold)
    )


def _checked_hold(hold: Mapping[str, float]) -> Mapping[str, float]:
    """A copy of `hold` in which every position is a float."""
    given = check_kind(hold, Mapping, key="hold")  # type: ignore[type-abstract]
    return {name: as_number(position, key=f"hold.{name}") for name, position in given.items()}


def _build(
    urdf: Urdf,
    tip: str | None,
    hydraulics: Path | None,
    *,
    solids: tuple[LinkSolid, ...],
    warnings: tuple[str, ...],
    hold: Mapping[str, float],
    base: Base = ORIGIN,
) -> Robot:
    chain = chain_model(urdf, tip, hold, base)
    model = chain.model
    _check_inertias(urdf, model)
    joint_names = tuple(str(name) for name in model.names[1:])
    return Robot(
        name=str(urdf.robot.name),
        urdf=urdf,
        tip=chain.tip,
        tip_frame=int(model.getFrameId(chain.tip, pin.FrameType.BODY)),
        joint_names=joint_names,
        hold=hold,
        held=chain.held,
        limits=_limits(urdf, model),
        model=model,
        solids=solids,
        pieces=link_pieces(solids, model),
        visuals=visuals_of(urdf, model),
        warnings=warnings,
        hydraulics=None if hydraulics is None else read_hydraulics(hydraulics, urdf, joint_names),
        base=base,
    )


def _check_inertias(urdf: Urdf, model: pin.Model) -> None:
    """RobotError if a moving body has a negative principal moment: it would turn against the torque on it.

    Links that are fixed to each other count as one body, because in published URDFs small links are often wrong alone.
    """
    for joint in range(1, model.njoints):
        moments = np.linalg.eigvalsh(model.inertias[joint].inertia)
        if moments[0] < -_INERTIA_ROUNDING * np.abs(moments).max():
            raise RobotError(
                "has a negative principal moment of inertia", file=urdf.named,
                key=f"link {urdf.joints[model.names[joint]].child!r} with what is fixed to it",
                found=f"{moments[0]:.4g} kg m^2", allowed="0 or more",
            )  # fmt: skip


def _limits(urdf: Urdf, model: pin.Model) -> JointLimits:
    rows = []
    for name in model.names[1:]:
        joint = urdf.joints[name]
        limit = joint.limit
        ends = (-np.inf, np.inf) if joint.type == "continuous" else (limit.lower, limit.upper)
        rate = limit.velocity if limit is not None and limit.velocity else DEFAULT_VELOCITY
        effort = limit.effort if limit is not None and limit.effort else np.inf
        rows.append((*ends, rate, urdf.acceleration.get(name, rate / FULL_RATE_AFTER), effort))
    return JointLimits(*np.array(rows, dtype=float).T.copy())
