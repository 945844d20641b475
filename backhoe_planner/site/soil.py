"""What the ground does to the teeth: the fundamental earthmoving equation.

A blade of width w at depth d pushes a wedge of soil ahead of it, up along a plane of
failure at the angle beta. With gamma = rho g the soil's weight, c its cohesion, q the load
on the ground, c_a the adhesion to the blade, phi and delta the friction angles within the
soil and on the blade, and alpha the rake (0 a blade lying flat, pi/2 upright),

    F = w (gamma d^2 N_gamma + c d N_c + q d N_q + c_a d N_a)
    D = cos(alpha + delta) + sin(alpha + delta) cot(beta + phi)
    N_gamma = (cot alpha + cot beta) / (2 D),           N_q = 2 N_gamma
    N_c = (1 + cot beta cot(beta + phi)) / D
    N_a = (1 - cot alpha cot(beta + phi)) / D

(A. R. Reece, The fundamental equation of earth-moving mechanics, Proc. IMechE 179, 1964;
E. McKyes, Soil Cutting and Tillage, 1985.) The soil fails where it resists least: beta is
the angle that makes F smallest. F lies at the angle delta to the blade's normal; in addition
adhesion c_a w d / sin alpha acts along the blade.

The equation holds for a blade drawn level through level ground, slowly. The soil in the
bucket, its side plates and the ground's slope are left out.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.errors import InputError
from backhoe_planner.machine import GRAVITY, BatchKinematics, ConfigurationBatch, Robot
from backhoe_planner.site.scene_file import Soil

LIP = 0.73  # rad: from the line bucket pin to tip down to the cutting plate; that of models/backhoe.urdf
_FLATTEST = np.radians(10.0)  # rad of rake; chosen: a flatter blade slides rather than cuts
_CREEP = 0.01  # m/s; chosen: the force fades below it, so that it is continuous where the motion turns round
_SHALLOWEST = 1e-9  # m, in place of 0: at depth 0 the terms per depth have no value, and the force is 0
_STEEPEST = 0.9  # part of the rakes at which a wedge can slide up the blade; chosen, since F grows without bound at 1


def blade_force(depth: Array, rake: Array, soil: Soil, *, width: float) -> Array:
    """F of the fundamental earthmoving equation [N], 0 or more; 0 at depth 0 and above the ground.

    Parameters
    ----------
    depth: of the blade's edge below the ground [m].
    rake: alpha [rad]; its shape broadcasts with that of `depth`. It is brought between 10
        degrees and upright: in front of a blade beyond these a body of soil stands still.
    soil: what is cut.
    width: w [m].
    """
    depth, alpha = np.broadcast_arrays(np.maximum(depth, 0.0), _usable(rake, soil))
    return width * depth * _resistance(failure_angle(depth, alpha, soil), depth, alpha, soil)


def failure_angle(depth: Array, rake: Array, soil: Soil) -> Array:
    """The angle beta of the plane of failure [rad] that makes F smallest.

    Parameters
    ----------
    depth, rake, soil: as of `blade_force`.

    As a function of x = 2 beta, F is a quotient of two expressions n0 + n1 cos x +
    n2 sin x, so that dF/dx = 0 reads P sin x + Q cos x + R = 0.
    """
    depth, alpha = np.broadcast_arrays(np.maximum(depth, _SHALLOWEST), _usable(rake, soil))
    phi, delta = soil.friction, _tool_friction(soil)
    K, C, A = _per_depth(depth, soil)
    k, adhesive = 0.5 * K / np.sin(alpha), 0.5 * A / np.sin(alpha)
    turned = alpha + phi
    n0 = k * np.cos(alpha - phi) + C * np.cos(phi) + adhesive * np.sin(turned)
    n1 = -k * np.cos(turned) - adhesive * np.sin(turned)
    n2 = k * np.sin(turned) - adhesive * np.cos(turned)
    d0, d1, d2 = 0.5 * np.cos(turned + delta), -0.5 * np.cos(turned + delta), 0.5 * np.sin(turned + delta)
    P, Q, R = n0 * d1 - n1 * d0, n2 * d0 - n0 * d2, n2 * d1 - n1 * d2
    middle = np.arctan2(P, Q)
    spread = np.arccos(np.clip(-R / np.hypot(P, Q), -1.0, 1.0))
    beta = np.stack((middle + spread, middle - spread)) / 2.0 % np.pi
    with np.errstate(divide="ignore", invalid="ignore"):
        force = _resistance(beta, depth, alpha, soil)
    fails = (beta > 0.0) & (beta + phi + alpha + delta < np.pi) & np.isfinite(force)
    best = np.argmin(np.where(fails, force, np.inf), axis=0)
    return np.asarray(np.take_along_axis(beta, best[None], axis=0)[0])


def soil_force(
    tip_position: Array,
    tip_velocity: Array,
    *,
    pitch: Array,
    forward: Array,
    soil: Soil,
    width: float,
) -> Array:
    """(..., 3) the force of the soil on the teeth [N], world.

    It acts while the teeth are below the ground and the blade's face moves into the soil. It
    never drives the motion (F . v <= 0), and is continuous in all arguments.

    Parameters
    ----------
    tip_position, tip_velocity: (..., 3) [m], [m/s], world.
    pitch: (...) of the line bucket pin to tip [rad].
    forward: (..., 3) horizontal unit vector outward along the arm, world.
    soil: in which the blade moves.
    width: of the blade [m].
    """
    velocity, forward = np.asarray(tip_velocity, dtype=float), np.asarray(forward, dtype=float)
    depth = np.maximum(soil.surface - np.asarray(tip_position, dtype=float)[..., 2], 0.0)
    # the face's normal into the bucket: (faces, -cos) out along the arm and up
    tilt = np.asarray(pitch, dtype=float) - LIP
    faces = np.sin(tilt)
    alpha = _usable(np.arccos(np.clip(-np.cos(tilt), -1.0, 1.0)), soil)
    into = faces * np.sum(velocity * forward, axis=-1)
    acting = np.maximum(into, 0.0) / np.hypot(into, _CREEP)
    F = acting * blade_force(depth, alpha, soil, width=width)
    stuck = acting * soil.adhesion * width * depth
    delta = _tool_friction(soil)
    back = F * np.sin(alpha + delta) + stuck / np.tan(alpha)
    down = F * np.cos(alpha + delta) - stuck
    force = -(back * np.sign(faces))[..., None] * forward - down[..., None] * np.array([0.0, 0.0, 1.0])
    driving = np.maximum(np.sum(force * velocity, axis=-1, keepdims=True), 0.0)
    squared = np.sum(velocity * velocity, axis=-1, keepdims=True)
    return np.asarray(force - driving / np.maximum(squared, 1e-300) * velocity)


class SoilReaction:
    """The soil's force on the teeth of one machine.

    Parameters
    ----------
    robot: the machine, with a bucket as its last link.
    soil: in which its tip moves.

    Raises
    ------
    InputError: pitch is not defined for the machine, or the scene gives no width and the
        machine's last link has no collision shape to measure.
    """

    def __init__(self, robot: Robot, soil: Soil) -> None:
        if not robot.has_pitch:
            problem = "soil acts on a bucket: the axis of the last joint must stay horizontal"
            raise InputError(problem, key="soil", found=robot.name)
        self._soil = soil
        self._width = bucket_width(robot) if soil.width is None else soil.width
        self._kinematics = BatchKinematics(robot)

    def force(self, q: Array, v: Array) -> Array:
        """(..., 3) the force on the tip [N], world, at q, v (..., n)."""
        return self._over(q, v)[0]

    def torques(self, q: Array, v: Array) -> Array:
        """(..., n) J^T F, what the soil does to the joints [N m], at q, v (..., n)."""
        return self._over(q, v)[1]

    def torques_at(self, q: Array, tip_velocity: Array) -> Array:
        """(B, n) J^T F [N m] at q (B, n) while the tip moves with (B, 3) or (3,) [m/s], world."""
        at = self._kinematics.at(q)
        force = self._force(at, np.broadcast_to(tip_velocity, (len(q), 3)))
        return np.asarray(np.einsum("tij,ti->tj", at.position_jacobian(), force))

    def _over(self, q: Array, v: Array) -> tuple[Array, Array]:
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        at = self._kinematics.at(q.reshape(-1, q.shape[-1]))
        J = at.position_jacobian()
        force = self._force(at, np.einsum("tij,tj->ti", J, v.reshape(-1, v.shape[-1])))
        torque = np.einsum("tij,ti->tj", J, force)
        return force.reshape(*q.shape[:-1], 3), torque.reshape(q.shape)

    def _force(self, at: ConfigurationBatch, tip_velocity: Array) -> Array:
        axis = at.pitch_sense * at.axes[:, -1]
        forward = np.column_stack((-axis[:, 1], axis[:, 0], np.zeros(len(at))))
        return soil_force(
            at.tip_position,
            tip_velocity,
            pitch=at.pitch(),
            forward=forward / np.linalg.norm(forward, axis=1, keepdims=True),
            soil=self._soil,
            width=self._width,
        )


def bucket_width(robot: Robot) -> float:
    """The width of the collision shape beyond the last joint, along that joint's axis [m].

    Raises
    ------
    InputError: there is no such shape.
    """
    axis = robot.joint_axes[-1]
    pieces = [piece.piece for piece in robot.pieces if piece.joint == robot.n]
    if not pieces:
        raise InputError("the bucket has no collision shape to measure", key="soil.width", allowed="a width in metres")
    right, left = (max(float(np.max(sign * (p.hull @ axis))) + p.radius for p in pieces) for sign in (1.0, -1.0))
    return right + left


def _resistance(beta: Array, depth: Array, alpha: Array, soil: Soil) -> Array:
    """F / (w d) at any angle of failure [Pa]."""
    phi, delta = soil.friction, _tool_friction(soil)
    K, C, A = _per_depth(depth, soil)
    cot_fail = 1.0 / np.tan(beta + phi)
    D = np.cos(alpha + delta) + np.sin(alpha + delta) * cot_fail
    weight = K * (1.0 / np.tan(alpha) + 1.0 / np.tan(beta))
    cohesion = C * (1.0 + cot_fail / np.tan(beta))
    adhesion = A * (1.0 - cot_fail / np.tan(alpha))
    return np.asarray(np.maximum(weight + cohesion + adhesion, 0.0) / D)


def _per_depth(depth: Array, soil: Soil) -> tuple[Array, float, float]:
    """Weight with surcharge, cohesion and adhesion, each per depth and width [Pa]."""
    return 0.5 * soil.density * GRAVITY * depth + soil.surcharge, soil.cohesion, soil.adhesion


def _tool_friction(soil: Soil) -> float:
    return 2.0 / 3.0 * soil.friction if soil.tool_friction is None else soil.tool_friction


def _usable(rake: Array, soil: Soil) -> Array:
    """The rake [rad], brought to where a wedge can slide up the blade."""
    room = np.pi - soil.friction - _tool_friction(soil)
    steepest = min(0.5 * np.pi, _STEEPEST * room)
    return np.clip(rake, min(_FLATTEST, 0.5 * steepest), steepest)
