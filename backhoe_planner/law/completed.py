"""The completed law: equation (12) with terms that stay bounded and gains that need no tuning.

    v = J_e^+ xdot_e + H,    H = argmin over the null space of
          sum_i w_i (g_i (v_e + H) - c_i)^2          obstacles
        + sum_j h_j (v_j + H_j)^2                    joints to be held
        + sum_k s_k |J_k (v_e + H) - xdot_k|^2       links to be turned
        + eps |H|^2

Each critical point has one scalar row g_i (the gradient of its distance) instead of its
three velocities, and one problem has all terms instead of a sum of pseudo-inverses: if
the null space cannot serve a row, eps lets the row fade out instead of growing without bound.
The weights are the criterion for the gains that the paper leaves open:

- w_i is 0 at the influence distance and 1 at the unity distance, a cosine between
  (Maciejewski and Klein 1985), so that no row enters or leaves with a jump;
- c_i is a push away within the unity distance, ((d_u / d)^2 - 1) times nominal;
- h_j grows from 0 to 1 as joint j nears a limit towards which it is moving. This is
  the purpose of D = -1 in (15). As printed, D = -1 requests the opposite of the predicted
  turn of the whole link. If the prediction is wrong, this drives the joint further towards
  its limit: in one to three of ten random configurations near a limit it did. The joint's
  own rate cannot be wrong.
- s_k, with D = +1, is 0 unless the scene sets it: over seeded random scenes it made no
  measurable difference to how often the law arrives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import eigenpy
import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import check_flag, check_kind
from backhoe_planner.law.directionality import link_chain, link_jacobian, link_velocities
from backhoe_planner.law.null_space import (
    LARGEST_DAMPING,
    RANK_TOLERANCE,
    UNDAMPED,
    TaskInverse,
    resolve,
    resolve_on_null_line,
)
from backhoe_planner.machine import Configuration, Robot
from backhoe_planner.native import compiled
from backhoe_planner.site import Gains, Nearby

_EPSILON = 2e-2  # (m/rad)^2; chosen: rows weaker than its root, 0.14 m/rad, fade out
_LARGEST_PUSH = 3.0  # times nominal; chosen
_NEAREST_PUSH = math.sqrt(1.0 + _LARGEST_PUSH)  # unity distance over the distance at which the push is largest
_NEAR_LIMIT = 0.15  # part of a joint's range; chosen: within this a joint counts as near its limit
_FEW = 32  # rows up to which plain numbers are faster than arrays; measured
_STANDING = 1e-9  # rad/s or m/s: a slower joint moves towards no limit


@dataclass(frozen=True)
class Wish:
    """The joint velocity that the law requests, before the shield.

    Attributes
    ----------
    v: (n,) joint velocity [rad/s or m/s].
    primary: (n,) J_e^+ xdot_e, times s_e.
    null: (n,) H, the obstacle and directionality terms; J_e @ null is 0.
    task: inverse and projector of the tip's Jacobian.
    """

    v: Vector
    primary: Vector
    null: Vector
    task: TaskInverse


class CriticalRows(NamedTuple):
    """One row per critical point: the part of a `Nearby` that the law needs.

    Attributes
    ----------
    margin: (K,) distance minus clearance [m].
    gradient: (K, n) derivative of the distance by the joints [m/rad].
    drift: (K,) rate of change of the distance due to the obstacle's own motion [m/s].
    """

    margin: Vector
    gradient: Matrix
    drift: Vector


def activation(distance: Vector, unity: float, influence: float) -> Vector:
    """(K,) alpha_h of Maciejewski and Klein for `distance` (K,): 1 up to `unity`, a cosine to 0 at `influence` [m]."""
    part = distance - unity
    part *= math.pi / (influence - unity)
    np.minimum(np.maximum(part, 0.0, out=part), math.pi, out=part)
    np.cos(part, out=part)
    part += 1.0
    part *= 0.5
    return part


def push_factor(distance: Vector, unity: float) -> Vector:
    """(K,) alpha_o of Maciejewski and Klein for `distance` d (K,): (unity / d)^2 - 1 within `unity` [m], 3 at most."""
    return np.asarray(np.maximum((unity / np.maximum(distance, unity / _NEAREST_PUSH)) ** 2 - 1.0, 0.0))


class CompletedLaw:
    """The completed law for one machine; see the module's text.

    Parameters
    ----------
    robot: the machine.
    influence: margin (distance minus clearance) within which an obstacle acts [m].
    nominal: speed of the push away from an obstacle where the push factor is 1 [m/s].
    gains: s_e and s_o multiply the primary task and the obstacles' weights, s_k [by
        joint name] weighs the turn of link k as predicted (D = +1); None for 1, 1 and 0.
    directionality: whether joints near a limit are held, and links turned.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        influence: float,
        nominal: float = 0.1,
        gains: Gains | None = None,
        directionality: bool = True,
    ) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        self.influence = as_number(influence, key="influence", above=0.0)
        self.unity = self.influence / 3.0
        self.nominal = as_number(nominal, key="nominal", least=0.0)
        self.directionality = check_flag(directionality, key="directionality")
        if gains is not None:
            check_kind(gains, Gains, key="gains")
        self._s_e = 1.0 if gains is None else gains.s_e
        self._s_o = 1.0 if gains is None else gains.s_o
        s_k = [0.0 if gains is None else gains.s_k.get(name, 0.0) for name in robot.joint_names[:-1]]
        self._s_k = np.repeat(s_k, 3)
        self._turns = directionality and any(s_k)
        span = robot.limits.upper - robot.limits.lower
        zone = np.where(np.isfinite(span), _NEAR_LIMIT * span, 1.0)
        columns = (robot.limits.lower, robot.limits.upper, zone)
        self._ranges = tuple(zip(*(column.tolist() for column in columns), strict=True))
        self._epsilon = _EPSILON * np.eye(robot.n)
        self._settings = LawSettings(
            self._s_e, self._s_o, self.influence, self.unity, self.nominal, float(self.directionality)
        )

    def wish(self, at: Configuration, J_e: Matrix, xdot_e: Vector, nearby: Nearby | CriticalRows) -> Wish:
        """The joint velocity that serves the tip first, and everything else in the null space.

        Parameters
        ----------
        at: the configuration.
        J_e: (m, n) task Jacobian; leave out rows that no joint can move.
        xdot_e: (m,) task velocity, [m/s] and [rad/s].
        nearby: critical points within clearance + influence.

        Raises
        ------
        InputError: an argument has the wrong kind or shape; the message names it.
        """
        check_kind(at, Configuration, key="at")
        J_e, xdot_e = self._checked_task(J_e, xdot_e)
        return self.wish_unchecked(at, J_e, xdot_e, self._checked_rows(nearby))

    def wish_unchecked(self, at: Configuration, J_e: Matrix, xdot_e: Vector, nearby: Nearby | CriticalRows) -> Wish:
        """`wish` without checks, for callers in a loop whose arguments are right by construction."""
        task = resolve(J_e)
        primary = self._s_e * task.inverse.dot(xdot_e)
        N = task.projector
        A = self._epsilon.copy()
        b = np.zeros(len(primary))
        acts = False
        if self._s_o > 0.0 and len(nearby.margin):
            acts = self._add_obstacles(primary, nearby, N, A, b)
        if self.directionality and len(b) > len(xdot_e):
            acts |= self._add_holds(at, primary, N, A, b)
            if self._turns:
                self._add_turns(at, primary, N, A, b)
                acts = True
        if not acts:
            return Wish(v=primary, primary=primary, null=b, task=task)
        null = N @ eigenpy.LDLT(A).solve(b).reshape(-1)  # for a 1 x 1 system it returns a matrix
        return Wish(v=primary + null, primary=primary, null=null, task=task)

    def terms_unchecked(
        self, at: Configuration, J_e: Matrix, xdot_e: Vector, nearby: Nearby | CriticalRows
    ) -> tuple[Vector, Vector]:
        """(n,), (n,) the `primary` and `null` of `wish`, computed the fastest way, for callers in a loop."""
        found = self.quick_terms_unchecked(at.q, J_e, xdot_e, nearby)
        if found is None:
            wish = self.wish_unchecked(at, J_e, xdot_e, nearby)
            return wish.primary, wish.null
        return found[:2]

    def quick_terms_unchecked(
        self, q: Vector, J_e: Matrix, xdot_e: Vector, nearby: Nearby | CriticalRows
    ) -> tuple[Vector, Vector, float] | None:
        """(n,), (n,) the `primary` and `null` of `wish`, and its damping, faster than by `wish`: see `quick_terms`.

        None if links are to be turned, or if there is no faster way.
        """
        if self._turns:
            return None
        return quick_terms(q, J_e, xdot_e, nearby.margin, nearby.gradient, nearby.drift, self._ranges, self._settings)

    def near_limit(self, q: Vector, v: Vector) -> Vector:
        """(n,) 0 far from any limit, 1 at the limit towards which `v` moves the joint."""
        return self._near_limit(as_vector(q, self.robot.n, key="q"), as_vector(v, self.robot.n, key="v"))

    def _near_limit(self, q: Vector, v: Vector) -> Vector:
        near = []
        for position, rate, (low, high, zone) in zip(q.tolist(), v.tolist(), self._ranges, strict=True):
            if abs(rate) < _STANDING:
                near.append(0.0)
                continue
            ahead = high - position if rate > 0.0 else position - low
            near.append(min(max(1.0 - ahead / zone, 0.0), 1.0))
        return np.array(near)

    def _checked_task(self, J_e: Matrix, xdot_e: Vector) -> tuple[Matrix, Vector]:
        J_e = as_array(J_e, None, self.robot.n, key="J_e")
        return J_e, as_vector(xdot_e, len(J_e), key="xdot_e")

    def _checked_rows(self, nearby: Nearby | CriticalRows) -> Nearby | CriticalRows:
        if isinstance(nearby, Nearby):
            return nearby
        check_kind(nearby, CriticalRows, key="nearby")
        gradient = as_array(nearby.gradient, None, self.robot.n, key="nearby.gradient")
        margin = as_vector(nearby.margin, len(gradient), key="nearby.margin")
        return CriticalRows(margin, gradient, as_vector(nearby.drift, len(margin), key="nearby.drift"))

    def _add_obstacles(self, primary: Vector, nearby: Nearby | CriticalRows, N: Matrix, A: Matrix, b: Vector) -> bool:
        """Add the rows w_i (g_i (v_e + H) - c_i)^2 of critical points that move away more slowly than c_i."""
        margin, gradient = nearby.margin, nearby.gradient
        acts = margin < self.influence
        count = np.count_nonzero(acts)
        if count < len(margin):
            if count == 0:
                return False
            margin, gradient = margin[acts], gradient[acts]
        if len(margin) > _FEW:
            weight = self._s_o * activation(margin, self.unity, self.influence)
        else:
            weight = np.array([self._s_o * self._activation(near) for near in margin.tolist()])
        away = -nearby.drift if len(margin) == len(nearby.margin) else -nearby.drift[acts]
        if margin[margin.argmin()] < self.unity:
            away += self.nominal * push_factor(margin, self.unity)
        away -= gradient @ primary
        missing = np.maximum(away, 0.0, out=away)
        G = gradient @ N
        weighted = G.T * weight
        A += weighted @ G
        b += weighted @ missing
        return True

    def _activation(self, margin: float) -> float:
        """`activation` of one margin [m]."""
        if margin <= self.unity:
            return 1.0
        if margin >= self.influence:
            return 0.0
        return 0.5 * (1.0 + math.cos(math.pi * (margin - self.unity) / (self.influence - self.unity)))

    def _add_holds(self, at: Configuration, primary: Vector, N: Matrix, A: Matrix, b: Vector) -> bool:
        """Add the rows h_j (v_j + H_j)^2 of joints that are near a limit and move towards it."""
        near = self._near_limit(at.q, primary)
        if not np.count_nonzero(near):
            return False
        weighted = N * (near * near)
        A += weighted @ N
        b -= weighted @ primary
        return True

    def _add_turns(self, at: Configuration, primary: Vector, N: Matrix, A: Matrix, b: Vector) -> None:
        """Add the rows s_k |J_k (v_e + H) - xdot_k|^2."""
        chain = link_chain(at)
        J = np.vstack([link_jacobian(chain, k, reference="standard") for k in range(1, self.robot.n)])
        turns = link_velocities(
            chain,
            at.jacobian[:3] @ primary,
            D=np.ones(self.robot.n - 1),
            magnification="norm_preserving",
            follow_bend=True,
            as_rates=True,
        ).ravel()
        row = J @ N
        weighted = row.T * self._s_k
        A += weighted @ row
        b += weighted @ (turns - J @ primary)


