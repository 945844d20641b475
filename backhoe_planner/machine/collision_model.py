"""The machine's collision shape as Pinocchio sees it, and how far its parts can travel.

`travel_bounds` gives, for every collision piece and joint, the greatest distance r_j that a
point of the piece can have from that joint's axis. A motion dq then moves no point of the
piece further than sum_j |dq_j| r_j. The certificate and the broad phase rest on this bound.

r_j depends on how far a slide carries the parts beyond it. Within the slide's limits that is known
beforehand; for a configuration outside of them, pass the configuration as `q`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.robot import Robot


def geometry_model(
    robot: Robot, *, pieces: Sequence[LinkPiece] | None = None, inner: Collection[int] = ()
) -> pin.GeometryModel:
    """A new geometry model that holds `robot.pieces`, in their order, without pairs.

    Parameters
    ----------
    pieces: other pieces of the robot, to be held instead of `robot.pieces`.
    inner: indices of the pieces for which the model holds `Piece.inner`, if there is one.
    """
    model = pin.GeometryModel()
    for index, piece in enumerate(robot.pieces if pieces is None else pieces):
        shape = (piece.piece.inner if index in inner else None) or piece.piece.shape
        model.addGeometryObject(pin.GeometryObject(piece.name, piece.joint, 0, piece.piece.placement, shape))
    return model


def _slide_reach(robot: Robot, q: Matrix | None) -> Vector:
    """(n,) the greatest distance of every slide from its zero [m]; 0 for a hinge.

    It holds within the limits, in the configurations q (..., n), if given, and between them, with the machine's
    tracking error added.
    """
    limits = robot.limits
    reach = np.maximum(np.abs(limits.lower), np.abs(limits.upper))
    if q is not None:
        reach = np.maximum(reach, np.abs(np.reshape(q, (-1, robot.n))).max(axis=0))
    return np.where(robot.prismatic, reach if robot.tube is None else reach + robot.tube.joints, 0.0)


def travel_bounds(robot: Robot, q: Matrix | None = None, *, pieces: Sequence[LinkPiece] | None = None) -> Matrix:
    """(pieces, n) r of each of `robot.pieces` and each joint [m/rad], 1 for a prismatic joint.

    It is 0 for joints further out than the piece, because they do not move it. The bounds hold within
    the limits, and also in and between the configurations q (..., n) if these are given. If `pieces` of
    the robot are given, the bounds are for these instead.
    """
    pieces = robot.pieces if pieces is None else pieces
    bounds, reach = np.zeros((len(pieces), robot.n)), _slide_reach(robot, q)
    for row, piece in enumerate(pieces):
        bounds[row] = _bounds_of_points(robot, piece.joint, piece.piece.hull, piece.piece.radius, reach)
    return bounds


def tracking_room(robot: Robot, pieces: Sequence[LinkPiece], travel: Matrix) -> Vector:
    """(K,) how far the machine's tracking error can take any point of a piece from its planned position [m].

    It is sum_j |delta_j| r_j. For a piece that is fixed to the tip and is compared with something that
    does not move, it is at most the tip's own error plus what the turning of all hinges adds around the tip.

    Parameters
    ----------
    pieces: K pieces of the robot.
    travel: (K, n) r of each, see `travel_bounds`; for two links of the machine, r of their relative motion.
    """
    if robot.tube is None:
        return np.zeros(len(pieces))
    room = np.asarray(travel) @ robot.tube.joints
    if not np.isfinite(robot.tube.tip):
        return np.asarray(room)
    tip = robot.model.frames[robot.tip_frame]
    turn = float(robot.tube.joints[~robot.prismatic].sum())
    own = travel_bounds(robot, pieces=pieces)
    for row, piece in enumerate(pieces):
        if piece.joint == int(tip.parentJoint) and np.array_equal(travel[row], own[row]):
            lever = float(np.linalg.norm(piece.piece.hull - tip.placement.translation, axis=1).max())
            room[row] = min(room[row], robot.tube.tip + turn * (lever + piece.piece.radius))
    return np.asarray(room)


def tip_tracking_error(robot: Robot) -> float:
    """How far the machine's tracking error can take the tip from its planned position [m]."""
    if robot.tube is None:
        return 0.0
    return min(robot.tube.tip, float(tip_travel_bound(robot) @ robot.tube.joints))


