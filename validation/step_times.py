"""An obstacle course of the backhoe on which the steps of the law and of the servo are timed.

All times are processor times in microseconds, which other processes do not lengthen. On the
same configurations, the Pinocchio and coal calls alone are timed over all pairs, and a step of
Pink with its collision barrier on the same model and pairs, if Pink is installed
(pip install pin-pink "qpsolvers[daqp]").
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.law import CompletedLaw
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Stepper
from validation.obstacles import course_obstacle, name_all
from validation.scenes import scene_of

Times = NDArray[np.float64]

START = np.array([0.0, 0.4, -1.6, -0.9])
WHOLE = "whole step"
SPARE = 0.05  # m beyond every clearance that the start keeps
_NOT_AT_HAND = 5  # steps after other work, with code and data not in the cache: the first takes 2 to 7 times, measured


@contextmanager
def collecting_only_new() -> Iterator[None]:
    """Let Python collect only garbage made within, as a program in real time does.

    Afterwards it collects all again; otherwise objects of OMPL would be left when Python ends, and OMPL lists them.
    If something was frozen before, it stays frozen with everything made until then.
    """
    kept_before = gc.get_freeze_count() > 0
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        if not kept_before:
            gc.unfreeze()


def obstacle_course(robot: bp.Robot, count: int, rng: np.random.Generator) -> Problem:
    """The backhoe among `count` obstacles in its reach, without contact at the start."""
    while True:
        obstacles = name_all([course_obstacle(index, rng) for index in range(count)])
        problem = build_problem(robot, scene_of(robot, obstacles, start=START))
        proximity = bp.Proximity(robot, problem.obstacles)
        if np.all(proximity.distances(START) > proximity.clearance + SPARE):
            return problem


@dataclass(frozen=True)
class StepTimes:
    """The times of some steps.

    Attributes
    ----------
    times: (steps,) of every part and, last, of the whole step.
    configurations: (n,) some of those passed.
    rows: mean number of nearby pairs in a step.
    """

    times: dict[str, Times]
    configurations: list[Vector]
    rows: float = float("nan")

    @property
    def whole(self) -> Times:
        """(steps,) processor times of the whole step."""
        return self.times[WHOLE]


class LawDrive:
    """The law's steps from one random goal of the tip to the next.

    If no step is clear, not even braking, a motion ends, and the next one begins at the problem's start.

    Attributes
    ----------
    ended: number of motions that ended so.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self._proximity, self._kinematics = bp.Proximity(problem.robot, problem.obstacles), bp.Kinematics(problem.robot)
        self._law = CompletedLaw(problem.robot, influence=problem.scene.influence)
        self._problem, self._rng, self._count, self._goal = problem, rng, 0, np.zeros(3)
        self._stepper = self._begin()
        self.ended = 0

    def _begin(self) -> Stepper:
        assert self._problem.start_q is not None
        return Stepper(self._problem, self._problem.start_q, proximity=self._proximity, kinematics=self._kinematics)

    def take(self, steps: int) -> StepTimes:
        """Take some steps and time their parts."""
        times, configurations, rows = np.empty((steps, 4)), [], 0
        for taken in times:
            stepper = self._stepper
            if self._count % 200 == 0:
                self._goal = self._kinematics.at(self._problem.robot.random_q(self._rng)).tip_position
            self._count += 1
            begun = time.thread_time()
            at, nearby = stepper.look()
            looked = time.thread_time()
            error = self._goal - at.tip_position
            size = float(np.linalg.norm(error))
            J = at.jacobian[:3]
            primary, null = self._law.terms_unchecked(at, J, error * min(1.0, 0.6 / max(size, 1e-9)), nearby)
            wished = time.thread_time()
            moved = stepper.advance(primary + null, nearby, J)
            done = time.thread_time()
            taken[:] = looked - begun, wished - looked, done - wished, done - begun
            configurations.append(stepper.q)
            rows += len(nearby)
            if not moved:
                self._stepper = self._begin()
                self.ended += 1
        names = ("proximity and kinematics", "law", "shield and proof of the step", WHOLE)
        return StepTimes(dict(zip(names, 1e6 * times.T, strict=True)), configurations, rows / steps)