class LawSettings(NamedTuple):
    """The parameters of a `CompletedLaw` and the constants of this module; `holds` is 1.0 with directionality."""

    s_e: float
    s_o: float
    influence: float
    unity: float
    nominal: float
    holds: float
    epsilon: float = _EPSILON
    nearest_push: float = _NEAREST_PUSH
    standing: float = _STANDING
    undamped: float = UNDAMPED
    largest_damping: float = LARGEST_DAMPING
    rank_tolerance: float = RANK_TOLERANCE


@compiled
def quick_terms(
    q: Vector, J_e: Matrix, xdot_e: Vector, margin: Vector, gradient: Matrix, drift: Vector,
    ranges: tuple[tuple[float, float, float], ...], settings: LawSettings, /,
) -> tuple[Vector, Vector, float] | None:  # fmt: skip
    """(n,), (n,) J_e^+ xdot_e times s_e, and H, and the damping; None if there is no faster way than `wish`.

    The plain version works if J_e is (3, 4) and not near a singularity. Then the null space is one line, N = z z^T, and
    the only unknown is the component along z:

        H = z (sum_i w_i (g_i z) missing_i - sum_j h_j z_j v_j) / (eps + sum_i w_i (g_i z)^2 + sum_j h_j z_j^2)

    Parameters
    ----------
    q: (n,) joint positions [rad or m].
    J_e, xdot_e: (m, n), (m,) the task.
    margin, gradient, drift: (K,), (K, n), (K,) of the critical points, see `CriticalRows`.
    ranges: for each of n joints the two limits, and the distance within which it counts as near a limit [rad or m].
    """
    if J_e.shape != (3, 4):
        return None
    found = resolve_on_null_line(J_e, xdot_e)
    if found is None:
        return None
    primary, z = found
    if settings.s_e != 1.0:
        primary = [settings.s_e * rate for rate in primary]
    above, below = 0.0, settings.epsilon
    if settings.s_o > 0.0 and len(margin):
        above, below = _sums_of_rows(margin, drift, gradient.dot(np.array((z, primary)).T), settings)
    if settings.holds:
        for position, rate, part, (low, high, zone) in zip(q.tolist(), primary, z, ranges, strict=True):
            if abs(rate) < settings.standing:
                continue
            hold = 1.0 - (high - position if rate > 0.0 else position - low) / zone
            if hold > 0.0:
                hold = min(hold, 1.0) ** 2
                above -= hold * part * rate
                below += hold * part * part
    size = above / below
    return np.array(primary), np.array([size * part for part in z]), 0.0


