"""The certificate: a proof about a whole continuous motion, made after the fact.

On a segment from q_a to q_b no point of a link moves further than
B = sum_j |dq_j| r_j relative to an obstacle (its own travel added), so the distance
anywhere between is at least (d_a + d_b - B) / 2. Where that bound does not decide, the
segment is halved. The result is the least distance over the whole motion, proven to
within `RESOLUTION` (or 2 % of the margin, where that is more), and never above the true
one. It rests on nothing but the URDF,
the scene and the samples: not on how the motion was found.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import Kinematics, Robot, tip_travel_bound
from backhoe_planner.motion import (
    DRIVEN_WITHIN,
    Detour,
    Problem,
    Tracking,
    Trajectory,
    between_samples,
    build_problem,
    drive_of,
    track_goal,
    track_path,
    use_of_drive,
)
from backhoe_planner.site import Obstruction, Proximity, Scene

__all__ = [
    "TOUCH",
    "Certificate",
    "LimitUse",
    "LoadUse",
    "SpeedUse",
    "certify",
    "certify_problem",
    "path_segment_is_clear",
    "segment_is_clear",
    "told_part",
]

Vector = NDArray[np.float64]

RESOLUTION = 1e-4  # m: how far a proven bound may lie below the true least distance
_RESOLUTION_OF_MARGIN = 0.02  # or this part of the margin, where that is more
_EFFORT = 200_000  # measurements per obstacle at most
_EFFORT_REFUTED = 2_000  # where the motion is already known not to keep its clearance
KEPT_WITHIN = RESOLUTION + 1e-5  # m: a motion at exactly its clearance counts as keeping it
TOUCH = 5e-5  # m: a path at exactly its clearance is clear to within this
_TOUCHING_DEPTH = 9
_LIMIT_TOLERANCE = 1e-6  # relative, for rounding
SPEED_WITHIN = 0.03  # over the asked speed of the tip that a motion may be: it is timed along the path's own arc
_NEVER = 10.0  # m: clearances above this are not told apart


@dataclass(frozen=True)
class LimitUse:
    """How much of a joint limit the motion uses, where it uses most.

    Attributes
    ----------
    ratio: 1 at the limit. For position: 1 plus the excess [rad or m] where outside.
    joint: name of the joint.
    time: when [s].
    """

    ratio: float
    joint: str
    time: float

    @property
    def kept(self) -> bool:
        """Whether the limit holds."""
        return self.ratio <= 1.0 + _LIMIT_TOLERANCE


@dataclass(frozen=True)
class LoadUse(LimitUse):
    """How much of a limit of what drives the machine the motion uses, where it uses most.

    Torques belong to a smooth motion through the samples, whose accelerations are known
    to the second order of the time between them: 1 % is allowed.

    Attributes
    ----------
    kind: ``torque``, ``rod speed``, ``pump flow``, or ``engine power``; of the last two
        `joint` is empty.
    needed, available: the torque [N m or N], joint velocity [rad/s or m/s], flow [m^3/s]
        or power [W].
    at_rest: what of `ratio` it would take to stand there; 0 for all but torque.
    """

    kind: str
    needed: float
    available: float
    at_rest: float

    @property
    def kept(self) -> bool:
        """Whether the limit holds."""
        return self.ratio <= 1.0 + DRIVEN_WITHIN


@dataclass(frozen=True)
class SpeedUse:
    """The tip's speed on the followed parts of a path, where it is greatest.

    Attributes
    ----------
    ratio: over the asked speed; 3 % more is allowed.
    greatest, asked: [m/s]
    time: when [s].
    """

    ratio: float
    greatest: float
    asked: float
    time: float

    @property
    def kept(self) -> bool:
        """Whether the tip is no faster than asked."""
        return self.ratio <= 1.0 + SPEED_WITHIN


@dataclass(frozen=True)
class Certificate:
    """What was proven of a motion.

    Attributes
    ----------
    min_clearance: the tightest, by margin; None where nothing can be touched.
    clearances: for every obstacle that comes near, and for the machine itself, the tightest
        spot of the whole motion, with the proven lower bound of its distance and when it was
        found; tightest margin first.
    position, velocity, acceleration: use of the joint limits.
    effort: use of the joints' torques; None for a machine whose torques are not limited.
    hydraulics: use of rod speeds, pump flow and engine power; None for a machine without
        a hydraulic description.
    tracking: how the tip keeps to its task.
    tip_speed: use of the asked speed; None where none is asked.
    problems: what is not as it must be, in words; empty where verified.
    """

    min_clearance: Obstruction | None
    clearances: tuple[Obstruction, ...]
    position: LimitUse
    velocity: LimitUse
    acceleration: LimitUse
    effort: LoadUse | None
    hydraulics: LoadUse | None
    tracking: Tracking
    tip_speed: SpeedUse | None
    problems: tuple[str, ...]

    @property
    def verified(self) -> bool:
        """Whether every clearance and limit holds and the task is done."""
        return not self.problems

    @property
    def safe(self) -> bool:
        """Whether every clearance and limit holds, be the task done or not."""
        tightest = self.min_clearance
        return (tightest is None or tightest.margin >= -KEPT_WITHIN) and self.limits_kept

    @property
    def limits_kept(self) -> bool:
        """Whether every limit of the machine holds."""
        return all(
            use is None or use.kept
            for use in (self.position, self.velocity, self.acceleration, self.effort, self.hydraulics)
        )

    @property
    def detours(self) -> tuple[Detour, ...]:
        """The parts of the motion that leave the specified path."""
        return self.tracking.detours


def certify(robot: Robot, scene: Scene, trajectory: Trajectory) -> Certificate:
    """Prove what holds over the whole of a motion.

    Raises
    ------
    SceneError, RobotError: the scene does not fit the machine.
    InputError: the trajectory has another number of joints.
    """
    return certify_problem(build_problem(robot, scene), trajectory)


def certify_problem(problem: Problem, trajectory: Trajectory) -> Certificate:
    """The same, where machine and scene have already been brought together."""
    problem.robot.check_q(trajectory.q[0], what="trajectory.q")
    clearances = _clearances(problem, trajectory)
    position, velocity, acceleration = _limit_use(problem, trajectory)
    effort, hydraulics = _load_use(problem, trajectory)
    kinematics = Kinematics(problem.robot)
    reach = tip_travel_bound(problem.robot)
    if problem.path is not None:
        assert problem.scene.task.path is not None
        tracking = track_path(problem.path, problem.scene.task.path.tolerance, trajectory, kinematics, reach)
    else:
        assert problem.goal is not None
        tracking = track_goal(problem.goal, trajectory, kinematics)
    tip_speed = _speed_use(problem, tracking)
    tightest = clearances[0] if clearances else None
    return Certificate(
        min_clearance=tightest,
        clearances=clearances,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        effort=effort,
        hydraulics=hydraulics,
        tracking=tracking,
        tip_speed=tip_speed,
        problems=tuple(
            _problems(problem, trajectory, tightest, (position, velocity, acceleration), tracking, kinematics)
            + [_load_told(use) for use in (effort, hydraulics) if use is not None and not use.kept]
            + ([_speed_told(tip_speed)] if tip_speed is not None and not tip_speed.kept else [])
        ),
    )


def _problems(
    problem: Problem,
    trajectory: Trajectory,
    tightest: Obstruction | None,
    limits: tuple[LimitUse, LimitUse, LimitUse],
    tracking: Tracking,
    kinematics: Kinematics,
) -> list[str]:
    found = []
    if tightest is not None and tightest.margin < -KEPT_WITHIN:
        found.append(
            f"{tightest.link} comes to {tightest.distance:.3f} m of {tightest.name} "
            f"at {tightest.time:.2f} s, {-tightest.margin:.3f} m closer than allowed"
        )
    for kind, use in zip(("position", "velocity", "acceleration"), limits, strict=True):
        if not use.kept:
            if kind == "position":
                slides = problem.robot.prismatic[problem.robot.joint_names.index(use.joint)]
                much = f"{use.ratio - 1.0:.3g} {'m' if slides else 'rad'} outside"
            else:
                much = f"{told_part(use.ratio)} it"
            found.append(f"{use.joint} exceeds its {kind} limit at {use.time:.2f} s ({much})")
    if problem.start_target is not None and max(problem.start_target.distances(kinematics.at(trajectory.q[0]))) > 1e-5:
        found.append("the motion does not begin at the asked start")
    if not np.allclose(trajectory.v, Trajectory.from_steps(trajectory.time, trajectory.q).v, rtol=1e-6, atol=1e-6):
        found.append("the velocities at the samples are not those of the motion")
    if problem.start_q is not None and np.max(np.abs(trajectory.q[0] - problem.start_q)) > 1e-9:
        found.append("the motion does not begin at the asked start")
    path = problem.scene.task.path
    if not tracking.done:
        found.append(tracking.shortfall)
    elif tracking.detours and path is not None and not path.detour:
        longest = max(tracking.detours, key=lambda detour: detour.length)
        found.append(
            f"the tip leaves the path from {longest.path_from:.2f} m to {longest.path_to:.2f} m, "
            f"by up to {longest.max_deviation:.3f} m, and detours are not allowed"
        )
    return found


# --- distances ------------------------------------------------------------------


def _clearances(problem: Problem, trajectory: Trajectory) -> tuple[Obstruction, ...]:
    proximity = Proximity(problem.robot, problem.obstacles)
    if not proximity.pairs:
        return ()
    time, q = _with_appearances(trajectory, proximity)
    owners = np.where(proximity.owner >= 0, proximity.owner, len(proximity.obstacles))
    searches = [_Search(proximity, time, q) for _ in range(len(proximity.obstacles) + 1)]
    least = np.full(len(searches), _NEVER)
    before = np.zeros(0)
    for row in range(len(time)):
        here = proximity.appears_at <= time[row]
        floor = np.where(here, least[owners] + proximity.clearance, -np.inf)
        lower, measured = proximity.lower_bounds(q[row], time=float(time[row]), floor=floor)
        margins = np.where(here, lower - proximity.clearance, np.inf)
        for pair in np.flatnonzero(measured & here):
            searches[owners[pair]].note(float(margins[pair]), float(time[row]), int(pair))
            least[owners[pair]] = searches[owners[pair]].least
        if row:
            travel = np.abs(q[row] - q[row - 1]) @ proximity.travel.T + (time[row] - time[row - 1]) * proximity.speed
            bounds = 0.5 * (before + margins - travel)
            for pair in np.flatnonzero(~(bounds >= _to_prove(least)[owners])):
                searches[owners[pair]].open(float(bounds[pair]), row - 1, int(pair))
        before = margins
    found = [clearance for search in searches if (clearance := search.finish()) is not None]
    return tuple(sorted(found, key=lambda clearance: clearance.margin))


def _to_prove(least: Any) -> Any:
    """The margins that are to be proven where `least` are the least that were measured [m]."""
    return least - np.maximum(RESOLUTION, _RESOLUTION_OF_MARGIN * least)


class _Search:
    """Best-first search for the least margin to one obstacle over a whole motion.

    Attributes
    ----------
    least: the least margin that was measured [m].
    """

    def __init__(self, proximity: Proximity, time: Vector, q: NDArray[np.float64]) -> None:
        self._proximity, self._time, self._q = proximity, time, q
        self.least = _NEVER
        self._where = (0.0, 0)  # moment and pair of the least margin
        # (bound, tie-breaker, segment, pair, from, to): parts 0..1 of a segment
        self._open: list[tuple[float, int, int, int, float, float]] = []
        self._measured = 0

    def note(self, margin: float, moment: float, pair: int) -> None:
        """A margin was measured."""
        if margin < self.least:
            self.least, self._where = margin, (moment, pair)

    def open(self, bound: float, segment: int, pair: int) -> None:
        """On this segment the margin may be as low as `bound`."""
        heapq.heappush(self._open, (bound, len(self._open), segment, pair, 0.0, 1.0))

    def finish(self) -> Obstruction | None:
        """Halve the lowest until nothing can lie below what is to be proven.

        A motion that is refuted anyway, or too long for the effort, is left with the
        lower bound that was reached.
        """
        tie = len(self._open)
        while self._open and self._open[0][0] < _to_prove(self.least):
            if self._measured > (_EFFORT_REFUTED if self.least < -KEPT_WITHIN else _EFFORT):
                break
            _, _, segment, pair, a, b = heapq.heappop(self._open)
            middle = 0.5 * (a + b)
            m_a, m_m, m_b = (self._measure(segment, pair, part) for part in (a, middle, b))
            half = 0.5 * (b - a) * self._travel(segment, pair)
            for start, m_1, m_2 in ((a, m_a, m_m), (middle, m_m, m_b)):
                tie += 1
                bound = 0.5 * (m_1 + m_2 - half)
                heapq.heappush(self._open, (bound, tie, segment, pair, start, start + 0.5 * (b - a)))
        proven = float(_to_prove(self.least))
        if self.least >= _NEVER and not (self._open and self._open[0][0] < proven):
            return None
        if self._open:
            proven = min(proven, self._open[0][0])
        moment, index = self._where
        pair_record = self._proximity.pairs[index]
        return pair_record.at(proven + pair_record.clearance, time=moment)

    def _travel(self, segment: int, pair: int) -> float:
        """How much the distance of a pair can change on a segment [m]."""
        dq, dt = self._q[segment + 1] - self._q[segment], self._time[segment + 1] - self._time[segment]
        return float(np.abs(dq) @ self._proximity.travel[pair] + dt * self._proximity.speed[pair])

    def _measure(self, segment: int, pair: int, part: float) -> float:
        """Margin of a pair at `part` 0..1 of a segment [m]."""
        q = (1.0 - part) * self._q[segment] + part * self._q[segment + 1]
        moment = float((1.0 - part) * self._time[segment] + part * self._time[segment + 1])
        margin = self._proximity.distance_of(pair, q, time=moment) - float(self._proximity.clearance[pair])
        self._measured += 1
        self.note(margin, moment, pair)
        return margin


def _with_appearances(trajectory: Trajectory, proximity: Proximity) -> tuple[Vector, NDArray[np.float64]]:
    """Samples of the motion, and one more at every moment at which an obstacle appears."""
    moments = {float(t) for t in proximity.appears_at if trajectory.time[0] < t < trajectory.time[-1]}
    time = np.unique(np.concatenate((trajectory.time, sorted(moments))))
    if len(time) == len(trajectory.time):
        return trajectory.time, trajectory.q
    return time, trajectory.at(time)


def segment_is_clear(
    proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0, dt: float = 0.0, depth: int = 6,
    spare: float = 0.0,
) -> bool:  # fmt: skip
    """Whether every clearance provably holds on one segment.

    Parameters
    ----------
    q_a, q_b: (n,) its ends; the joints move linearly between them.
    time, dt: when it begins, and how long it takes [s].
    depth: how often it may be halved.
    spare: to be kept beyond every clearance [m]; less than 0 allows as much less.
    """
    if spare <= 0.0 and proximity.is_at(q_a, time=time) and proximity.stays_clear(q_b, time=time + dt):
        return True
    travel = np.abs(q_b - q_a) @ proximity.travel.T + dt * proximity.speed
    least = proximity.clearance + spare
    floor = least + travel
    present = proximity.appears_at <= time + dt
    d_a, _ = proximity.lower_bounds(q_a, time=time, floor=floor)
    d_b, _ = proximity.lower_bounds(q_b, time=time + dt, floor=floor)
    bound = 0.5 * (d_a + d_b - travel)
    undecided = present & (bound < least)
    if not np.any(undecided):
        return True
    if np.any(present & ((d_a < least) | (d_b < least))) or depth == 0:
        return False
    middle = 0.5 * (q_a + q_b)
    return segment_is_clear(
        proximity, q_a, middle, time=time, dt=0.5 * dt, depth=depth - 1, spare=spare
    ) and segment_is_clear(
        proximity, middle, q_b, time=time + 0.5 * dt, dt=0.5 * dt, depth=depth - 1, spare=spare
    )  # fmt: skip


def path_segment_is_clear(proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0) -> bool:
    """The same for a segment along a bucket path, which may run at exactly its clearance: to within `TOUCH`."""
    return segment_is_clear(proximity, q_a, q_b, time=time, depth=_TOUCHING_DEPTH, spare=-TOUCH)


# --- joint limits -----------------------------------------------------------------


def _limit_use(problem: Problem, trajectory: Trajectory) -> tuple[LimitUse, LimitUse, LimitUse]:
    limits = problem.limits
    names = problem.robot.joint_names
    with np.errstate(invalid="ignore"):  # continuous joints have infinite limits
        middle = 0.5 * (limits.lower + limits.upper)
        half = 0.5 * (limits.upper - limits.lower)
        used = np.where(np.isfinite(half), np.abs(trajectory.q - middle) / half, 0.0)
    excess = np.maximum(trajectory.q - limits.upper, limits.lower - trajectory.q)
    used = np.where(excess > 0.0, 1.0 + excess, np.minimum(used, 1.0))
    velocity = np.abs(trajectory.segment_velocities()) / limits.velocity
    acceleration = np.abs(trajectory.accelerations()) / limits.acceleration

    def worst(ratios: NDArray[np.float64]) -> LimitUse:
        if ratios.size == 0:
            return LimitUse(0.0, names[0], 0.0)
        row, joint = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
        return LimitUse(float(ratios[row, joint]), names[int(joint)], float(trajectory.time[row]))

    return worst(used), worst(velocity), worst(acceleration)


# --- what drives the machine --------------------------------------------------------


def _load_use(problem: Problem, trajectory: Trajectory) -> tuple[LoadUse | None, LoadUse | None]:
    drive = drive_of(problem)
    if not drive.limited:
        return None, None
    names = problem.robot.joint_names
    time, q, v, a = trajectory.time, trajectory.q, trajectory.v, trajectory.accelerations()
    effort, speeds = use_of_drive(trajectory, drive)
    between = between_samples(trajectory)
    if len(between.time):
        time, q, v = np.append(time, between.time), np.vstack((q, between.q)), np.vstack((v, between.v))
        a = np.vstack((a, np.zeros_like(between.q)))
        more_effort, more_speeds = drive.use_between(between)
        effort, speeds = np.vstack((effort, more_effort)), np.vstack((speeds, more_speeds))
    row, joint = (int(index) for index in np.unravel_index(int(np.argmax(effort)), effort.shape))
    here, still = q[row : row + 1], np.zeros((1, problem.robot.n))
    torque = drive.rigid_torques(here, v[row : row + 1], a[row : row + 1]) + drive.soil_torques(here, v[row : row + 1])
    needed = float(torque[0, joint])
    limits = drive.torque_limits(here)
    used = LoadUse(
        ratio=float(effort[row, joint]),
        joint=names[joint],
        time=float(time[row]),
        kind="torque",
        needed=needed,
        available=_finite((limits.positive if needed > 0.0 else limits.negative)[0, joint]),
        at_rest=float(drive.effort_use(here, drive.rigid_torques(here, still, still))[0, joint]),
    )
    if drive.hydraulics is None:
        return used, None
    row, column = (int(index) for index in np.unravel_index(int(np.argmax(speeds)), speeds.shape))
    ratio = float(speeds[row, column])
    kinds = [*("rod speed" for _ in names), "pump flow", "engine power"]
    at = drive.hydraulics.velocity_limits(q[row])
    rods = at.positive if column >= len(names) or v[row, column] > 0.0 else at.negative
    available = _finite([*rods, drive.hydraulics.pump_flow, drive.hydraulics.power_limit][column])
    return used, LoadUse(
        ratio=ratio,
        joint=names[column] if column < len(names) else "",
        time=float(time[row]),
        kind=kinds[column],
        needed=ratio * available,
        available=available,
        at_rest=0.0,
    )


def _finite(value: float) -> float:
    """Without a limit, 0: nothing of it is used."""
    return float(value) if np.isfinite(value) else 0.0


def _speed_use(problem: Problem, tracking: Tracking) -> SpeedUse | None:
    path = problem.scene.task.path
    if path is None or path.speed is None:
        return None
    return SpeedUse(tracking.max_speed / path.speed, tracking.max_speed, path.speed, tracking.max_speed_time)


def _speed_told(use: SpeedUse) -> str:
    return (
        f"the tip moves along the path at {use.greatest:.3g} m/s at {use.time:.2f} s, "
        f"{told_part(use.ratio)} the asked {use.asked:.3g} m/s"
    )


def told_part(ratio: float) -> str:
    """How much of a limit, in words: ``149 % of``, ``12 times``, ``more than 1000 times``."""
    if ratio < 10.0:
        return f"{100.0 * ratio:.{2 if ratio < 1.1 else 0}f} % of"
    return f"{ratio:.0f} times" if ratio < 1000.0 else "more than 1000 times"


def _load_told(use: LoadUse) -> str:
    """A limit that is not kept, in words."""
    when = f"at {use.time:.2f} s"
    if use.kind == "torque":
        figures = f"{abs(use.needed) / 1e3:.3g} kN m of {use.available / 1e3:.3g} kN m ({told_part(use.ratio)} it)"
        what = "cannot hold the load" if use.at_rest > 1.0 else "has too little torque for the motion"
        return f"{use.joint} {what} {when}: it takes {figures}"
    if use.kind == "rod speed":
        return f"{use.joint} asks its cylinders for {told_part(use.ratio)} their greatest speed {when}"
    return f"the motion asks for {told_part(use.ratio)} the {use.kind} {when}"
