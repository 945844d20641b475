"""The planner and RoboPlan on problems for the Panda: success, processor time and duration of the motion.

RoboPlan is a C++ planner on the same Pinocchio and coal (https://github.com/open-planning/roboplan). It is not
among this project's dependencies: ``pip install roboplan``. Its own chain is used as in its examples: inverse
kinematics with a collision check, RRT-Connect, shortcuts, TOPP-RA. The machine is loaded for both beforehand;
building the site counts for both. Their requirements differ: RoboPlan checks for contacts at steps of 0.05 rad,
this planner proves the scene's clearance between all samples.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.site import Box, Capsule
from validation.campaigns import call_for_all
from validation.goal_runs import Settings, name_of, with_objective
from validation.habitats import load_machine
from validation.sites import Site, SiteKey
from validation.tables import Row as TableRow
from validation.tables import markdown, percent

_GROUP = "arm"
_SHARE = "example-robot-data"  # the package folder with the meshes
_NODES = 20_000  # of RoboPlan's tree; its default of 1,000 leaves more cages unsolved
_IK_TRIES = 40  # of RoboPlan's inverse kinematics, each with its own restarts
_PART = 0.02  # s between the samples of its motions


@dataclass(frozen=True)
class Run:
    """The result of one planner on one problem.

    Attributes
    ----------
    kind: of the problem.
    planner: ``ours`` or ``RoboPlan``.
    seconds: of processor time [s].
    duration: of the motion [s]; None if there is none.
    proven: whether the certificate holds for it.
    """

    name: str
    kind: str
    planner: str
    seconds: float
    duration: float | None
    proven: bool


def compare_on_site(key: SiteKey, settings: Settings, draw: Callable[[bp.Robot, SiteKey], Site]) -> list[Run]:
    """Plan one problem with both planners, one after the other on the same core."""
    robot = load_machine(key.machine)
    scene = with_objective(draw(robot, key).scene, "time")
    name, seed = name_of(key, "time"), settings.planning_seeds[0]
    begun = time.process_time()
    plan = bp.plan(robot, scene, seed=seed, effort=settings.effort)
    took = time.process_time() - begun
    runs = [Run(name, key.kind, "ours", took, plan.metrics.duration if plan.verified else None, plan.verified)]
    theirs = _loaded(key.machine)  # before timing starts
    begun = time.process_time()
    motion = _plan(theirs, robot, scene, seed=seed)
    took = time.process_time() - begun
    proven = motion is not None and bp.certify(robot, scene, motion).verified
    return [*runs, Run(name, key.kind, "RoboPlan", took, None if motion is None else motion.duration, proven)]


def compare(
    keys: Sequence[SiteKey],
    settings: Settings,
    *,
    draw: Callable[[bp.Robot, SiteKey], Site],
    jobs: int,
    folder: Path | None = None,
    watch: Callable[[int, object], object] = lambda done, result: None,
) -> tuple[list[Run], bool]:
    """The runs on all problems, and whether the campaign was interrupted; see `call_for_all`."""
    call = partial(compare_on_site, settings=settings, draw=draw)
    found, interrupted = call_for_all(call, keys, result=list[Run], jobs=jobs, folder=folder, watch=watch)
    return [run for runs in found for run in runs], interrupted


def table(runs: Sequence[Run]) -> str:
    """A line for every kind of problem and planner, as text."""
    kinds = dict.fromkeys((run.kind, run.planner) for run in runs)
    return markdown([_figures(kind, runs) for kind in kinds])


def _figures(kind: tuple[str, str], runs: Sequence[Run]) -> TableRow:
    own = [run for run in runs if (run.kind, run.planner) == kind]
    other = {run.name: run for run in runs if run.kind == kind[0] and run.planner == "RoboPlan"}
    seconds = [run.seconds for run in own]
    longer = [
        run.duration / other[run.name].duration  # type: ignore[operator]
        for run in own
        if run.duration is not None and other[run.name].duration is not None
    ]
    return {
        "problem": kind[0],
        "planner": kind[1],
        "problems": len(own),
        "found": f"{percent(run.duration is not None for run in own):.0f} %",
        "proven": f"{percent(run.proven for run in own):.0f} %",
        "s: median": float(np.median(seconds)),
        "p90": float(np.quantile(seconds, 0.9)),
        "s / RoboPlan: median": float(np.median([run.seconds / other[run.name].seconds for run in own])),
        "duration / RoboPlan: median": float(np.median(longer)) if longer else np.nan,
    }


@cache
def _loaded(machine: str) -> tuple[Any, Any]:
    """RoboPlan's model of a machine: URDF and folder of meshes; read once per process."""
    import roboplan.core as core

    robot = load_machine(machine)
    path = Path(robot.urdf.path)
    share = next(folder for folder in path.parents if folder.name == _SHARE).parent
    return core, core.loadUrdfSceneDescription(str(path), [str(share)])


