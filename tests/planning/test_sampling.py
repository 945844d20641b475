"""Paths found by sampling: proven, repeatable, silent and interruptible."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bar_scenes import BAR, STRETCHED, TURNED, across_bar, problem_of
from waiting import PATIENCE

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Keep, Problem, build_problem, drive_of, time_way
from backhoe_planner.planning import (
    EFFORTS,
    Brake,
    Effort,
    JointPath,
    MotionCheck,
    OutOfTime,
    SampledCheck,
    Work,
    blend,
    sample_path,
    shorten,
)
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import certify_problem
from backhoe_planner.site import Proximity
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

Data = dict[str, Any]


def find_way(
    problem: Problem,
    proximity: Proximity,
    start: Vector,
    goals: list[Vector],
    *,
    seed: int,
    brake: Brake | None = None,
    effort: Effort = EFFORTS["normal"],
    spare: float,
    time: float = 0.0,
    near: Callable[[Matrix], bool] | None = None,
) -> JointPath | None:
    ends = [np.array(q, dtype=float) for q in (start, *goals)]
    check = MotionCheck(problem, proximity, ends, spare=spare, time=time, near=near, brake=brake)
    return sample_path(check, ends[0], ends[1:], seed=seed, work=Work(effort, brake))


def least_margin(proximity: Proximity, q: Matrix, *, time: float = 0.0, pieces: int = 60) -> float:
    """The least margin of all pairs on dense samples of a polyline."""
    every = [
        proximity.distances(a + t * (b - a), time=time) - proximity.clearance
        for a, b in itertools.pairwise(q)
        for t in np.linspace(0.0, 1.0, pieces)
    ]
    return float(np.min(every))


# --- finding --------------------------------------------------------------------------


def test_a_clear_straight_line_is_taken(planar4: Robot) -> None:
    problem = problem_of(planar4, STRETCHED, TURNED, [])
    way = find_way(problem, Proximity(planar4, ()), STRETCHED, [TURNED], seed=0, spare=0.0)
    assert way is not None
    np.testing.assert_array_equal(way.q, [STRETCHED, TURNED])


def test_the_goal_of_the_shortest_time_is_tried_first(planar4: Robot) -> None:
    problem = problem_of(planar4, STRETCHED, TURNED, [])
    far, near = np.array([1.5, 0.0, 0.0, 0.0]), np.array([0.9, 0.9, 0.9, 0.9])
    way = find_way(problem, Proximity(planar4, ()), STRETCHED, [far, near], seed=0, spare=0.0)
    assert way is not None
    np.testing.assert_array_equal(way.q[-1], near)  # further in the Euclidean norm, but reached sooner


def test_a_detour_keeps_clearance_and_spare(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    assert least_margin(proximity, np.array([STRETCHED, TURNED])) < 0.0
    way = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.03)
    assert way is not None
    assert len(way.q) > 2
    np.testing.assert_array_equal(way.q[0], STRETCHED)
    np.testing.assert_array_equal(way.q[-1], TURNED)
    obstacles_alone = Proximity(problem.robot, problem.obstacles, self_collision=False)
    assert least_margin(obstacles_alone, way.q) >= 0.03 - 1e-9
    assert least_margin(proximity, way.q) >= 0.002 - 1e-9
    assert np.all(way.q >= problem.limits.lower)
    assert np.all(way.q <= problem.limits.upper)


def test_a_detour_does_not_depend_on_the_speed_of_the_machine(planar4: Robot) -> None:
    """A hundred thousandth of the speed allows the same paths."""
    problem, proximity = across_bar(planar4)
    limits = problem.limits
    slow = replace(limits, velocity=1e-5 * limits.velocity, acceleration=1e-5 * limits.acceleration)
    way = find_way(replace(problem, limits=slow), proximity, STRETCHED, [TURNED], seed=0, spare=0.03)
    assert way is not None
    assert least_margin(proximity, way.q) >= 0.002 - 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_a_path_along_a_joint_limit_is_found(seed: int) -> None:
    """Only the highest boom passes: with draws between its limits alone, 72,000 motions were mostly too few."""
    robot = load_machine("backhoe")
    problem = build_problem(robot, random_site(robot, SiteKey("backhoe", "open", "goal", 81, 3201)).scene)
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    assert problem.start_q is not None
    found = find_goal_postures(world, problem.goals, near=problem.start_q, time=0.0)
    assert isinstance(found, GoalPostures)
    check = SampledCheck(problem, world.proximity, [problem.start_q, *found.clear], spare=0.002)
    way = sample_path(check, problem.start_q, list(found.clear), seed=seed, work=Work(EFFORTS["normal"]))
    assert way is not None
    boom = robot.joint_names.index("boom")
    assert way.q[:, boom].max() > 0.98 * problem.limits.upper[boom]
    assert (way.q <= problem.limits.upper).all()
    assert (way.q >= problem.limits.lower).all()


def test_goals_in_collision_are_left_out(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    inside = np.array([0.6, 0.0, 0.0, 0.0])
    assert least_margin(proximity, np.array([inside, inside])) < 0.0
    way = find_way(problem, proximity, STRETCHED, [inside, TURNED], seed=0, spare=0.0)
    assert way is not None
    np.testing.assert_array_equal(way.q[-1], TURNED)
    assert find_way(problem, proximity, STRETCHED, [inside], seed=0, spare=0.0) is None
    assert find_way(problem, proximity, inside, [TURNED], seed=0, spare=0.0) is None


def test_an_end_outside_the_limits_is_left_out(planar4: Robot) -> None:
    problem = problem_of(planar4, STRETCHED, TURNED, [])
    outside = problem.limits.upper + 0.1
    assert np.all(np.isfinite(outside))
    way = find_way(problem, Proximity(planar4, ()), STRETCHED, [outside], seed=0, spare=0.0)
    assert way is None


@pytest.mark.parametrize("margin", [0.0, 1e-5, 0.004])
def test_a_start_with_less_than_the_spare_clearance_can_be_left(planar4: Robot, margin: float) -> None:
    """A ball beside the stretched arm, at its clearance plus `margin` from link 3."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2.5, -0.26 - margin, 0.0]}
    problem, proximity = across_bar(planar4, ball)
    found = proximity.distances(STRETCHED) - proximity.clearance
    assert float(found[proximity.owner == 1].min()) == pytest.approx(margin, abs=1e-9)
    way = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.02)
    assert way is not None
    assert least_margin(proximity, way.q, pieces=400) >= -1e-6  # which the certificate tolerates
    away = np.linalg.norm(way.q[1:-1], axis=1) > 0.5
    assert away.any()
    obstacles_alone = Proximity(problem.robot, problem.obstacles, self_collision=False)
    for q in way.q[1:-1][away]:
        assert least_margin(obstacles_alone, np.array([q, q]), pieces=1) >= 0.02 - 1e-9