def tip_travel_bound(robot: Robot, q: Matrix | None = None) -> Vector:
    """(n,) r of each joint for the robot's tip [m/rad], 1 for a prismatic joint; `q` as in `travel_bounds`."""
    frame = robot.model.frames[robot.tip_frame]
    tip = frame.placement.translation[None, :]
    return _bounds_of_points(robot, int(frame.parentJoint), tip, 0.0, _slide_reach(robot, q))


def reach_ball(robot: Robot, q: Matrix | None = None) -> tuple[Vector, float]:
    """A ball that no moving piece ever leaves: its centre (3,) and radius [m], world; `q` as in `travel_bounds`."""
    model, slides = robot.model, _slide_reach(robot, q)
    centre = np.array(model.jointPlacements[1].translation)
    away = np.zeros(robot.n + 1)  # the greatest distance of each joint's origin from that of the first joint
    for joint in range(2, robot.n + 1):
        inner, step = int(model.parents[joint]), model.jointPlacements[joint].translation
        if inner == 0:
            away[joint] = float(np.linalg.norm(step - centre))
        else:
            away[joint] = away[inner] + slides[inner - 1] + float(np.linalg.norm(step))
    radius = 0.0
    for piece in robot.pieces:
        if piece.joint > 0:
            own = float(np.linalg.norm(piece.piece.hull, axis=1).max()) + piece.piece.radius
            radius = max(radius, away[piece.joint] + float(slides[piece.joint - 1]) + own)
    return centre, radius


def _bounds_of_points(robot: Robot, joint: int, points: Matrix, radius: float, reach: Vector) -> Vector:
    """(n,) r for balls of `radius` [m] around points (k, 3) that are fixed in the frame of `joint`.

    reach: (n,) from `_slide_reach`.
    """
    model = robot.model
    found = np.zeros(robot.n)
    if joint == 0:
        return found
    from_origin = float(np.max(np.linalg.norm(points, axis=1))) + radius
    found[joint - 1] = 1.0 if robot.prismatic[joint - 1] else _off_axis(points, robot.joint_axes[joint - 1]) + radius
    outer = joint
    inner = int(model.parents[joint])
    while inner > 0:
        step = model.jointPlacements[outer].translation
        from_origin += float(reach[outer - 1])
        off = _off_axis(step[None, :], robot.joint_axes[inner - 1])
        found[inner - 1] = 1.0 if robot.prismatic[inner - 1] else off + from_origin
        from_origin += float(np.linalg.norm(step))
        outer, inner = inner, int(model.parents[inner])
    return found


def _off_axis(points: Matrix, axis: Vector) -> float:
    """The largest distance of (k, 3) points from the line through 0 along the unit vector `axis` [m]."""
    along = points @ axis
    return float(np.max(np.linalg.norm(points - along[:, None] * axis, axis=1)))


def bend_weights(delta: Array, turning: Vector) -> Array:
    """(..., n) weights b of the joints: r . b bounds the second derivative of any point's path on a motion `delta` [m].

    On the motion q + s delta, 0 <= s <= 1, a point x moved by the joints 1 .. n, counted
    from the base, has the second derivative

        x'' = sum_j d_j^2 x_jj + 2 sum_{i<j} d_i d_j x_ij

    For a hinge j, x_j = a_j x (x - o_j) is no longer than r_j (`travel_bounds`); for a slide,
    x_j = a_j and r_j = 1. A hinge i further in turns x_j with it, x_ij = a_i x x_j; a slide i
    only shifts it, x_ij = 0; likewise for i = j. So, with w = |d| for hinges and 0 for slides,

        |x''| <= sum_j r_j |d_j| (w_j + 2 sum_{i<j} w_i) = r . b

    The point is then nowhere further than r . b / 8 from where it would be if it moved straight and
    evenly along the chord from one end to the other.

    Parameters
    ----------
    delta: (..., n) the motion [rad or m], joints in order from the base.
    turning: (n,) 1 for hinges, 0 for slides.
    """
    size = np.abs(delta)
    angle = size * turning
    return np.asarray(size * (2.0 * angle.cumsum(axis=-1) - angle))