class ServoDrive:
    """The servo's steps in processor and clock time; every 10th configuration is kept.

    The wish changes every 300 steps between tip and joint velocities. The first `moving`
    obstacles go to and fro.
    """

    def __init__(self, servo: bp.Servo, moving: int, rng: np.random.Generator) -> None:
        self._servo, self._moving, self._rng, self._count = servo, moving, rng, 0
        self._wish: dict[str, Vector] = {}

    def take(self, steps: int) -> StepTimes:
        """Take some steps and time them."""
        times, configurations, servo = np.empty((steps, 2)), [], self._servo
        for taken in times:
            self._choose_motions()
            begun, begun_on_processor = time.perf_counter(), time.thread_time()
            state = servo.step(**self._wish)
            taken[:] = time.perf_counter() - begun, time.thread_time() - begun_on_processor
            if self._count % 10 == 0:
                configurations.append(state.q)
            self._count += 1
        return StepTimes(dict(zip(("clock", WHOLE), 1e6 * times.T, strict=True)), configurations)

    def _choose_motions(self) -> None:
        servo, rng = self._servo, self._rng
        if self._count % 300 == 0:
            if rng.integers(3):
                tip = rng.normal(size=3)
                self._wish = {"tip_velocity": tip * rng.uniform(0.2, 1.0) / np.linalg.norm(tip)}
            else:
                self._wish = {"joint_velocity": rng.uniform(-1.0, 1.0, servo.robot.n) * servo.limits.velocity}
        if self._count % 4000 == 0:
            for name in servo.obstacles[: self._moving]:
                way = servo.shift_of(name)
                direction = rng.normal(size=3) if not way.any() else -way
                servo.set_velocity(name, 0.05 * direction / np.linalg.norm(direction))


class LibraryCalls:
    """The Pinocchio and coal calls alone, all pairs measured."""

    def __init__(self, problem: Problem) -> None:
        self._model, self._data = problem.robot.model, problem.robot.model.createData()
        self._geometry = bp.Proximity(problem.robot, problem.obstacles).geometry

    def take(self, configurations: list[Vector]) -> Times:
        """Time the calls at each configuration (n,)."""
        model, data = self._model, self._data
        geometry_model, geometry = self._geometry
        found = []
        for q in configurations:
            begun = time.thread_time()
            pin.computeJointJacobians(model, data, q)
            pin.updateGeometryPlacements(model, data, geometry_model, geometry)
            pin.computeDistances(geometry_model, geometry)
            found.append(1e6 * (time.thread_time() - begun))
        return np.array(found)


class PinkSteps:
    """Pink's step with a frame task and its collision barrier for some pairs, on the same model.

    Raises
    ------
    ImportError: Pink is not installed.
    """

    def __init__(self, problem: Problem, q: Vector, pairs: int) -> None:
        import pink
        from pink.barriers import SelfCollisionBarrier
        from pink.tasks import FrameTask

        model, tip = problem.robot.model, problem.robot.tip
        geometry_model, geometry = bp.Proximity(problem.robot, problem.obstacles).geometry
        self._solve = pink.solve_ik
        self._configuration = pink.Configuration(
            model, model.createData(), q, collision_model=geometry_model, collision_data=geometry
        )
        self._task = FrameTask(tip, position_cost=1.0, orientation_cost=0.0)
        self._barrier = SelfCollisionBarrier(n_collision_pairs=pairs, gain=20.0, safe_displacement_gain=1.0, d_min=0.05)
        self._task.set_target(self._configuration.get_transform_frame_to_world(tip))

    def take(self, configurations: list[Vector]) -> Times:
        """Time the step at each configuration (n,) at which its problem has a solution."""
        found = []
        for q in configurations:
            begun = time.thread_time()
            self._configuration.update(q)
            try:
                self._solve(self._configuration, [self._task], 0.02, solver="daqp", barriers=[self._barrier])
            except Exception:  # noqa: BLE001  Pink raises where its problem has no solution
                continue
            found.append(1e6 * (time.thread_time() - begun))
        return np.array(found)