def test_an_additional_condition_is_kept(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)

    def folded(q: Matrix) -> bool:
        return bool(np.all(q[:, 1] <= 0.05))

    way = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.0, near=folded)
    assert way is not None
    assert np.max(way.q[:, 1]) <= 0.05
    free = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.0)
    assert free is not None
    assert np.max(free.q[:, 1]) > 0.05


def test_obstacles_are_at_their_places_at_the_given_time(planar4: Robot) -> None:
    later = BAR | {"appears_at": 2.0, "velocity": [0.0, 1.0, 0.0]}
    problem = problem_of(planar4, STRETCHED, TURNED, [later])
    proximity = Proximity(planar4, problem.obstacles)

    def corners(time: float) -> int:
        way = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.0, time=time)
        assert way is not None
        return len(way.q)

    assert corners(1.0) == 2  # it is not there yet
    assert corners(2.0) > 2
    assert corners(12.0) == 2  # it has gone 10 m


def cut_off(q: Matrix) -> bool:
    """A condition that no motion of the first joint past 0.7 rad meets."""
    return bool(np.all(np.abs(q[:, 0] - 0.7) > 0.1))


def test_a_search_ends_after_its_number_of_motions(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    check = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.0, near=cut_off)
    work = Work(replace(EFFORTS["normal"], motions_per_search=300, motions=500))
    assert sample_path(check, STRETCHED, [TURNED], seed=0, work=work) is None
    assert 195 <= work.motions <= 200  # a tree may check a motion or two more before OMPL asks whether to end
    assert sample_path(check, STRETCHED, [TURNED], seed=0, work=work) is None
    assert -5 <= work.motions <= 0  # the remainder of the first search
    before = work.motions
    assert sample_path(check, STRETCHED, [TURNED], seed=0, work=work) is None
    assert work.motions == before