def _sums_of_rows(margins: Vector, drifts: Vector, rates: Matrix, settings: LawSettings) -> tuple[float, float]:
    """Numerator and denominator of H in `quick_terms`, without the holds; rates (K, 2) are g_i z, g_i v_e."""
    influence, unity, nominal = settings.influence, settings.unity, settings.nominal
    nearest = unity / settings.nearest_push
    above = below = 0.0
    if len(rates) <= _FEW:
        per_margin = math.pi / (influence - unity)
        for margin, drift, (along, speed) in zip(margins.tolist(), drifts.tolist(), rates.tolist(), strict=True):
            if margin >= influence:
                continue
            weighted, missing = along, -drift - speed
            if margin > unity:
                weighted *= 0.5 + 0.5 * math.cos(per_margin * (margin - unity))
            elif margin < unity:
                missing += nominal * ((unity / max(margin, nearest)) ** 2 - 1.0)
            below += weighted * along
            if missing > 0.0:
                above += weighted * missing
        return settings.s_o * above, settings.epsilon + settings.s_o * below
    by_z, rate = rates.T
    weighted = activation(margins, unity, influence)
    weighted *= by_z
    missing = drifts + rate
    np.negative(missing, out=missing)
    if margins[margins.argmin()] < unity:
        missing += nominal * push_factor(margins, unity)
    np.maximum(missing, 0.0, out=missing)
    return (
        settings.s_o * float(weighted.dot(missing)),
        settings.epsilon + settings.s_o * float(weighted.dot(by_z)),
    )
