"""A linear model of the curves near one curve: the rows and the cost of a quadratic program.

Its variables x are the steps of the control points that may move, each (n,), then that of the
duration T [s], then one slack with a high price: by how much all clearances may be missed at
once [m]. The curve runs over time t = T s, so that v = q'/T and a = q''/T^2.
"""

from __future__ import annotations

import itertools

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.law import UNBOUNDED, Kind, NearRows, QuadraticProgram, Rows, solve_with_near_rows
from backhoe_planner.machine import Configuration, movable_rows, wrap_angle
from backhoe_planner.motion import Drive, Goal, Problem
from backhoe_planner.planning.descent.bend import Bend
from backhoe_planner.planning.descent.curve import JointCurve, moment_changes, spread
from backhoe_planner.planning.descent.kinks import Kinks, NearKinks, rounded
from backhoe_planner.planning.descent.margins import Margins

PLACES_PER_PIECE = 3  # at which limits are linearised; chosen: accelerations are linear on a piece
_NEAR_LIMIT = 0.8  # part of a limit: a row that stays below it within the box cannot bind and is left out; chosen
# the same for the drive at one place, below which not even its derivatives are computed; chosen: no step in a sample
# of plans was changed by it, and four places in five are left out
_FAR_FROM_LIMIT = 0.3
_MOST_TURNING = 3  # joints at one place that may reverse their direction in one step; chosen: each doubles the rows
_LEAST_FLOW = 0.01  # part of the pump's flow that such a joint takes, below which it counts as not reversing; chosen
_CURVED = 1.5  # times the change of a margin in a step by its gradient; chosen, because distances are not linear
_KEEP_STILL = 1e-3  # price of moving all control points by the whole box; chosen, small compared with the cost
# of a program at most, and if none of these lowers the cost. Measured: the third adds a fiftieth of the kinks of the
# second, and on 45 steps of two machines the best of three has 0.98 of the gain of a solution with a variable for every
# kink; on three sites a fourth was enough where the first three had failed
_SOLUTIONS, _MORE_SOLUTIONS = 3, 6
# parts of a step that are compared; chosen
_PARTS = np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02])
_NONE = np.zeros(1)  # the part of a step that is none
_NO_LENGTH = 1e-12  # m: a shorter difference of positions has no direction
# of an edge of a cube about a ball, in equal angles: planes that touch the ball towards the points of this lattice
# bound a body in which no point is further than 1.13 and 1.0095 radii from the middle. A step that leaves the ball is
# corrected afterwards; measured: for another cost than the time large corrections drive curves into obstacles, and for
# the time it makes no difference
_PARTS_FOR_TIME, _PARTS_FOR_COST = 2, 8
# part of the radius that a step for such a cost leaves unused in a box of so many rad or m of the fastest joint, and
# less in a smaller one: as the tip moves on arcs, it leaves the ball nevertheless; chosen
_UNUSED, _WIDE_BOX = 0.01, 0.25
_CLEARANCE = "clearance"  # the name of the rows that may be missed by the slack


def _directions(parts: int) -> Matrix:
    """(K, 3) unit vectors to a lattice on the faces of a cube; 2 `parts` of an edge give K = 26, and 8 give 386."""
    angles = np.linspace(-0.25 * np.pi, 0.25 * np.pi, parts + 1)
    lattice = np.array(list(itertools.product(np.tan(angles), repeat=3)))
    found = lattice[np.max(np.abs(lattice), axis=1) > 1.0 - _NO_LENGTH]
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


_DIRECTIONS_FOR_TIME, _DIRECTIONS_FOR_COST = _directions(_PARTS_FOR_TIME), _directions(_PARTS_FOR_COST)