def test_a_search_within_a_cone_ends_where_no_sample_can_be_projected_into_it(
    ur5: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sample that fails counts as one motion, and the brake is asked."""
    q, tried = np.array([0.3, -1.2, 1.0, -0.7, 0.4, 0.3]), 0

    def fail(*_: Any) -> None:
        nonlocal tried
        tried += 1
        assert tried <= 500, "the search goes on"

    monkeypatch.setattr(Keep, "project", fail)
    start = {"joints": dict(zip(ur5.joint_names, q.tolist(), strict=True))}
    goal = {"joints": start["joints"] | {"wrist_3_joint": 1.3}}
    axis = Kinematics(ur5).at(q).tip_rotation[2].tolist()
    task = {"goal": goal, "keep": {"tilt": {"axis": axis, "tolerance": 2.0}}}
    problem = build_problem(ur5, bp.scene_from_dict({"version": 1, "tip": "tool0", "start": start, "task": task}))
    ends, proximity = [q, q + np.eye(6)[5]], Proximity(ur5, [])
    for brake, most in ((Brake(), 300), (Brake(1e-9), 301)):
        check = MotionCheck(problem, proximity, ends, spare=0.0, brake=brake)
        work = Work(replace(EFFORTS["normal"], motions_per_search=300, motions=500))
        if brake.budget < 1.0:
            with pytest.raises(OutOfTime):
                sample_path(check, q, ends[1:], seed=0, work=work, straight=False)
        else:
            assert sample_path(check, q, ends[1:], seed=0, work=work, straight=False) is None
            assert work.motions == 200
        assert tried == most


def test_the_brake_ends_a_search(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    with pytest.raises(OutOfTime, match=r"after 1e-09 s of computing"):
        find_way(problem, proximity, STRETCHED, [TURNED], seed=0, brake=Brake(1e-9), spare=0.0)
    brake = Brake(0.05)
    endless = replace(EFFORTS["normal"], motions_per_search=10**9, motions=10**9)
    with pytest.raises(OutOfTime):
        find_way(problem, proximity, STRETCHED, [TURNED], seed=0, brake=brake, effort=endless, spare=0.0, near=cut_off)


def test_an_exception_of_the_condition_is_raised_by_the_search(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    asked = 0

    def broken(q: Matrix) -> bool:
        nonlocal asked
        asked += 1
        if asked > 500:
            raise ZeroDivisionError("of the condition")
        return cut_off(q)

    with pytest.raises(ZeroDivisionError, match="of the condition"):
        find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.0, near=broken)
    assert asked == 501


def test_a_continuous_joint_may_turn_past_pi(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "models" / "planar4.urdf").read_text(encoding="utf-8")
    before, first, after = text.partition('<joint name="joint1" type="revolute">')
    assert first
    free = tmp_path / "free.urdf"
    free.write_text(before + '<joint name="joint1" type="continuous">' + after, encoding="utf-8")
    robot = bp.load_robot(str(free))
    assert not np.isfinite(robot.limits.upper[0])
    start, goal = np.array([3.0, 0.0, 0.0, 0.0]), np.array([4.2, 0.0, 0.0, 0.0])
    block = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [4 * np.cos(3.6), 4 * np.sin(3.6), 0.0]}
    problem = problem_of(robot, start, goal, [block])
    proximity = Proximity(robot, problem.obstacles)
    way = find_way(problem, proximity, start, [goal], seed=1, spare=0.0)
    assert way is not None
    assert len(way.q) > 2
    assert least_margin(proximity, way.q) >= -1e-9


# --- repeatability and silence ----------------------------------------------------------

SCRIPT = """
import os, signal, sys, threading
from dataclasses import replace
import numpy as np
import backhoe_planner as bp
from backhoe_planner.motion import time_way
from backhoe_planner.planning import EFFORTS, MotionCheck, Work, blend, sample_path, shorten
from bar_scenes import STRETCHED, TURNED, across_bar

def cut_off(q):
    return bool(np.all(np.abs(q[:, 0] - 0.7) > 0.1))

def run(mode):
    problem, proximity = across_bar(bp.load_robot("example:planar4"))
    effort = EFFORTS["quick"]
    if mode in ("interrupt", "caught"):  # it could go on for hours
        effort = replace(effort, motions_per_search=10**9, motions=10**9)
    keep = None if mode == "find" else cut_off
    check = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.01, near=keep)
    if mode == "interrupt":
        threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    way = sample_path(check, STRETCHED, [TURNED], seed=3, work=Work(effort))
    if mode == "fail":
        assert way is None
        return
    smooth = blend(check, shorten(check, way, seed=3))
    time_way(smooth, problem.limits)
    np.save(sys.argv[2], np.vstack((way.q, smooth.corners)))

