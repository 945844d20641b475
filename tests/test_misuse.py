"""Arguments of public names: wrong ones raise an `InputError` that names the argument, lists count as arrays.

`calls` has one entry for every public function, constructor and method that takes arguments: how it is
called, with good arguments, and the kind of each argument, from which the bad values follow.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import as_number
from backhoe_planner.errors import InputError
from backhoe_planner.files.records import Record
from backhoe_planner.live import plan_from_recording
from backhoe_planner.machine.shape import shapes

NAN, INF, OBJECT = float("nan"), float("inf"), object()

# --- the machine and the site ---------------------------------------------------------


@cache
def robot() -> bp.Robot:
    return bp.load_robot("example:backhoe")


@cache
def scene() -> bp.Scene:
    joints = dict(zip(robot().joint_names, [0.0, 0.4, -1.6, -0.9], strict=True))
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": joints},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "obstacles": [{"name": "rock", "shape": "sphere", "radius": 0.3, "position": [4.0, 2.0, 1.0]}],
            "zones": [{"name": "line", "kind": "ceiling", "height": 4.0, "stop": 0.5, "slow": 0.8, "warn": 1.0}],
        }
    )


Q = np.array([0.0, 0.4, -1.6, -0.9])
V = np.array([0.1, -0.1, 0.05, 0.0])


@cache
def motion() -> bp.Trajectory:
    return bp.Trajectory.from_steps(np.linspace(0.0, 2.0, 5), Q + np.linspace(0.0, 0.05, 5)[:, None])


@cache
def path() -> bp.TipPath:
    return bp.TipPath([bp.Waypoint(position=(3.0, 0.0, 0.0)), bp.Waypoint(position=(5.0, 0.0, 0.0))])


@cache
def proximity() -> bp.Proximity:
    return bp.Proximity(robot(), bp.build_obstacles(scene(), robot()))


@cache
def at() -> bp.Configuration:
    return bp.Kinematics(robot()).at(Q)


@cache
def law() -> bp.CompletedLaw:
    return bp.CompletedLaw(robot(), influence=0.6)


@cache
def nearby() -> bp.Nearby:
    return proximity().at(Q, margin=5.0)


@cache
def keep() -> bp.Keep:
    content = scene().to_dict()
    found = bp.build_problem(
        robot(), bp.scene_from_dict(content | {"task": content["task"] | {"keep": {"above": -9.0}}})
    )
    assert found.keep is not None
    return found.keep


@cache
def hydraulics() -> bp.Hydraulics:
    found = robot().hydraulics
    assert found is not None
    return found


@cache
def servo() -> bp.Servo:
    return bp.Servo(robot(), scene())


def limits() -> bp.JointLimits:
    return robot().limits


# --- kinds of arguments ----------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """Values that an argument must refuse."""

    bad: tuple[Any, ...]


NO_NUMBER: tuple[Any, ...] = (None, "text", {"a": 1}, OBJECT, [])


def vector(n: int) -> Kind:
    """n finite numbers."""
    good = [0.1] * n
    return Kind(
        (*NO_NUMBER, [*good, 0.1], good[:-1], [[0.1] * n], [*good[:-1], NAN], np.full(n, INF), ["1"] * n, [good])
    )


ROWS = Kind((None, "text", {"a": 1}, OBJECT, [], [0.1], [[0.1] * 4, [0.1] * 3], [NAN] * 4, np.full((2, 4), NAN), 3.0))
GRID = Kind((None, "text", {"a": 1}, OBJECT, [], [0.1], np.full((5, 5), NAN), 3.0))
MATRIX = Kind((None, "text", {"a": 1}, OBJECT, [], [0.1], np.full((3, 4), NAN), np.zeros((3, 7)), 3.0))
SAMPLES = Kind((None, "text", {"a": 1}, OBJECT, [], [0.1], np.full((3, 4), NAN), np.zeros((2, 4)), 3.0))
NUMBER = Kind((*NO_NUMBER, NAN, [0.1, 0.2], "0.3", True, 10**400))
POSITIVE = Kind((*NUMBER.bad, -1.0, 0.0))
LIMIT = Kind((*NO_NUMBER, [0.1], [[0.1] * 4], [NAN] * 4))  # may be infinite
POSITIVE_LIMIT = Kind((*LIMIT.bad, [-1.0] * 4))
COUNT = Kind((*NO_NUMBER, NAN, -1, 0.5, "3", True))
FLAG = Kind((None, "yes", {"a": 1}, OBJECT, [], NAN, 2))
TEXT = Kind((None, {"a": 1}, OBJECT, [], 3.0, "no such name"))
PATH = Kind((None, {"a": 1}, OBJECT, [], 3.0, "no/such/file", "a\0b", ""))
HOLD = ({"no": 0.1}, {"boom": None}, {"boom": "0.1"}, {"boom": NAN}, {"boom": 9.0}, {3: 0.1}, OBJECT, 3.0)
THING = Kind((None, "text", {"a": 1}, OBJECT, [], 3.0, np.zeros(4)))  # an object of a class of this package


def optional(kind: Kind) -> Kind:
    return Kind(tuple(value for value in kind.bad if value is not None))


def only(*bad: Any) -> Kind:
    return Kind(bad)


@dataclass(frozen=True)
class Call:
    """How something is called: good arguments, and the kind of each."""

    function: Callable[..., Any]
    good: dict[str, Any]
    kinds: dict[str, Kind]
    lists: bool = True  # whether results for arrays and lists are compared


def call(function: Callable[..., Any], *, lists: bool = True, **arguments: Any) -> Call:
    """Each argument is a pair: a good value and its kind."""
    good = {name: value for name, (value, _) in arguments.items()}
    return Call(function, good, {name: kind for name, (_, kind) in arguments.items()}, lists)


@cache
def calls() -> dict[str, Call]:
    the = robot()
    frame: dict[str, Any] = {
        "low": (np.zeros(2), vector(2)),
        "high": (np.full(2, 2.0), vector(2)),
        "cell": (0.5, POSITIVE),
    }
    target = bp.TipTarget(np.array([4.0, 0.0, 0.5]), pitch=(-1.0, -0.5))
    J, xdot = at().jacobian[:3], np.array([0.1, 0.0, -0.05])
    prox, oil, shield = proximity(), hydraulics(), bp.Shield(the.limits)
    count = len(oil.cylinders)
    stepped = np.stack([Q, Q + 0.01, Q + 0.02])
    q4, v4, t3 = (Q, vector(4)), (V, vector(4)), (np.linspace(0.0, 1.0, 3), vector(3))
    rq, rv, rtau = (Q, ROWS), (V, ROWS), (1e3 * V, ROWS)
    site: dict[str, Any] = {"robot": (the, THING), "scene": (scene(), THING)}
    index = only(None, "text", {}, OBJECT, [], -1, 10**6, 0.5)
    indices = only(None, "text", {"a": 1}, OBJECT, [[0]], [-1], [10**6], [0.5])
    rows: dict[str, Any] = {
        "at": (at(), THING),
        "J_e": (J, MATRIX),
        "xdot_e": (xdot, vector(3)),
        "nearby": (nearby(), THING),
    }
    return {
        # functions
        "load_robot": call(
            bp.load_robot, source=("example:backhoe", PATH), tip=("bucket_tip", optional(TEXT)),
            hold=({"boom": 0.1}, only(*HOLD, [], "text")), hydraulics=(hydraulics().file, optional(PATH)), lists=False,
        ),
        "digging_forces": call(bp.digging_forces, robot=(the, THING)),
        "solve_inverse_kinematics": call(
            bp.solve_inverse_kinematics, robot=(the, THING), target=(target, THING), start=(Q, optional(vector(4))),
            rng=(np.random.default_rng(0), optional(THING)), attempts=(3, Kind((*COUNT.bad, 0))),
            tolerance=(1e-6, POSITIVE), lists=False,
        ),
        "build_problem": call(bp.build_problem, lists=False, **site),
        "build_obstacles": call(bp.build_obstacles, lists=False, **site),
        "certify": call(bp.certify, lists=False, **site, trajectory=(motion(), THING)),
        "zone_log": call(bp.zone_log, **site, trajectory=(motion(), THING)),
        "load_scene": call(bp.load_scene, path=("trench.yaml", PATH), lists=False),
        "load_plan": call(bp.load_plan, path=("no/such/plan", PATH), urdf=("a.urdf", optional(PATH)), lists=False),
        "scene_from_dict": call(
            bp.scene_from_dict, content=(scene().to_dict(), THING), folder=(".", only(None, {}, OBJECT, [], 3.0)),
            file=("a.yaml", only({}, OBJECT, [], 3.0)), lists=False,
        ),
        "plan": call(
            bp.plan, **site, method=("reactive", TEXT), seed=(0, COUNT), effort=("quick", TEXT),
            budget=(9.0, optional(Kind((*POSITIVE.bad, INF)))), watch=(print, only("text", {"a": 1}, OBJECT, [], 3.0)),
            lists=False,
        ),
        # the machine
        "JointLimits": call(
            lambda **keys: bp.JointLimits(**keys).upper,
            lower=(-np.ones(4), only(*NO_NUMBER[:-1], [[0.1]], [NAN])), upper=(np.ones(4), LIMIT),
            velocity=(np.ones(4), POSITIVE_LIMIT), acceleration=(np.ones(4), POSITIVE_LIMIT),
            effort=(np.full(4, INF), POSITIVE_LIMIT),
        ),
        "Robot.random_q": call(the.random_q, rng=(np.random.default_rng(0), THING), lists=False),
        "Robot.with_tip": call(the.with_tip, tip=("bucket_tip", optional(TEXT)), lists=False),
        "Robot.with_hold": call(the.with_hold, hold=({"boom": 0.1}, only(*HOLD, None, [], "text")), lists=False),
        "Robot.with_base": call(the.with_base, base=(bp.Base((1.0, 2.0)), THING), lists=False),
        "Robot.carrying": call(
            lambda **keys: the.carrying(**keys).link_names, lists=False,
            name=("pipe", only(None, {"a": 1}, OBJECT, [], 3.0, "bucket")),
            pieces=((shapes.sphere(0.3, pin.SE3.Identity()),), only(None, "text", OBJECT, 3.0, [3.0])),
        ),
        "Robot.pieces_of": call(the.pieces_of, links=(("bucket",), only(3.0, OBJECT)), lists=False),
        "Robot.check_q": call(lambda q: the.check_q(q), q=q4),
        "Kinematics": call(bp.Kinematics, robot=(the, THING), lists=False),
        "Kinematics.at": call(lambda q: bp.Kinematics(the).at(q).J_world, q=q4),
        "Base": call(bp.Base, position=((1.0, 2.0), vector(2)), heading=(0.5, NUMBER)),
        "TipTarget": call(
            lambda **keys: bp.TipTarget(**keys).distances(at()), position=(np.ones(3), vector(3)),
            pitch=((0.1, 0.2), optional(vector(2))), rotation=(np.eye(3), optional(MATRIX)),
            rotation_tolerance=(0.1, Kind((*NUMBER.bad, -1.0))), position_tolerance=(0.1, Kind((*NUMBER.bad, -1.0))),
            tilt=(bp.Tilt(np.ones(3), np.ones(3)), optional(THING)),
        ),
        "Tilt": call(
            lambda **keys: bp.Tilt(**keys).tolerance, axis=(np.ones(3), vector(3)), direction=(np.ones(3), vector(3)),
            tolerance=(0.1, Kind((*NUMBER.bad, -1.0, 4.0))),
        ),
        "Goal": call(
            lambda **keys: bp.Goal(**keys).error(at()), target=(target, THING), q=(Q, optional(vector(4))),
            name=("goal", only(None, {"a": 1}, OBJECT, [], 3.0)), rotation_tolerance=(0.1, optional(POSITIVE)),
            tolerance=(0.1, optional(POSITIVE)),
        ),
        "Keep": call(
            lambda **keys: len(bp.Keep(**keys).conditions), robot=(the, THING), conditions=(keep().conditions, THING),
            lists=False,
        ),
        "Keep.margins": call(keep().margins, q=q4),
        "Keep.gradients": call(keep().gradients, q=q4),
        "Keep.holds": call(keep().holds, q=q4),
        "Keep.holds_each": call(keep().holds_each, q=(stepped, Kind(SAMPLES.bad[:-2]))),
        "Keep.broken": call(keep().broken, q=q4),
        "Keep.rows_each": call(keep().rows_each, q=(stepped, Kind(SAMPLES.bad[:-2]))),
        "Keep.facets_each": call(keep().facets_each, q=(stepped, Kind(SAMPLES.bad[:-2]))),
        "Keep.with_wider_cones": call(
            lambda least: len(keep().with_wider_cones(least).conditions), least=(0.01, Kind((*NUMBER.bad, -0.1, 4.0)))
        ),
        "Keep.segment_holds": call(keep().segment_holds, q_a=q4, q_b=q4),
        "Keep.motion_holds": call(keep().motion_holds, q=(stepped, Kind(SAMPLES.bad[:-2]))),
        "Keep.corner_holds": call(keep().corner_holds, q_a=q4, corner=q4, q_b=q4, sagitta=q4),
        "Keep.with_narrower_cone": call(lambda by: keep().with_narrower_cone(by), by=(0.01, Kind((*NUMBER.bad, -0.1)))),
        "Keep.widened": call(lambda q: len(keep().widened(q).conditions), q=q4),
        "Keep.project": call(
            keep().project, q=q4, lower=(the.limits.lower, vector(4)), upper=(the.limits.upper, vector(4))
        ),
        "Keep.narrowed": call(keep().narrowed, target=(target, THING), lists=False),
        "Goal.error": call(bp.Goal(target).error, at=(at(), THING)),
        "Goal.jacobian": call(bp.Goal(target, q=Q).jacobian, at=(at(), THING)),
        "Goal.distances": call(bp.Goal(target).distances, at=(at(), THING)),
        "Goal.shortfall": call(bp.Goal(target).shortfall, at=(at(), THING), lists=False),
        "TipTarget.pitch_excess": call(target.pitch_excess, pitch=(0.3, NUMBER)),
        "TipTarget.error": call(target.error, at=(at(), THING)),
        "TipTarget.jacobian": call(target.jacobian, at=(at(), THING)),
        "TipTarget.distances": call(target.distances, at=(at(), THING)),
        "TipTarget.turn_to": call(target.turn_to, other=(target, THING)),
        "Hydraulics.lengths": call(oil.lengths, q=rq),
        "Hydraulics.moment_arms": call(oil.moment_arms, q=rq),
        "Hydraulics.arm_slopes": call(oil.arm_slopes, q=rq),
        "Hydraulics.arms": call(oil.arms, q=rq),
        "Hydraulics.joints": call(
            oil.joints, lengths=(oil.lengths(Q), only(None, "text", {}, OBJECT, [], [0.1] * (count + 1), 3.0))
        ),
        "Hydraulics.joint_range": call(oil.joint_range, joint=("boom", TEXT)),
        "Hydraulics.rod_speeds": call(oil.rod_speeds, q=rq, v=rv),
        "Hydraulics.flows": call(oil.flows, q=rq, v=rv),
        "Hydraulics.total_flow": call(oil.total_flow, q=rq, v=rv),
        "Hydraulics.velocity_limits": call(oil.velocity_limits, q=rq),
        "Hydraulics.velocity_limit_slopes": call(oil.velocity_limit_slopes, q=rq),
        "Hydraulics.flow_slopes": call(oil.flow_slopes, q=rq, v=rv),
        "Hydraulics.torque_limit_slopes": call(oil.torque_limit_slopes, q=rq),
        "Hydraulics.joint_torques": call(
            oil.joint_torques, q=rq, force=(np.full(count, 1e3), only(*NO_NUMBER, [0.1] * (count + 1), 3.0))
        ),
        "Hydraulics.cylinder_forces": call(oil.cylinder_forces, q=rq, tau=rtau),
        "Hydraulics.pressures": call(oil.pressures, q=rq, tau=rtau),
        "Hydraulics.torque_limits": call(oil.torque_limits, q=rq),
        "Hydraulics.power": call(oil.power, q=rq, v=rv, tau=rtau),
        "Hydraulics.load_sensing_power": call(oil.load_sensing_power, q=rq, v=rv, tau=rtau),
        # motions
        "Trajectory": call(
            lambda **keys: bp.Trajectory(**keys).accelerations(), time=t3, q=(stepped, SAMPLES),
            v=(0 * stepped, SAMPLES), begins=((0, 1), only(None, 3.0, [0.5], [1], [0, 9], [0, 2, 1])),
            before=(None, only("text", 3.0)), after=(None, only("text", 3.0)),
        ),
        "Trajectory.from_steps": call(
            lambda **keys: bp.Trajectory.from_steps(**keys).v, time=(t3[0], Kind((*t3[1].bad, [0.0, 1.0, 0.5]))),
            q=(stepped, SAMPLES), begins=((0, 1), only(None, 3.0, [0.5], [1], [0, 9], [0, 2, 1])),
        ),
        "Trajectory.part": call(
            lambda **keys: motion().part(**keys).q, first=(1, index), last=(3, Kind((*index.bad, 0))), lists=False
        ),
        "Trajectory.at": call(motion().at, time=(np.array([0.3, 0.7]), only(None, "text", {}, OBJECT, NAN, [NAN]))),
        "Trajectory.moments": call(lambda longest: motion().moments(longest=longest).q, longest=(0.1, POSITIVE)),
        "Problem.beginning": call(
            lambda **keys: bp.build_problem(the, scene()).beginning(**keys).start_q, q=q4, time=(1.0, NUMBER)
        ),
        "TipPath": call(
            bp.TipPath, waypoints=(path().waypoints, only(None, "text", {"a": 1}, OBJECT, [], 3.0, [1, 2])),
            numbers=((1, 2), only(None, "text", OBJECT, 3.0, [1], [0.5, 1.5])), lists=False,
        ),
        "TipPath.__call__": call(path(), s=(0.5, NUMBER), order=(1, only(None, "text", {}, OBJECT, [], -1, 2, 0.5))),
        "TipPath.target": call(lambda s: path().target(s).position, s=(0.5, NUMBER)),
        "TipPath.nearest": call(
            path().nearest, point=(np.ones(3), vector(3)), low=(0.1, NUMBER), high=(1.0, optional(NUMBER))
        ),
        "TipPath.place": call(
            path().place, at=(at(), THING), low=(0.0, NUMBER), high=(1.0, NUMBER),
            slack=(0.0, Kind((*NUMBER.bad, -1.0))),
        ),
        "TipPath.arc": call(path().arc, s=(0.5, NUMBER)),
        "TipPath.describe": call(path().describe, s=(0.5, NUMBER)),
        "TipPath.number": call(path().number, index=(1, index)),
        "TipPath.turn": call(path().turn, a=(0.1, NUMBER), b=(0.2, NUMBER)),
        "TipPath.corners": call(path().corners, angle=(0.1, NUMBER)),
        # the site
        "Nearby.only": call(
            lambda rows: nearby().only(rows).margin,
            rows=(nearby().margin > 0.0, only(None, "text", {}, OBJECT, [True], [0, 1], 3.0)),
        ),
        "Obstacle": call(
            lambda **keys: bp.Proximity(the, [bp.Obstacle(links=None, spec=scene().obstacles[0], **keys)]).distances(Q),
            name=("it", only(None, 3.0, {}, OBJECT, [])),
            pieces=((shapes.sphere(0.3, pin.SE3.Identity()),), only(None, "text", OBJECT, 3.0, [3.0])),
            clearance=(0.1, NUMBER), appears_at=(0.0, NUMBER), velocity=(np.zeros(3), vector(3)),
        ),
        "Obstruction.joint_limit": call(bp.Obstruction.joint_limit, joint=("boom", only()), distance=(0.1, only())),
        "Proximity": call(
            bp.Proximity, robot=(the, THING), self_collision=(True, FLAG), lists=False,
            obstacles=(bp.build_obstacles(scene(), the), only(None, "text", {"a": 1}, OBJECT, 3.0, [3.0])),
        ),
        "Proximity.at": call(
            lambda **keys: prox.at(**keys).distance, q=q4, time=(0.5, NUMBER), within=(3.0, NUMBER),
            margin=(np.full(len(prox.pairs), 2.0), Kind((*NO_NUMBER, NAN, [0.1, 0.2]))),
        ),
        "Proximity.cover": call(prox.cover, q=rq),
        "Proximity.is_at": call(prox.is_at, q=q4, time=(0.5, NUMBER)),
        "Proximity.distances": call(prox.distances, q=q4, time=(0.5, NUMBER)),
        "Proximity.tightest": call(lambda **keys: str(prox.tightest(**keys)), q=q4, time=(0.5, NUMBER)),
        "Proximity.lower_bounds": call(
            prox.lower_bounds, q=q4, time=(0.5, NUMBER),
            floor=(np.full(len(prox.pairs), 99.0), only(*NO_NUMBER, [0.1, 0.2])),
        ),
        "Proximity.distance_of": call(prox.distance_of, pair=(1, index), q=q4, time=(0.5, NUMBER)),
        "Proximity.distances_of": call(prox.distances_of, pairs=(np.array([1, 2]), indices), q=q4, time=(0.5, NUMBER)),
        "Proximity.obstacle_offset": call(prox.obstacle_offset, index=(0, index), time=(0.5, NUMBER)),
        "ZoneLog": call(bp.ZoneLog, lists=False, **site),
        "ZoneLog.note": call(lambda **keys: bp.ZoneLog(the, scene()).note(**keys), time=(0.5, NUMBER), q=q4),
        # the law
        "CompletedLaw": call(
            bp.CompletedLaw, robot=(the, THING), influence=(0.6, POSITIVE), nominal=(0.1, Kind((*NUMBER.bad, -1.0))),
            gains=(None, optional(THING)), directionality=(True, FLAG), lists=False,
        ),
        "CompletedLaw.wish": call(lambda **keys: law().wish(**keys).v, **rows),
        "CompletedLaw.near_limit": call(law().near_limit, q=q4, v=v4),
        "CriticalRows": call(
            lambda **keys: law().wish(at(), J, xdot, bp.CriticalRows(**keys)).v, margin=(np.full(2, 0.1), vector(2)),
            gradient=(np.ones((2, 4)), MATRIX), drift=(np.zeros(2), vector(2)),
        ),
        "Shield": call(bp.Shield, limits=(the.limits, THING), lists=False),
        "Shield.velocity_bounds": call(shield.velocity_bounds, q=q4, v_before=v4, dt=(0.01, POSITIVE)),
        "Shield.braking_time": call(shield.braking_time, v=v4),
        "Shield.stopping_time": call(shield.stopping_time, v=v4),
        "Shield.filter": call(
            lambda **keys: shield.filter(**keys).v, wish=v4, q=q4, v_before=v4, dt=(0.01, POSITIVE),
            nearby=(nearby(), THING), J_tip=(J, MATRIX), extra_margin=(0.0, Kind((*NO_NUMBER, NAN, [0.1] * 99))),
        ),
        # live
        "Servo": call(
            lambda **keys: bp.Servo(**keys).q, robot=(the, THING), scene=(scene(), THING), q=(Q, optional(vector(4))),
            dt=(0.001, POSITIVE), watchdog=(0.2, Kind((*NUMBER.bad, -1.0))), circulate=(False, FLAG),
            self_collision=(True, FLAG), feedback=(None, optional(THING)), load=(None, optional(THING)), lists=False,
        ),
        "Servo.is_moving": call(lambda name: servo().is_moving(name), name=(None, only()), lists=False),
        "Servo.add": call(servo().add, obstacle=({}, THING), lists=False),
        "Servo.add_points": call(
            servo().add_points, name=("scan", only(None, 3.0, {}, OBJECT, [], "", "rock", "line")),
            points=(np.ones((2, 3)), only(None, "text", {"a": 1}, OBJECT, [[1.0]], [[NAN] * 3], 3.0)),
            resolution=(0.1, POSITIVE), clearance=(0.1, optional(Kind((*NUMBER.bad, -1.0)))), lists=False,
        ),
        "Servo.remove": call(servo().remove, name=("none", TEXT), lists=False),
        "Servo.move": call(servo().move, name=("rock", TEXT), by=(np.zeros(3), vector(3))),
        "Servo.set_velocity": call(servo().set_velocity, name=("rock", TEXT), velocity=(np.zeros(3), vector(3))),
        "Servo.carry": call(servo().carry, leg=(None, optional(TEXT)), lists=False),
        "Servo.prepare_to_carry": call(servo().prepare_to_carry, leg=(None, optional(TEXT)), lists=False),
        "Servo.shift_of": call(servo().shift_of, name=("rock", TEXT)),
        "Servo.step": call(servo().step, lists=False),  # raises nothing, see below
        "Feedback": call(
            bp.Feedback, dt=(0.001, POSITIVE), damping=(60.0, Kind((*NUMBER.bad, -1.0))), largest=(30.0, POSITIVE),
            sharpest=(200.0, Kind((*NUMBER.bad, -1.0))), lists=False,
        ),
        "Feedback.next": call(
            lambda **keys: bp.Feedback(0.001).next(**keys), hand=(np.ones(3), vector(3)),
            refused=(np.ones(3), vector(3)),
            normal=(np.array([0.0, 0.0, 1.0]), vector(3)), nearness=(0.5, Kind((*NUMBER.bad, -1.0, 2.0))),
        ),
        "PlanFollower": call(
            bp.PlanFollower, servo=(servo(), THING), plan=(motion(), THING), executor=(None, optional(THING)),
            seed=(0, COUNT), allow_failed=(False, FLAG), lists=False,
        ),
        "PlanFollower.step": call(
            lambda pace: bp.PlanFollower(servo(), motion()).step(pace=pace).plan_time,
            pace=(0.5, Kind((*NUMBER.bad, -1.0, 2.0))), lists=False,
        ),
        # jobs
        "Terrain": call(
            lambda **keys: bp.Terrain(**keys).surface, low=(np.zeros(2), vector(2)), cell=(0.5, POSITIVE),
            bank=(np.zeros((3, 4)), GRID), loose=(np.zeros((3, 4)), GRID), soil=(terrain().soil, THING),
            off_ground=(None, optional(THING)), swell=(1.2, POSITIVE), repose=(0.6, POSITIVE),
        ),
        "OffGround": call(
            bp.OffGround, edge=(0.1, POSITIVE), keys=(np.zeros((2, 3), dtype=int), only(*THING.bad, np.zeros((2, 3)))),
            lists=False,
        ),
        "Terrain.level": call(lambda **keys: bp.Terrain.level(**keys).surface, z=(0.5, NUMBER), **frame),
        "Terrain.from_points": call(
            lambda **keys: bp.Terrain.from_points(**keys).surface, **frame,
            points=(np.random.default_rng(0).uniform(-0.2, 2.2, (4000, 3)), MATRIX), fill=(0.5, NUMBER),
            roughness=(3.0, NUMBER),
        ),
        "Terrain.from_file": call(
            bp.Terrain.from_file, file=("no/such.csv", PATH), cell=(0.5, optional(POSITIVE)), lists=False
        ),
        "Terrain.bank_volume_below": call(terrain().bank_volume_below, other=(terrain(), THING)),
        "Terrain.unlike": call(terrain().unlike, other=(terrain(), THING)),
        "Terrain.with_layers": call(
            lambda **keys: terrain().with_layers(**keys).surface, bank=(np.zeros((5, 5)), GRID),
            loose=(np.zeros((5, 5)), GRID),
        ),
        "Terrain.height_at": call(
            terrain().height_at, points=(np.ones((3, 2)), only(None, "text", {}, OBJECT, 3.0, [1.0]))
        ),
        "Terrain.columns_within": call(
            terrain().columns_within, low=(np.zeros(2), vector(2)), high=(np.ones(2), vector(2)),
            margin=(0.1, NUMBER), lists=False,
        ),
        "load_job": call(bp.load_job, path=("no/such/job", PATH), lists=False),
        "job_from_dict": call(
            bp.job_from_dict, content=(job().to_dict(), only(None, "text", OBJECT, [], 3.0)),
            folder=(".", only(None, 3.0, OBJECT, [])), lists=False,
        ),
        "load_job_plan": call(
            bp.load_job_plan, path=("no/such/plan", PATH), urdf=("a.urdf", optional(only(3.0, OBJECT, []))), lists=False
        ),
        "plan_job": call(
            bp.plan_job, job=(buried_job(), THING), effort=("quick", TEXT), seed=(0, COUNT),
            terrain=(None, optional(THING)), resume=(None, optional(THING)),
            watch=(None, only("text", {"a": 1}, OBJECT, [], 3.0)), lists=False,
        ),
        "stand": call(
            bp.stand, job=(buried_job(), THING), count=(1, Kind((*COUNT.bad, 0))), effort=("quick", TEXT),
            seed=(0, COUNT), watch=(None, only("text", {"a": 1}, OBJECT, [], 3.0)), lists=False,
        ),
        "StandPlan.save": call(lambda path: stand_plan().save(path), path=("no/such/folder/a.json", PATH), lists=False),
        # studies
        "load_study": call(bp.load_study, path=("no/such/study", PATH), lists=False),
        "study": call(
            bp.study, study=("example:backhoe", only(None, 3.0, {"a": 1}, OBJECT, [])),
            scene=(scene(), only(3.0, {"a": 1}, OBJECT, [])), parameters=({"clearance": [0.1]}, only(3.0, [1], OBJECT)),
            combine=("grid", only("text", 3.0, OBJECT)), count=(None, only("text", 2.5, -1, OBJECT)),
            seed=(0, only("text", 2.5, -1, OBJECT)),
            metrics=(None, only("text", 3.0, OBJECT, [], ["no such"])),
            folder=("no/such", only(3.0, OBJECT, [])), scheduler=(None, only(3.0, OBJECT, [])),
            jobs=(1, only("text", 0, -2, 2.5, OBJECT)), watch=(None, only("text", 3.0, OBJECT)), lists=False,
        ),
        "JobPlan.save": call(lambda path: job_plan().save(path), path=("no/such/folder/a.json", PATH), lists=False),
        "JobPlan.mean_use": call(job_plan().mean_use, name=("pump", TEXT), lists=False),
        "Cycle.leg": call(lambda name: cycle().leg(name), name=("cut", TEXT), lists=False),
        "Certificate.leg_of": call(
            lambda spot: recording().certificate.leg_of(spot),
            spot=(bp.Obstruction("obstacle", "rock", "boom", 0.1, 0.0), THING), lists=False,
        ),
        "Plan.save": call(lambda path: recording().save(path), path=("no/such/folder/a.json", PATH), lists=False),
    }  # fmt: skip


@cache
def terrain() -> bp.Terrain:
    return bp.Terrain.level(0.0, (0.0, 0.0), (2.0, 2.0), 0.5)


def job_content() -> dict[str, Any]:
    trench = {"from": [4.0, 0.0], "to": [3.0, 0.0], "width": 0.6, "depth": 0.3}
    return {"version": 1, "dig": {"trench": trench}, "dump": {"heap": {"at": [2.2, -3.0]}}}


@cache
def job() -> bp.Job:
    return bp.job_from_dict(job_content())


@cache
def buried_job() -> bp.Job:
    """A job that is refused at once: its design lies above the ground."""
    return bp.job_from_dict(job_content() | {"ground": {"level": -2.0}} | {"machine": "no_such.urdf"})


@cache
def job_plan() -> bp.JobPlan:
    grid = np.full((5, 5), NAN)
    return bp.JobPlan(
        job(), robot(), terrain(), design=grid, share=np.zeros((5, 5)), allowed=grid, outline=np.zeros((4, 2)),
        cycles=(), undug=(), compared=(), capacity=0.2, effort="quick", seed=0,
    )  # fmt: skip


@cache
def stand_plan() -> bp.StandPlan:
    grid = np.zeros((0, 0))
    return bp.StandPlan(job(), (), (), bp.SiteMap((), grid, grid, (0.1, 0.1), np.array([1.0, 0.0]), grid), ())


@cache
def cycle() -> bp.Cycle:
    none = np.zeros(0)
    return bp.Cycle(
        1, (), bp.Digging(none, np.zeros((0, 3)), np.zeros(3), 0.6, none, none), bp.Load(0.0, none, none),
        before=terrain(), dug=terrain(), after=terrain(), bank=0.0, taken=0.0, held=0.0, spilt=0.0,
        place=np.zeros(3), truck=0, truck_load=None, step="", filled=0.0, depth=0.0,
    )  # fmt: skip


@cache
def recording() -> bp.Plan:
    return plan_from_recording(robot(), scene(), motion())


# --- all of them ----------------------------------------------------------------------

# records of values made by this package; their methods are above
RESULTS = {
    "Beside", "BothWays", "Certificate", "Configuration", "Cylinder", "Detour", "DiggingForces", "FollowerState",
    "LeftOut",
    "Hydraulics", "InverseKinematics", "KeepUse", "LimitUse", "Moments", "MotionEnergy", "Nearby", "NearestPose",
    "LegCertificate", "Obstruction", "StudyStep", "Piece", "Plan", "PlannedLeg",
    "PlannerStep", "Problem", "Reaction", "Robot", "ServoState", "Shielded", "SpotTurn",
    "Cycle", "CycleLeg", "Digging", "JobPlan", "JobStep", "Load", "PatternEstimate", "Undug",
    "Place", "RankedPlace", "SiteMap", "Spot", "StandPlan", "StandStep",
    "Step", "TaskInverse", "Tracking", "Transgression", "WaypointStep", "Wish",
}  # fmt: skip
PUBLIC = {name: getattr(bp, name) for name in dir(bp) if not name.startswith("_")}
RECORDS = [name for name, thing in PUBLIC.items() if inspect.isclass(thing) and issubclass(thing, Record)]


def takes_arguments(function: Any) -> bool:
    return len([name for name in inspect.signature(function).parameters if name not in ("self", "cls")]) > 0


def to_cover() -> Iterator[str]:
    for name, thing in PUBLIC.items():
        if not inspect.isclass(thing):
            if takes_arguments(thing):
                yield name
            continue
        if issubclass(thing, (Exception, Enum, Record)):
            continue
        holds = is_dataclass(thing) or issubclass(thing, tuple)
        if name not in RESULTS and (not holds or thing.__init__ is not object.__init__):
            yield name
        for method, member in vars(thing).items():
            inner = getattr(member, "__func__", member)
            own = inspect.isfunction(inner) and inner.__module__ == thing.__module__
            if (
                own
                and (not method.startswith("_") or method == "__call__")
                and not method.endswith("_unchecked")
                and takes_arguments(inner)
            ):
                yield f"{name}.{method}"


def test_every_public_name_that_takes_arguments_has_an_entry() -> None:
    assert sorted(set(to_cover()) - set(calls())) == []


NAMES = tuple(re.findall(r'^        "([\w.]+)": call\(', Path(__file__).read_text(encoding="utf-8"), re.M))


@pytest.mark.parametrize("name", NAMES)
def test_misuse_is_an_input_error_that_names_the_argument(name: str) -> None:
    found, wrong = calls()[name], []
    for argument, kind in found.kinds.items():
        for bad in kind.bad:
            said = f"{argument}={bad!r:.60}"
            try:
                found.function(**{**found.good, argument: bad})
            except InputError as error:
                if argument not in str(error) and error.file is None:
                    wrong.append(f"{said} is not named: {error}")
            except Exception as error:  # noqa: BLE001
                wrong.append(f"{said} ends in {type(error).__name__}: {error!s:.100}")
            else:
                wrong.append(f"{said} is accepted")
    assert not wrong, "\n".join(wrong)


def same(one: Any, other: Any) -> None:
    if isinstance(one, bp.BothWays):
        same((one.positive, one.negative), (other.positive, other.negative))
    elif isinstance(one, tuple):
        for a, b in zip(one, other, strict=True):
            same(a, b)
    else:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", NAMES)
def test_lists_give_the_same_results_as_arrays(name: str) -> None:
    found = calls()[name]
    arrays = {key: value for key, value in found.good.items() if isinstance(value, np.ndarray)}
    if not found.lists or not arrays:
        return
    same(found.function(**found.good), found.function(**{**found.good, **{k: v.tolist() for k, v in arrays.items()}}))


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("bad", [None, "text", OBJECT, [], NAN])
def test_records_refuse_unknown_keys_and_wrong_values(name: str, bad: Any) -> None:
    first = next(iter(PUBLIC[name].model_fields))
    for keys in ({"no_such_key": bad}, {first: OBJECT}):
        with pytest.raises(InputError, match=next(iter(keys))):
            PUBLIC[name](**keys)


@pytest.mark.parametrize("wish", ["tip_velocity", "joint_velocity", "pitch_rate"])
def test_a_step_of_the_servo_raises_nothing(wish: str) -> None:
    for bad in vector(4 if wish == "joint_velocity" else 3).bad:
        state = servo().step(**{wish: bad})
        assert bad is None or state.command is bp.Command.INVALID
        assert servo().last_error is None


# --- misuse that once passed silently -------------------------------------------------


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("value", [NAN, INF])
def test_a_configuration_that_is_not_finite_is_refused_naming_the_joint(joint: int, value: float) -> None:
    q = Q.copy()
    q[joint] = value
    named = robot().joint_names[joint]
    for ask in (proximity().at, proximity().distances, proximity().tightest, bp.Kinematics(robot()).at):
        with pytest.raises(InputError, match=rf"q \({named}\): is not finite"):
            ask(q)
    assert np.isfinite(proximity().distances(Q)).all(), "and what comes after is right"


def test_the_zone_log_refuses_decreasing_times_and_stays_usable() -> None:
    log = bp.ZoneLog(robot(), scene())
    log.note(1.0, Q)
    for time in (0.5, NAN, -INF):
        with pytest.raises(InputError, match=r"^time: "):
            log.note(time, Q)
    log.note(1.0, Q)
    log.note(2.0, Q)


def test_a_scene_is_read_only_and_is_refused_as_a_list_of_obstacles() -> None:
    with pytest.raises(InputError, match=r"Scene\.clearance: does not change once it is made"):
        scene().clearance = 0.3
    with pytest.raises(InputError, match=r"obstacles: is a scene; .*build_obstacles\(scene, robot\)"):
        bp.Proximity(robot(), scene())  # type: ignore[arg-type]


def test_a_name_that_is_empty_is_shown_in_the_message() -> None:
    with pytest.raises(bp.RobotError, match="found ''; allowed"):
        bp.load_robot("example:backhoe", tip="")


@pytest.mark.parametrize(("number", "found"), [(10**400, "above 1e308"), (-(10**4000), "below -1e308")])
def test_a_whole_number_that_no_float_holds_is_told_as_one(number: int, found: str) -> None:
    with pytest.raises(
        InputError, match=f"^size: is not in its range; found a whole number {found}; allowed: a number"
    ):
        as_number(number, key="size", least=0.0)