class LinearModel:
    """All constraints on a small step of one curve.

    Parameters
    ----------
    curve, duration: the curve q(s) and its T [s].
    end_moves: whether the end of the curve may move.
    box: how far each joint of a control point may move [rad or m], (n,).
    """

    def __init__(self, problem: Problem, curve: JointCurve, duration: float, *, end_moves: bool, box: Vector) -> None:
        self._problem, self._curve, self._T = problem, curve, duration
        n, last = curve.control.shape[1], curve.pieces + end_moves
        self._moving = slice(1, last)
        self._n, self._points = n, last - 1
        self._steps = n * self._points  # number of the variables of control points
        self._box = np.tile(box, self._points)
        self._places = PLACES_PER_PIECE * curve.pieces + 1
        self._weights = [curve.weights(self._places, derivative) for derivative in range(3)]
        self._at = [weights @ curve.control for weights in self._weights]  # q, q', q''
        self._acting, weights = curve.support(self._places)
        self._of_acting = weights * ((self._acting >= 1) & (self._acting < last))  # without what does not move
        self._rows: list[Rows] = []

    # --- constraints -----------------------------------------------------------------

    def keep_joint_limits(self) -> None:
        """Add rows for the joints' velocities and accelerations."""
        limits, T = self._problem.limits, self._T
        self._both_ways("velocity", self._weights[1], self._at[1], limits.velocity * T, 1.0)
        knots = slice(None, None, PLACES_PER_PIECE)
        self._both_ways("acceleration", self._weights[2][knots], self._at[2][knots], limits.acceleration * T * T, 2.0)

    def _both_ways(self, name: str, weights: Matrix, values: Matrix, most: Vector, power: float) -> None:
        """Add |value| <= most at K places, where `most` (n,) grows with the duration to a power.

        The values (K, n) change with the control points by `weights` (K, L + 1).
        """
        change = self._most_change(weights)
        for sign in (1.0, -1.0):
            place, joint = np.nonzero(sign * values + change > _NEAR_LIMIT * most)
            G, of_points = self._no_rows(len(place))
            of_points[np.arange(len(place)), :, joint] = sign * weights[place, self._moving]
            here = most[joint]
            self._add(
                name,
                G,
                here - sign * values[place, joint],
                by_duration=-power * here / self._T,
            )

    def keep_drive_limits(self, drive: Drive) -> None:
        """Add rows for torque, rod speed, flow and power."""
        if not drive.limited:
            return

        moments = self._moments()
        ratios = drive.ratios(*moments)
        near = np.flatnonzero((ratios > _FAR_FROM_LIMIT).any(axis=1))
        if not len(near):
            return
        base, slopes = ratios[near], drive.ratio_slopes(*(each[near] for each in moments))
        place, limit = np.nonzero(base >= 0.0)
        self._add_drive(near[place], base[place, limit], slopes[place, limit])
        if drive.hydraulics is not None:
            flow = 2 * self._n  # its column comes after efforts and rod speeds
            self._keep_flow_where_joints_turn(drive, near, base[:, flow], slopes[:, flow])

    def _keep_flow_where_joints_turn(self, drive: Drive, near: Indices, flow: Vector, slopes: Matrix) -> None:
        """Add rows for the flow with joints that reverse: the oil that a joint takes has a kink at zero velocity.

        Parameters
        ----------
        near: (K,) places.
        flow: (K,) there, divided by the pump's.
        slopes: (K, 3 n) its derivatives by q, v and a, as long as no joint reverses.
        """
        n, place = self._n, np.arange(len(near))[:, None]
        q, v = self._at[0][near], self._at[1][near] / self._T
        back = np.where(v < 0.0, 1.0, -1.0)  # the opposite direction
        each = np.eye(n) * back[:, :, None]
        by_rate = drive.flow_use(np.broadcast_to(q[:, None, :], each.shape), each)  # (K, n) in that direction
        kink = by_rate - back * slopes[:, n : 2 * n]  # (K, n) the change of the slope at zero velocity
        change = self._most_change(self._weights[1][near]) / self._T
        more = kink * (change - np.abs(v))  # (K, n) most flow of a joint that a step reverses
        most = np.argsort(-more, axis=1)[:, :_MOST_TURNING]
        some = np.array(list(itertools.product((False, True), repeat=most.shape[1]))[1:])  # who turns together
        turns = np.zeros((len(some), *kink.shape), dtype=bool)
        turns[:, place, most] = some[:, None, :]
        which, row = np.nonzero(np.all(~turns | (more > _LEAST_FLOW), axis=2))
        turning, turned = turns[which, row], slopes[row]
        turned[:, n : 2 * n] += np.where(turning, (back * kink)[row], 0.0)
        without = flow[row] - np.sum(np.where(turning, (kink * np.abs(v))[row], 0.0), axis=1)
        self._add_drive(near[row], without, turned)

    def _add_drive(self, place: Indices, use: Vector, slopes: Matrix) -> None:
        """Add rows for uses of the drive (R,) at `place` (R,), with `slopes` (R, 3 n) by q, v and a."""
        T, n = self._T, self._n
        scaled = np.hstack((slopes[:, :n], slopes[:, n : 2 * n] / T, slopes[:, 2 * n :] / T**2))
        acting, weights = self._acting[place], self._of_acting[:, place]
        changes = moment_changes(acting, weights, scaled, n)
        kept = use + np.abs(changes).sum(axis=1) @ self._box[:n] > _NEAR_LIMIT
        place, scaled = place[kept], scaled[kept]
        slower = np.sum(scaled[:, n : 2 * n] * self._at[1][place], axis=1)
        slower += 2.0 * np.sum(scaled[:, 2 * n :] * self._at[2][place], axis=1)
        G = spread(acting[kept], changes[kept], self._moving, self._curve.pieces, more=2)
        self._add("drive", G, 1.0 - use[kept], by_duration=-slower / T)

    def keep_clear(self, margins: Margins, places: int, *, after: Vector | None = None) -> None:
        """Add rows for margins at some of `places` equally spaced u; all may be missed by the slack.

        Parameters
        ----------
        after: a step (steps,) of the control points after which these are the margins; None if they are the curve's.
        """
        weights, margin = self._curve.weights(places)[margins.place, self._moving], margins.margin
        reach = np.abs(weights).sum(axis=1)
        near = np.flatnonzero(margin < _CURVED * reach * (np.abs(margins.gradient) @ self._box[: self._n]))
        G, of_points = self._no_rows(len(near))
        np.multiply(-margins.gradient[near, None, :], weights[near, :, None], out=of_points)
        room = margin[near] if after is None else margin[near] + G[:, : self._steps] @ after
        self._add(_CLEARANCE, G, room, slack=True)

    def stay_on_goal(self, goal: Goal, end: Configuration) -> None:
        """Add rows that keep the end of the curve, with the joints at `end`, on a goal."""
        error, J, target = goal.error(end), goal.jacobian(end), goal.search_target
        asked = movable_rows(J)
        if target.position_tolerance:
            asked[:3] = False
            away = end.tip_position - target.position
            is_time = self._problem.objective.is_time
            outward = _DIRECTIONS_FOR_TIME if is_time else _DIRECTIONS_FOR_COST
            outward = np.vstack((outward, away / max(float(np.linalg.norm(away)), _NO_LENGTH)))
            unused = 0.0 if is_time else _UNUSED * min(float(np.max(self._box)) / _WIDE_BOX, 1.0)
            G = outward @ end.jacobian[:3]
            room = np.maximum((1.0 - unused) * target.position_tolerance - outward @ away, 0.0)
            near = np.abs(G) @ self._box[: self._n] > room
            self._add("position", self._of_end(G[near]), room[near])
        if target.rotation is not None:
            # within its tolerance the orientation is free; an excess is corrected after the step
            asked[3:] &= target.rotation_tolerance == 0.0 or bool(np.any(error[3:]))
        elif target.pitch is not None and target.pitch[1] > target.pitch[0]:
            asked[3] = False
            low, high = target.pitch
            off, half = wrap_angle(end.pitch - 0.5 * (low + high)), 0.5 * (high - low)
            turn = np.atleast_2d(end.pitch_row)
            self._add("pitch", self._of_end(np.vstack((turn, -turn))), np.array([half - off, half + off]))
        self._add("goal", self._of_end(J[asked]), error[asked], kind=Kind.EQUAL)

    # --- cost --------------------------------------------------------------------------

    def program(self, slack_price: float, *, longest: float = np.inf, may_be_late: bool = False) -> QuadraticProgram:
        """The program whose solution is the best step for the duration.

        Parameters
        ----------
        slack_price: of a missed metre, as a part of the cost.
        longest: longest T [s]; if T is longer, it does not grow.
        may_be_late: whether T may stay longer than the longest.
        """
        T = self._T
        f = np.zeros(self._steps + 2)
        f[-2], f[-1] = 1.0 / T, slack_price
        price = np.concatenate((_KEEP_STILL / (self._box**2 * self._points), [_KEEP_STILL / T**2, 1e-2]))
        H = np.diag(price)
        limits, now = self._problem.limits, self._curve.control[self._moving].ravel()
        lower, upper = (np.tile(bound, self._points) - now for bound in (limits.lower, limits.upper))
        # the price of being late holds only while T is longer than the longest
        least = longest - T if may_be_late and longest < T else -0.5 * T
        low = np.concatenate((np.minimum(np.maximum(-self._box, lower), 0.0), [least, 0.0]))
        high = np.concatenate(
            (np.maximum(np.minimum(self._box, upper), 0.0), [min(2.0 * T, max(longest - T, 0.0)), 1.0])
        )
        return QuadraticProgram(np.asarray(H), f, low, high, tuple(self._rows))

    def best_step(
        self, slack_price: float, *, bend: Bend | None, longest: float = np.inf, most_iterations: int
    ) -> Vector | None:
        """The best step, or None if there is none; parameters as for `program`.

        The bend says how the cost changes with the control points that may move, and with T; it is None if the cost is
        the duration. With a bend the program is solved first without a variable for any kink, and again if the step
        crosses some. As each solution may cross others, the result is the part of one solution that costs least with
        all kinks. If no part costs less than no step, more kinks get variables.
        """
        if bend is None:
            return solve_with_near_rows(self.program(slack_price, longest=longest), most_iterations=most_iterations)
        plain = self.program(slack_price, longest=longest, may_be_late=True)
        rows, smooth, kinks = NearRows(plain), _smooth(plain, bend), self._near_kinks(bend)
        m, count = self._steps + 1, self._steps + 2
        best, least, start = None, np.inf, None
        for number in range(_MORE_SOLUTIONS):
            if number >= _SOLUTIONS and least < self._costs_of_parts(np.zeros(m), bend, slack_price, _NONE)[0]:
                break
            crossed = kinks.variables()
            if start is not None:
                start = np.append(start, np.maximum(crossed.value + crossed.G @ start[:m], 0.0))
            bent = _bent(smooth, kinks, crossed)
            x = rows.solve(bent, most_iterations=most_iterations, coupled=count, start=start)
            if x is None:
                break
            start = x[:count]
            costs = self._costs_of_parts(x[:m], bend, slack_price, _PARTS)
            found = int(np.argmin(costs))
            if costs[found] < least:
                best, least = _PARTS[found] * x[:count], costs[found]
            known = kinks
            kinks = known.after(x[:m])
            if kinks is known:
                break
        return best

    def _costs_of_parts(self, step: Vector, bend: Bend, slack_price: float, parts: Vector) -> Vector:
        """(K,) the costs of `parts` (K,) of a step (m,), by the bend, all its kinks, and what the step misses."""
        kinks = bend.kinks
        value, change = kinks.value, kinks.G @ step
        straight = float(bend.slope @ step - (kinks.share * kinks.rising) @ change)
        curved = float(step @ bend.smooth_curvature @ step)
        missed = [np.zeros((1, len(parts)))]
        missed += [
            np.outer(row.G[:, :-1] @ step, parts) - row.h[:, None] for row in self._rows if row.name == _CLEARANCE
        ]
        cost = kinks.share @ rounded(value[:, None] + np.outer(change, parts), kinks.width)
        cost += parts * straight + 0.5 * parts**2 * curved + slack_price * np.vstack(missed).max(axis=0)
        return np.asarray(cost)

    def _near_kinks(self, bend: Bend) -> NearKinks:
        """The kinks of the cost that a step within the box may reach."""
        return bend.kinks.near(np.append(self._box, 0.0))

    def step(self, x: Vector) -> tuple[Matrix, float]:
        """The curve's control points (L + 1, n) and duration after the step `x`."""
        control = self._curve.control.copy()
        control[self._moving] += x[: self._steps].reshape(-1, self._n)
        return control, self._T + float(x[self._steps])

    # --- dependence on the variables ------------------------------------------------------

    def _most_change(self, weights: Matrix) -> Matrix:
        """(K, n) most change of the joints at K places within the box, by `weights` (K, L + 1) of control points."""
        return np.asarray(np.abs(weights[:, self._moving]) @ self._box.reshape(-1, self._n))

    def _no_rows(self, count: int) -> tuple[Matrix, Array]:
        """(count, steps + 2) rows of zeros, and a view (count, L, n) of what they have of the control points."""
        G = np.zeros((count, self._steps + 2))
        return G, G[:, : self._steps].reshape(count, self._points, self._n)

    def _of_end(self, J: Matrix) -> Matrix:
        """(m, steps + 2) rows J (m, n) applied to the end of the curve."""
        G, of_points = self._no_rows(len(J))
        of_points[:, -1] = J
        return G

    def _add(
        self, name: str, G: Matrix, h: Vector, *, by_duration: Vector | float = 0.0, slack: bool = False,
        kind: Kind = Kind.HARD,
    ) -> None:  # fmt: skip
        """Add rows G (R, steps + 2), whose last two columns are entered here, for the duration and the slack."""
        G[:, -2], G[:, -1] = by_duration, -1.0 if slack else 0.0
        self._rows.append(Rows(name, G, h, kind))

    def _moments(self) -> tuple[Matrix, Matrix, Matrix]:
        """(K, n) each: q, v and a at all places."""
        q, first, second = self._at
        return q, first / self._T, second / self._T**2