if sys.argv[1] == "caught":
    try:
        run("interrupt")
    except KeyboardInterrupt:
        sys.exit(7)
run(sys.argv[1])
"""


def run_script(mode: str, file: Path) -> subprocess.CompletedProcess[str]:
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r})\n{SCRIPT}"
    return subprocess.run(
        [sys.executable, "-c", code, mode, str(file)], capture_output=True, text=True, check=False, timeout=PATIENCE,
        # the signal is ignored if the tests run in the background
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def test_the_same_seed_gives_the_same_path_bit_for_bit_and_prints_nothing(planar4: Robot, tmp_path: Path) -> None:
    def plan(seed: int) -> Matrix:
        problem, proximity = across_bar(planar4)
        check = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.01)
        way = sample_path(check, STRETCHED, [TURNED], seed=seed, work=Work())
        assert way is not None
        return np.vstack((way.q, blend(check, shorten(check, way, seed=seed)).corners))

    first, other, again = plan(3), plan(4), plan(3)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    done = run_script("find", tmp_path / "elsewhere.npy")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    np.testing.assert_array_equal(first, np.load(tmp_path / "elsewhere.npy"))


@pytest.mark.parametrize(
    ("mode", "status"),
    [pytest.param("fail", 0, marks=pytest.mark.long), pytest.param("caught", 7, marks=pytest.mark.long)],
)
def test_a_failed_or_interrupted_search_prints_nothing(tmp_path: Path, mode: str, status: int) -> None:
    done = run_script(mode, tmp_path / "way.npy")
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "")


@pytest.mark.long
def test_a_command_that_sampled_prints_no_error_at_its_end(tmp_path: Path) -> None:
    """No object of OMPL, which would complain, is left when the process ends."""
    scene = {
        "version": 1, "start": {"joints": {"swing": -0.9, "boom": 0.0, "stick": -1.2, "bucket": -0.6}},
        "task": {"goal": {"position": [2.6, 2.8, 0.6]}},
        "obstacles": [{"name": "wall", "shape": "box", "size": [3.0, 0.2, 2.0], "position": [3.2, 0.6, 1.0]}],
    }  # fmt: skip
    file = tmp_path / "scene.yaml"
    file.write_text(json.dumps(scene))
    code = "import sys; from backhoe_planner.__main__ import main\ntry: main()\n"
    code += "finally: print('sampled' if 'ompl' in sys.modules else 'did not sample')"
    arguments = ["plan", "example:backhoe", str(file), "--effort", "quick", "-o", str(tmp_path / "plan.json")]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert done.returncode == 0
    assert done.stdout.rstrip().endswith("\nsampled")
    assert done.stderr == ""


def test_an_interrupt_ends_the_search_at_once(tmp_path: Path) -> None:
    done = run_script("interrupt", tmp_path / "way.npy")
    assert done.returncode in (-signal.SIGINT, 130)
    assert done.stderr.rstrip().endswith("KeyboardInterrupt")
    assert "nanobind" not in done.stderr
    assert done.stdout == ""


# --- the proof --------------------------------------------------------------------------


def test_a_motion_is_clear_up_to_the_gap_of_plane_geometry(planar4: Robot) -> None:
    """The end of the stretched arm turns past a ball at a known gap."""
    corner = float(np.hypot(4.0, 0.04))
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [4.3 * np.cos(0.7), 4.3 * np.sin(0.7), 0.0]}
    problem = problem_of(planar4, STRETCHED, TURNED, [ball], clearance=0.0)
    gap = 4.3 - 0.1 - corner

    def clear(spare: float) -> bool:
        check = MotionCheck(problem, Proximity(planar4, problem.obstacles), [STRETCHED, TURNED], spare=spare)
        return check.segment_is_clear(STRETCHED, TURNED)

    assert clear(gap - 1e-3)
    assert not clear(gap + 1e-6)


@pytest.mark.parametrize(
    "any_robot",
    [
        pytest.param("planar4", marks=pytest.mark.long),
        "backhoe",
        pytest.param("panda", marks=pytest.mark.long),
        pytest.param("ur5", marks=pytest.mark.long),
    ],
    indirect=True,
)
def test_proven_motions_are_clear_in_dense_measurements(any_robot: Robot) -> None:
    """Random segments and corners among balls."""
    rng = np.random.default_rng(8)
    reach = 3.0 if any_robot.n == 4 else 0.6
    places = reach * rng.normal(size=(8, 3))
    places[:, 0] = np.abs(places[:, 0])
    obstacles: list[Data] = [
        {"name": f"{k}", "shape": "sphere", "radius": 0.1 * reach, "position": place}
        for k, place in enumerate(places.tolist())
    ]
    q_0 = any_robot.random_q(rng)
    problem = problem_of(any_robot, q_0, q_0, obstacles)
    proximity = Proximity(problem.robot, problem.obstacles)
    check = MotionCheck(problem, proximity, [q_0], spare=0.0)
    proven = refused = 0
    for _ in range(30):
        a = any_robot.random_q(rng)
        b, c = (np.clip(a + 0.3 * rng.normal(size=any_robot.n), any_robot.limits.lower, any_robot.limits.upper)
                for _ in range(2))  # fmt: skip
        t = np.linspace(0.0, 1.0, 60)[:, None]
        curves = {"segment": a + t * (b - a), "corner": (1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c}
        for kind, curve in curves.items():
            least = min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in curve)
            if kind == "segment":
                clear = check.segment_is_clear(a, b)
            else:
                clear = check.corner_is_clear(a, b, c, sagitta=np.zeros(any_robot.n))
            assert least >= -1e-9 if clear else least < 0.01
            proven, refused = proven + clear, refused + (not clear)
    assert min(proven, refused) >= 10


def test_far_from_everything_a_motion_takes_few_measurements(planar4: Robot) -> None:
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [60.0, 0.0, 0.0]}
    problem = problem_of(planar4, STRETCHED, TURNED, [ball])
    proximity = Proximity(planar4, problem.obstacles, self_collision=False)
    check = MotionCheck(problem, proximity, [STRETCHED], spare=0.0)
    before = check.measured
    assert check.segment_is_clear(STRETCHED, TURNED)
    assert check.segment_is_clear(TURNED, -TURNED)
    assert check.measured - before == 1


# --- shortening -------------------------------------------------------------------------


def test_shortening_keeps_ends_and_clearance_and_never_lengthens(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    check = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.01)
    gains = []
    for seed in range(4):
        way = sample_path(check, STRETCHED, [TURNED], seed=seed, work=Work())
        assert way is not None
        short = shorten(check, way, seed=seed)
        np.testing.assert_array_equal(short.q[[0, -1]], way.q[[0, -1]])
        assert short.length(problem.limits) <= way.length(problem.limits)
        assert least_margin(proximity, short.q) >= 0.002 - 1e-9
        np.testing.assert_array_equal(short.q, shorten(check, way, seed=seed).q)
        gains.append(short.length(problem.limits) / way.length(problem.limits))
    assert max(gains) < 0.95


def test_shortening_leaves_a_straight_path_unchanged(planar4: Robot) -> None:
    problem = problem_of(planar4, STRETCHED, TURNED, [])
    check = MotionCheck(problem, Proximity(planar4, ()), [STRETCHED, TURNED], spare=0.0)
    way = JointPath(np.array([STRETCHED, TURNED]))
    assert shorten(check, way, seed=0) is way
    needless = JointPath(np.array([STRETCHED, [0.3, 0.9, 0.0, 0.0], TURNED]))
    np.testing.assert_array_equal(shorten(check, needless, seed=0).q, way.q)


def test_the_brake_ends_shortening_and_blending_too(planar4: Robot) -> None:
    problem, proximity = across_bar(planar4)
    way = find_way(problem, proximity, STRETCHED, [TURNED], seed=0, spare=0.0)
    assert way is not None
    late = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.0, brake=Brake(1e-9))
    for ended in (
        lambda: shorten(late, way, seed=0),
        lambda: blend(late, way),
        lambda: late.segment_is_clear(STRETCHED, TURNED),
    ):
        with pytest.raises(OutOfTime):
            ended()


# --- the whole chain --------------------------------------------------------------------


SITES: dict[str, tuple[list[float], list[float], list[Data]]] = {
    "planar4": ([0.0] * 4, [1.5, 0.0, 0.0, 0.0], [BAR]),
    "backhoe": (
        [-0.8, 0.2, -1.2, -0.8],
        [0.9, 0.3, -1.4, -0.6],
        [
            {"name": "truck", "shape": "box", "size": [1.0, 0.6, 2.6], "position": [3.6, 0.1, 0.6], "clearance": 0.2},
            {"name": "wire", "shape": "halfspace", "point": [0, 0, 6.0], "normal": [0, 0, -1], "clearance": 1.0},
            {"name": "ground", "shape": "halfspace", "point": [0, 0, 0.0], "normal": [0, 0, 1], "links": ["boom"]},
        ],
    ),
    "ur5": (
        [-1.0, -1.2, 1.2, -1.4, -1.5, 0.0],
        [1.0, -1.2, 1.2, -1.4, -1.5, 0.0],
        [
            {"name": "post", "shape": "box", "size": [0.1, 0.1, 0.9], "position": [0.5, 0.2, 0.45]},
            {"name": "table", "shape": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 1], "links": ["wrist_3_link"]},
        ],
    ),
    "panda": (
        [-0.9, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8],
        [0.9, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8],
        [{"name": "post", "shape": "capsule", "from": [0.5, 0, -0.1], "to": [0.5, 0, 0.6], "radius": 0.06}],
    ),
}


@pytest.mark.parametrize("name", list(SITES))
def test_the_timed_motion_along_a_sampled_path_is_verified(name: str, request: pytest.FixtureRequest) -> None:
    robot: Robot = request.getfixturevalue(name)
    begin, end, obstacles = SITES[name]
    start, goal = np.array(begin), np.array(end)
    problem = problem_of(robot, start, goal, obstacles)
    proximity = Proximity(problem.robot, problem.obstacles)
    check = MotionCheck(problem, proximity, [start, goal], spare=0.01)
    assert not check.segment_is_clear(start, goal)  # the straight line is blocked
    way = sample_path(check, start, [goal], seed=0, work=Work())
    assert way is not None
    trajectory = time_way(blend(check, shorten(check, way, seed=0)), problem.limits, drive=drive_of(problem))
    certificate = certify_problem(problem, trajectory)
    assert certificate.verified, certificate.problems
    assert certificate.velocity.ratio <= 1.0
    assert certificate.acceleration.ratio <= 1.0