class Drive(Protocol):
    """A drive that takes some steps and times them."""

    def take(self, steps: int, /) -> StepTimes:
        """The times of the next steps."""
        ...


@dataclass(frozen=True)
class TimesInTurn:
    """Steps and the library calls alone, in turn, a block of each.

    Attributes
    ----------
    steps: all of them.
    calls: (C,) of the library calls at the steps' configurations.
    ratios: (B,) of each block, the median step over the median of the calls.
    pink: (K,) of Pink's step at the configurations; empty if it is not installed.
    """

    steps: StepTimes
    calls: Times
    ratios: Times
    pink: Times

    @property
    def ratio(self) -> float:
        """The median step over the median of the calls, over all blocks together."""
        return float(np.median(self.steps.whole) / np.median(self.calls))

    def spread(self) -> str:
        """The ratio and the range of the middle half of the blocks' ratios, as text."""
        low, high = np.percentile(self.ratios, [25, 75])
        return f"{self.ratio:.2f} ({low:.2f} to {high:.2f})"


def time_in_turn(problem: Problem, drive: Drive, steps: int, *, block: int = 100, pink: bool = False) -> TimesInTurn:
    """Time steps in turn with the library calls alone, so that other load on the computer slows both.

    The first steps after the calls are not timed; otherwise one step in a hundred would set the 99th percentile.

    Parameters
    ----------
    block: steps after which the calls are timed at configurations of these.
    pink: whether Pink's step is timed at some of them too.
    """
    libraries = LibraryCalls(problem)
    taken, calls, of_pink = [], [], [np.zeros(0)]
    pink_steps = None
    for _ in range(max(steps // block, 1)):
        drive.take(_NOT_AT_HAND)
        part = drive.take(block)
        taken.append(part)
        calls.append(libraries.take(part.configurations))
        if pink and pink_steps is None:
            try:
                pink_steps = PinkSteps(problem, part.configurations[0], max(1, round(part.rows)))
            except ImportError:
                pink = False
        if pink_steps is not None:
            of_pink.append(pink_steps.take(part.configurations[::10]))
    times = {name: np.concatenate([part.times[name] for part in taken]) for name in taken[0].times}
    configurations = [q for part in taken for q in part.configurations]
    whole = StepTimes(times, configurations, float(np.mean([part.rows for part in taken])))
    ratios = [np.median(part.whole) / np.median(alone) for part, alone in zip(taken, calls, strict=True)]
    return TimesInTurn(whole, np.concatenate(calls), np.array(ratios), np.concatenate(of_pink))


def least_of(runs: Sequence[TimesInTurn]) -> TimesInTurn:
    """The least time of each step and of each call, over runs that took the same steps.

    Other load on the computer hardly lengthens the same step in all of them.
    """
    first, blocks = runs[0], len(runs[0].ratios)
    times = {name: np.min([run.steps.times[name] for run in runs], axis=0) for name in first.steps.times}
    calls, pink = (np.min(found, axis=0) for found in ([run.calls for run in runs], [run.pink for run in runs]))
    steps = replace(first.steps, times=times)
    whole, alone = steps.whole.reshape(blocks, -1), calls.reshape(blocks, -1)
    return TimesInTurn(steps, calls, np.median(whole, axis=1) / np.median(alone, axis=1), pink)


def percentiles(times: Times) -> dict[str, float]:
    """The median and the 95th and 99th percentiles."""
    return dict(zip(("median", "p95", "p99"), np.percentile(times, [50, 95, 99]).tolist(), strict=True))