def _smooth(plain: QuadraticProgram, bend: Bend) -> QuadraticProgram:
    """A program for the duration turned into one for another cost, without its kinks and without rows."""
    m = len(bend.slope)
    H, f = plain.H.copy(), plain.f.copy()
    H[:m, :m] += bend.smooth_curvature
    f[:m] = bend.slope
    return plain._replace(H=H, f=f, rows=())


def _bent(smooth: QuadraticProgram, kinks: NearKinks, crossed: Kinks) -> QuadraticProgram:
    """The program with `kinks`, and with one more variable for each that is `crossed`. Its rows are those of these."""
    count, m = len(smooth.f), crossed.G.shape[1]
    zeros = np.zeros(len(crossed.value))
    f, low = np.concatenate((smooth.f, zeros)), np.concatenate((smooth.low, zeros))
    high = np.concatenate((smooth.high, zeros + UNBOUNDED))
    f[:m] -= kinks.slope_of_variables()
    H = np.zeros((len(f), len(f)))
    H[:count, :count] = smooth.H
    H[:m, :m] += kinks.curvature()
    more = np.arange(count, len(f))
    H[more, more] = crossed.share / crossed.width
    G = np.zeros((len(more), len(f)))
    G[:, :m] = crossed.G
    G[np.arange(len(more)), more] = -1.0
    return QuadraticProgram(H, f, low, high, (Rows("kinks", G, -crossed.value, Kind.HARD),))