def _plan(loaded: tuple[Any, Any], robot: bp.Robot, scene: bp.Scene, *, seed: int) -> bp.Trajectory | None:
    """RoboPlan's motion, timed by TOPP-RA with the same limits; None if it finds none."""
    import roboplan.rrt
    import roboplan.toppra

    core, description = loaded
    site = core.Scene("site", description)
    site.addGroup(_GROUP, list(robot.joint_names))
    _adopt(core, site, robot)
    site.setRngSeed(seed)
    _build(core, site, scene)
    problem = bp.build_problem(robot, scene)
    assert problem.start_q is not None
    start = core.JointConfiguration(list(robot.joint_names), problem.start_q)
    full = site.toFullJointPositions(_GROUP, problem.start_q)
    site.setJointPositions(full)
    goal = _goal(core, site, problem, start, seed)
    if goal is None:
        return None
    options = roboplan.rrt.RRTOptions(group_name=_GROUP, max_nodes=_NODES, rrt_connect=True)
    planner = roboplan.rrt.RRT(site, options)
    planner.setRngSeed(seed)
    try:
        path = planner.plan(start, goal)
    except RuntimeError:  # its report of failure
        return None
    path = core.PathShortcutter(site, core.PathShortcuttingOptions(group_name=_GROUP, seed=seed)).shortcut(path)
    timed = roboplan.toppra.PathParameterizerTOPPRA(site, _GROUP)
    found = timed.generate(path, roboplan.toppra.TOPPRAOptions(dt=_PART, mode=roboplan.toppra.SplineFittingMode.Cubic))
    q: Matrix = np.array(found.positions)
    return bp.Trajectory(np.array(found.times), q, np.array(found.velocities))


def _adopt(core: Any, site: Any, robot: bp.Robot) -> None:
    """Give RoboPlan our acceleration limits, and the pairs of links that its authors leave out."""
    limits = {
        name: {"max_acceleration": [float(most)]}
        for name, most in zip(robot.joint_names, robot.limits.acceleration, strict=True)
    }
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump({"joint_limits": limits}, file)
        file.flush()
        site.importJointLimitsFromConfig(core.loadJointLimitsConfig(file.name))
    site.importSrdf(_srdf(robot).read_text(encoding="utf-8"))


def _srdf(robot: bp.Robot) -> Path:
    """The file next to the URDF with the pairs of links that may touch."""
    urdf = robot.urdf.path
    return urdf.parents[1] / "srdf" / f"{urdf.stem}.srdf"


def _goal(core: Any, site: Any, problem: bp.Problem, start: Any, seed: int) -> Any | None:
    import roboplan.simple_ik

    (goal,) = problem.goals
    if goal.q is not None:
        return core.JointConfiguration(list(problem.robot.joint_names), goal.q)
    assert goal.target.rotation is not None
    pose = pin.SE3(goal.target.rotation, goal.target.position).homogeneous
    options = roboplan.simple_ik.SimpleIkOptions(group_name=_GROUP, check_collisions=True)
    solver = roboplan.simple_ik.SimpleIk(site, options)
    wanted = core.CartesianConfiguration(problem.robot.urdf.root, problem.robot.tip, pose)
    solution = core.JointConfiguration()
    for turn in range(_IK_TRIES):
        solver.setRngSeed(seed + turn)
        if solver.solveIk(wanted, start, solution):
            return solution
    return None


def _build(core: Any, site: Any, scene: bp.Scene) -> None:
    """Put the scene's boxes and capsules into RoboPlan's site; a capsule is a cylinder with two balls."""
    grey, world = np.full(4, 0.5), "universe"
    names = [record.name for record in scene.obstacles]
    for record in scene.obstacles:
        if isinstance(record, Box):
            site.addBoxGeometry(record.name, world, core.Box(*record.size), record.placement.homogeneous, grey)
        elif isinstance(record, Capsule):
            ends = np.array([record.start, record.end])
            middle, along = ends.mean(axis=0), ends[1] - ends[0]
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
            pose = pin.SE3(turn, middle).homogeneous
            site.addCylinderGeometry(
                record.name, world, core.Cylinder(record.radius, float(np.linalg.norm(along))), pose, grey
            )
            for number, end in enumerate(ends):
                pose = pin.SE3(np.eye(3), end).homogeneous
                site.addSphereGeometry(f"{record.name} end {number}", world, core.Sphere(record.radius), pose, grey)
            names += [f"{record.name} end {number}" for number in (0, 1)]
        else:
            raise TypeError(f"{record.name}: a {type(record).__name__} is not taken over")
    site.setCollisions(list(combinations(names, 2)), False)  # or it would check them against each other
