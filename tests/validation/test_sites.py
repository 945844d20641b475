"""The random sites have their promised properties."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Problem, build_problem
from validation.habitats import load_machine
from validation.obstacles import MACHINES
from validation.sites import KINDS, SPARE, SURVEYED, TASKS, Site, SiteKey, random_site

ALL = [(machine, kind, task) for machine in MACHINES for kind in KINDS for task in TASKS]
SOME = ALL[::5]  # a site takes 0.1 s to draw; every machine, kind and task is among these
REST = [site for site in ALL if site not in SOME]


@cache
def drawn(machine: str, kind: str, task: str, index: int) -> Site:
    return random_site(load_machine(machine), SiteKey(machine, kind, task, index))


SURVEYS = [("backhoe", "terrain", "goal"), ("planar4", "scan", "path")]


def least_margin(problem: Problem, q: np.ndarray) -> float:
    proximity = bp.Proximity(problem.robot, problem.obstacles)
    return float(np.min(proximity.distances(q) - proximity.clearance))


@pytest.mark.parametrize(
    ("machine", "kind", "task"), [*SOME, SURVEYS[0], pytest.param(*SURVEYS[1], marks=pytest.mark.long)]
)
def test_a_site_depends_only_on_its_name(machine: str, kind: str, task: str) -> None:
    first = drawn(machine, kind, task, 0)
    other = drawn(machine, kind, task, 1)
    again = random_site(load_machine(machine), first.key)
    assert first.scene == again.scene
    assert np.array_equal(first.goal_q, again.goal_q)
    assert first.scene != other.scene
    if (kind, task) == ("open", "goal"):
        assert first.scene != random_site(load_machine(machine), SiteKey(machine, kind, task, 0, seed=1)).scene


@pytest.mark.parametrize(
    ("machine", "kind", "task"), [*SOME, *SURVEYS, *(pytest.param(*site, marks=pytest.mark.long) for site in REST)]
)
def test_start_and_goal_are_free_with_a_centimetre_to_spare(machine: str, kind: str, task: str) -> None:
    for index in range(2):
        site = drawn(machine, kind, task, index)
        problem = build_problem(load_machine(machine), site.scene)
        assert problem.obstacles
        ends = [site.goal_q] if site.start_q is None else [site.goal_q, site.start_q]
        for q in ends:
            assert least_margin(problem, q) >= SPARE
            assert np.all(q >= problem.limits.lower)
            assert np.all(q <= problem.limits.upper)
        for goal in problem.goals:
            at = bp.Kinematics(problem.robot).at(site.goal_q)
            assert max(goal.distances(at)) < 1e-9
            assert problem.start_q is not None
            assert site.start_q is not None
            assert np.array_equal(problem.start_q, site.start_q)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.long) if kind != "cluttered" else kind for kind in KINDS]
)
def test_a_path_of_full_poses_has_a_motion_that_follows_it_without_contact(kind: str) -> None:
    robot = load_machine("panda")
    for index in range(2):
        site = drawn("panda", kind, "path", index)
        problem = build_problem(robot, site.scene)
        assert site.scene.task.path is not None
        assert not site.scene.task.path.detour
        assert site.way_known
        assert site.motion is not None
        assert 200 <= len(site.scene.waypoints()) <= 500
        assert (site.start_q is None) == (index % 2 == 1)
        if site.start_q is not None:
            assert np.array_equal(site.start_q, site.motion[0])
        kinematics, path = bp.Kinematics(robot), problem.path
        assert path is not None
        proximity = bp.Proximity(robot, problem.obstacles)
        for station, q in zip(path.stations, site.motion, strict=True):
            position, angle = path.target(float(station)).distances(kinematics.at(q))
            assert position < 1e-9
            assert angle < 1e-6
            assert np.min(proximity.distances(q) - proximity.clearance) >= SPARE
        for (a, b), (s, t) in zip(pairwise(site.motion), pairwise(path.stations), strict=True):
            position, angle = path.target(0.5 * float(s + t)).distances(kinematics.at(0.5 * (a + b)))
            assert position < 0.1 * site.scene.task.path.tolerance
            assert angle < 1e-3


FEW = [("planar4", "narrow")]
OTHERS = [(machine, kind) for machine in ("planar4", "backhoe") for kind in KINDS if (machine, kind) not in FEW]


@pytest.mark.parametrize(
    ("machine", "kind"), [*FEW, *(pytest.param(*other, marks=pytest.mark.long) for other in OTHERS)]
)
def test_a_tip_path_that_is_not_blocked_has_a_motion_with_a_certificate(machine: str, kind: str) -> None:
    robot = load_machine(machine)
    blocked = 0
    for index in range(3):
        site = drawn(machine, kind, "path", index)
        scene = site.scene.model_copy(update={"start": None})
        assert site.motion is not None
        slowly = bp.Trajectory.from_steps(np.linspace(0.0, 10.0 * len(site.motion), len(site.motion)), site.motion)
        certificate = bp.certify(robot, scene, slowly)
        if site.blocked:
            blocked += 1
            assert scene.task.path is not None
            assert scene.task.path.detour
            assert not site.way_known
            continue
        assert certificate.tracking.done
        assert not certificate.detours
        assert certificate.min_clearance is None or certificate.min_clearance.margin >= SPARE - 1e-3
    assert blocked < 3


def test_sites_named_after_surveys_contain_them() -> None:
    for machine, kind, task in SURVEYS:
        shapes = {obstacle.shape for obstacle in drawn(machine, kind, task, 0).scene.obstacles}
        assert {"scan": "pointcloud", "terrain": "heightmap"}[kind] in shapes
    assert len(SURVEYED) == 2


def test_no_obstacle_is_inside_the_machine_and_every_kind_of_entry_occurs() -> None:
    shapes: set[str] = set()
    limited = own = 0
    for kind in KINDS:
        for index in range(4):
            site = drawn("backhoe", kind, "goal", index)
            post = bp.Proximity(load_machine("backhoe"), bp.build_obstacles(site.scene, load_machine("backhoe")))
            for pair, distance in zip(post.pairs, post.distances(np.zeros(4)), strict=True):
                if pair.link == "swing_post" and pair.kind == "obstacle":
                    assert distance > 0.0, (site.key, pair.obstacle)
            shapes |= {obstacle.shape for obstacle in site.scene.obstacles}
            limited += sum(obstacle.links is not None for obstacle in site.scene.obstacles)
            own += sum(obstacle.clearance is not None for obstacle in site.scene.obstacles)
    assert shapes == {"box", "sphere", "capsule", "cylinder", "halfspace"}
    assert limited > 0
    assert own > 0
