"""The force of the ground on the teeth: the fundamental earthmoving equation.

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
the angle that makes F smallest. F acts at the angle delta to the blade's normal; in addition
adhesion c_a w d / sin alpha acts along the blade.

If the ground rises by sigma in the direction of the cut, d is measured across the ground and
alpha from it, and the soil's weight leans against the wedge. N_gamma and N_q are then multiplied by

    (cos sigma + sin sigma cot(beta + phi)),

which follows from the equilibrium of the wedge along the normal of the force on its failure plane
(see also O. Luengo, S. Singh, H. Cannon, Modeling and identification of soil-tool interaction in
automated excavation, IROS 1998, whose surcharge is the weight of the soil ahead of the blade).

The equation is valid for a blade drawn slowly along the ground. The side plates are left out.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.errors import InputError
from backhoe_planner.machine import GRAVITY, BatchKinematics, ConfigurationBatch, Robot
from backhoe_planner.site.ground import Ground, GroundContact, LevelGround
from backhoe_planner.site.schema.digging import Soil

LIP = 0.73  # rad: from the line through bucket pin and tip down to the cutting plate; that of models/backhoe.urdf
_FLATTEST = np.radians(10.0)  # rad of rake; chosen: a flatter blade slides rather than cuts
_CREEP = 0.01  # m/s; chosen: the force fades below it, so that it is continuous when the motion reverses
_SHALLOWEST = 1e-9  # m, in place of 0: at depth 0 the terms per depth have no value, and the force is 0
_HOLDS = 0.9  # part of the friction angle; chosen, below 1, where the longest wedge is as easily moved as any
_STEEPEST = 0.9  # part of the rakes at which a wedge can slide up the blade; chosen, since F grows without bound at 1


def blade_force(
    depth: Array, rake: Array, soil: Soil, *, width: float, slope: Array | float = 0.0, surcharge: Array | float = 0.0
) -> Array:
    """F of the fundamental earthmoving equation [N], 0 or more; 0 at depth 0 and above the ground.

    Parameters
    ----------
    depth: of the blade's edge below the ground, across it [m].
    rake: alpha from the ground [rad]; the shapes of all arrays broadcast. It is clipped to between 10
        degrees and upright: in front of a blade beyond these, a body of soil stands still.
    soil: the soil that is cut.
    width: w [m].
    slope: sigma, by which the ground rises in the direction of the cut [rad]. Downhill it counts at most
        as 0.9 of the soil's friction angle: on steeper ground a long enough wedge slides by itself.
    surcharge: load on the ground besides the soil's own [Pa].
    """
    depth, alpha, sigma, load = np.broadcast_arrays(
        np.maximum(depth, 0.0), _usable(rake, soil), _holding_slope(slope, soil), surcharge
    )
    beta = failure_angle(depth, alpha, soil, slope=sigma, surcharge=load)
    return width * depth * _resistance(beta, depth, alpha, soil, sigma, load)


def failure_angle(
    depth: Array, rake: Array, soil: Soil, *, slope: Array | float = 0.0, surcharge: Array | float = 0.0
) -> Array:
    """The angle beta of the plane of failure, from the ground [rad], that makes F smallest.

    Parameters
    ----------
    depth, rake, soil, slope, surcharge: as for `blade_force`.

    As a function of x = 2 beta, F is a quotient of two expressions n0 + n1 cos x +
    n2 sin x, so that dF/dx = 0 becomes P sin x + Q cos x + R = 0.
    """
    depth, alpha, sigma, load = np.broadcast_arrays(
        np.maximum(depth, _SHALLOWEST), _usable(rake, soil), _holding_slope(slope, soil), surcharge
    )
    phi, delta = soil.friction, _tool_friction(soil)
    K, C, A = _per_depth(depth, soil, load)
    k, adhesive = 0.5 * K / np.sin(alpha), 0.5 * A / np.sin(alpha)
    turned = alpha + phi
    n0 = k * np.cos(alpha - phi - sigma) + C * np.cos(phi) + adhesive * np.sin(turned)
    n1 = -k * np.cos(turned + sigma) - adhesive * np.sin(turned)
    n2 = k * np.sin(turned + sigma) - adhesive * np.cos(turned)
    d0, d1, d2 = 0.5 * np.cos(turned + delta), -0.5 * np.cos(turned + delta), 0.5 * np.sin(turned + delta)
    P, Q, R = n0 * d1 - n1 * d0, n2 * d0 - n0 * d2, n2 * d1 - n1 * d2
    middle = np.arctan2(P, Q)
    spread = np.arccos(np.clip(-R / np.hypot(P, Q), -1.0, 1.0))
    beta = np.stack((middle + spread, middle - spread)) / 2.0 % np.pi
    with np.errstate(divide="ignore", invalid="ignore"):
        force = _resistance(beta, depth, alpha, soil, sigma, load)
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
    contact: GroundContact | None = None,
) -> Array:
    """(..., 3) the force of the soil on the teeth [N], world.

    It acts while the teeth are below the ground and move along it. If the blade's back leads, the soil
    resists as if the blade leaned as much the other way. The force never drives the motion (F . v <= 0), and is
    continuous in all arguments.

    Parameters
    ----------
    tip_position, tip_velocity: (..., 3) [m], [m/s], world.
    pitch: (...) of the line from bucket pin to tip [rad].
    forward: (..., 3) horizontal unit vector outward along the arm, world.
    soil: in which the blade moves.
    width: of the blade [m].
    contact: how the teeth are in contact with the ground; by default level ground at the soil's `surface`.
    """
    velocity, forward = np.asarray(tip_velocity, dtype=float), np.asarray(forward, dtype=float)
    if contact is None:
        contact = LevelGround(soil.surface).contact(tip_position)
    # if the back leads, the plate leans as much the other way
    tilt = np.asarray(pitch, dtype=float) - LIP
    rake = np.arccos(np.clip(-np.cos(tilt), -1.0, 1.0))
    along = np.sum(velocity * forward, axis=-1)
    cutting = np.sign(along)[..., None] * forward
    sigma = _slope_along(contact, cutting)
    depth = np.maximum(contact.depth, 0.0) * np.cos(sigma)
    alpha = _usable(rake + sigma, soil)
    # a blade that moves within its own plane slides
    into = np.sin(tilt) * along
    acting = np.abs(into) / np.hypot(into, _CREEP)
    load = 0.0 if contact.surcharge is None else contact.surcharge
    F = acting * blade_force(depth, alpha, soil, width=width, slope=sigma, surcharge=load)
    stuck = acting * soil.adhesion * width * depth
    delta = _tool_friction(soil)
    back = F * np.sin(alpha + delta) + stuck / np.tan(alpha)
    down = F * np.cos(alpha + delta) - stuck
    # along the ground and across it, in the direction of the cut and up
    ahead = -back * np.cos(sigma) + down * np.sin(sigma)
    up = -back * np.sin(sigma) - down * np.cos(sigma)
    force = ahead[..., None] * cutting + up[..., None] * np.array([0.0, 0.0, 1.0])
    driving = np.maximum(np.sum(force * velocity, axis=-1, keepdims=True), 0.0)
    squared = np.sum(velocity * velocity, axis=-1, keepdims=True)
    return np.asarray(force - driving / np.maximum(squared, 1e-300) * velocity)


class SoilReaction:
    """The soil's force on the teeth of one machine.

    Parameters
    ----------
    robot: the machine, with a bucket as its last link.
    soil: in which its tip moves.
    ground: where the soil is; by default level at the soil's `surface`.

    Raises
    ------
    InputError: pitch is not defined for the machine, or the scene gives no width and the
        machine's last link has no collision shape to measure.
    """

    def __init__(self, robot: Robot, soil: Soil, ground: Ground | None = None) -> None:
        if not robot.has_pitch:
            problem = "soil acts on a bucket: the axis of the last joint must stay horizontal"
            raise InputError(problem, key="soil", found=robot.name)
        self._soil = soil
        self._ground = LevelGround(soil.surface) if ground is None else ground
        self._width = bucket_width(robot) if soil.width is None else soil.width
        self._kinematics = BatchKinematics(robot)

    def force(self, q: Array, v: Array) -> Array:
        """(..., 3) the force on the tip [N], world, at q, v (..., n)."""
        return self._over(q, v)[0]

    def torques(self, q: Array, v: Array) -> Array:
        """(..., n) torques of the soil on the joints [N m] at q, v (..., n): J^T F, and the weight of the held soil."""
        return self._over(q, v)[1]

    def torques_at(self, q: Array, tip_velocity: Array) -> Array:
        """(B, n) `torques` [N m] at q (B, n) while the tip moves with (B, 3) or (3,) [m/s], world."""
        at = self._kinematics.at(q)
        return self._forces(at, np.broadcast_to(tip_velocity, (len(q), 3)), at.position_jacobian())[1]

    def _over(self, q: Array, v: Array) -> tuple[Array, Array]:
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        at = self._kinematics.at(q.reshape(-1, q.shape[-1]))
        J = at.position_jacobian()
        force, torque = self._forces(at, np.einsum("tij,tj->ti", J, v.reshape(-1, v.shape[-1])), J)
        return force.reshape(*q.shape[:-1], 3), torque.reshape(q.shape)

    def _forces(self, at: ConfigurationBatch, tip_velocity: Array, J: Array) -> tuple[Array, Array]:
        """(B, 3) the force on the tip [N], world, and (B, n) the torques on the joints [N m]."""
        axis = at.pitch_sense * at.axes[:, -1]
        forward = np.column_stack((-axis[:, 1], axis[:, 0], np.zeros(len(at))))
        contact = self._ground.contact(at.tip_position)
        force = soil_force(
            at.tip_position,
            tip_velocity,
            pitch=at.pitch(),
            forward=forward / np.linalg.norm(forward, axis=1, keepdims=True),
            soil=self._soil,
            width=self._width,
            contact=contact,
        )
        torque = np.einsum("tij,ti->tj", J, force)
        if contact.held is None:
            return force, torque
        return force, torque - (GRAVITY * contact.held)[:, None] * self._lift(at, J)

    def _lift(self, at: ConfigurationBatch, J: Array) -> Array:
        """(B, n) how much each joint lifts the soil in the bucket [m/rad]."""
        if self._ground.held_at is None:
            return np.asarray(J[:, 2])
        offset = at.origins[:, -1] + at.rotations[:, -1] @ self._ground.held_at - at.tip_position
        # a point of the same body moves with the tip's velocity plus omega x offset; only z is needed
        turned = at.rotation_jacobian()
        return np.asarray(J[:, 2] + turned[:, 0] * offset[:, 1, None] - turned[:, 1] * offset[:, 0, None])


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


def _slope_along(contact: GroundContact, cutting: Array) -> Array:
    """(...) the angle by which the ground rises in the direction of the cut (..., 3) [rad]."""
    if contact.gradient is None:
        return np.zeros(np.shape(contact.depth))
    return np.asarray(np.arctan(np.sum(contact.gradient * cutting[..., :2], axis=-1)))


def _resistance(beta: Array, depth: Array, alpha: Array, soil: Soil, sigma: Array, load: Array) -> Array:
    """F / (w d) at any angle of failure [Pa]."""
    phi, delta = soil.friction, _tool_friction(soil)
    K, C, A = _per_depth(depth, soil, load)
    cot_fail = 1.0 / np.tan(beta + phi)
    D = np.cos(alpha + delta) + np.sin(alpha + delta) * cot_fail
    leans = np.cos(sigma) + np.sin(sigma) * cot_fail
    weight = K * (1.0 / np.tan(alpha) + 1.0 / np.tan(beta)) * leans
    cohesion = C * (1.0 + cot_fail / np.tan(beta))
    adhesion = A * (1.0 - cot_fail / np.tan(alpha))
    return np.asarray(np.maximum(weight + cohesion + adhesion, 0.0) / D)


def _per_depth(depth: Array, soil: Soil, load: Array) -> tuple[Array, float, float]:
    """Weight with surcharge, cohesion and adhesion, each per depth and width [Pa]."""
    weight = 0.5 * soil.density * GRAVITY * depth + (soil.surcharge + load)
    return weight, soil.cohesion, soil.adhesion


def _holding_slope(slope: Array | float, soil: Soil) -> Array:
    """The slope [rad], limited so that the soil does not slide by itself."""
    return np.maximum(slope, -_HOLDS * soil.friction)


def _tool_friction(soil: Soil) -> float:
    return 2.0 / 3.0 * soil.friction if soil.tool_friction is None else soil.tool_friction


def _usable(rake: Array, soil: Soil) -> Array:
    """The rake [rad], limited so that a wedge can slide up the blade."""
    room = np.pi - soil.friction - _tool_friction(soil)
    steepest = min(0.5 * np.pi, _STEEPEST * room)
    return np.clip(rake, min(_FLATTEST, 0.5 * steepest), steepest)
