"""Motion between two samples is checked, however far apart they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import SAMPLE_PERIOD, build_problem, drive_of, limit_usage
from backhoe_planner.proof import motion_is_clear
from backhoe_planner.proof.clearances import find_clearances
from backhoe_planner.site.distances.cluster_distances import ClusterDistances

TURNTABLE = """<robot name="turntable"><link name="base"/><link name="table"/>
<link name="rod"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="table"/><child link="rod"/><axis xyz="1 0 0"/>
  <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    path: Path = tmp_path_factory.mktemp("turntable") / "turntable.urdf"
    path.write_text(TURNTABLE)
    return bp.load_robot(path, tip="rod")


@pytest.mark.parametrize(("tolerance", "verified"), [(0.046, False), (0.063, True)])
def test_the_error_of_a_slide_outboard_of_a_hinge_is_bounded_between_samples(
    turntable: bp.Robot, tolerance: float, verified: bool
) -> None:
    """Both samples are on the path; halfway the tip is 0.1 sin(0.5) = 0.0479 m off it.

    The bound is (0.1 * 1 + 2 * 0.2 * 1) / 8 = 0.0625 m.
    """
    end = [0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 0.0]
    path = {"waypoints": [{"position": [-0.1, 0.0, 0.0]}, {"position": end}], "tolerance": tolerance}
    scene = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    motion = bp.Trajectory.from_steps(np.array([0.0, 1000.0]), np.array([[0.0, -0.1], [1.0, 0.1]]))
    certificate = bp.certify(turntable, scene, motion)
    assert certificate.verified == verified
    if verified:
        assert certificate.tracking.max_error == pytest.approx(0.0625)


# --- turning along a path -----------------------------------------------------------------

SPINDLE = """<robot name="spindle"><link name="base"/><link name="carriage"/>
<link name="tool"><collision><geometry><sphere radius="0.01"/></geometry></collision></link><link name="tip"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="spin" type="revolute"><parent link="carriage"/><child link="tool"/><axis xyz="0 -1 0"/>
  <limit lower="-20" upper="20" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="tool"/><child link="tip"/><origin xyz="{lever} 0 0"/></joint></robot>"""


def spindle(folder: Path, lever: float) -> bp.Robot:
    """A tool that turns about the axis along which it slides; its pitch is the angle, upwards."""
    path = folder / "spindle.urdf"
    path.write_text(SPINDLE.format(lever=lever))
    return bp.load_robot(path, tip="tip")


def along_y(
    robot: bp.Robot, turns: list[float], *, asked: list[dict[str, object]], tolerance: float = 0.005
) -> bp.Certificate:
    """The certificate of a slide from 0 to 0.4 m in equal steps, the tool at `turns`; `asked` at the path's ends."""
    lever = float(bp.Kinematics(robot).at(np.zeros(2)).tip_position[0])
    ends = [[lever, 0.0, 0.0], [lever, 0.4, 0.0]]
    waypoints = [{"position": p} | extra for p, extra in zip(ends, asked, strict=True)]
    scene = bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": waypoints, "tolerance": tolerance}}})
    q = np.column_stack((np.linspace(0.0, 0.4, len(turns)), turns))
    return bp.certify(robot, scene, bp.Trajectory.from_steps(np.linspace(0.0, 1e4, len(turns)), q))


LEVEL: dict[str, object] = {"rpy": [0, 0, 0]}


@pytest.mark.parametrize("turns", [1, -1, 3])
@pytest.mark.parametrize("samples", [2, 3, 4])
def test_whole_turns_between_samples_break_the_requested_orientation(tmp_path: Path, turns: int, samples: int) -> None:
    """At every sample the tip has the requested position and orientation."""
    angles = (2.0 * np.pi * turns * np.arange(samples)).tolist()
    certificate = along_y(spindle(tmp_path, 0.0), angles, asked=[LEVEL, LEVEL])
    assert not certificate.verified
    assert any("orientation" in problem for problem in certificate.problems)


def test_a_whole_turn_between_two_samples_breaks_a_range_of_pitch(tmp_path: Path) -> None:
    level: dict[str, object] = {"pitch": [-0.2, 0.2]}
    robot = spindle(tmp_path, 0.1)
    assert along_y(robot, [0.0, 0.1, -0.1], asked=[level, level], tolerance=0.8).verified
    assert not along_y(robot, [0.0, 2.0 * np.pi], asked=[level, level], tolerance=0.8).verified


@pytest.mark.parametrize(("off", "verified"), [(0.0, True), (0.0095, True), (0.0105, False)])
def test_an_orientation_that_turns_with_the_path_is_kept_by_two_samples(
    tmp_path: Path, off: float, verified: bool
) -> None:
    """The path requests a turn by -1 rad about y, and the tool makes it; 0.01 rad are allowed."""
    asked: list[dict[str, object]] = [LEVEL, {"rpy": [0, -1, 0]}]
    certificate = along_y(spindle(tmp_path, 0.0), [off, 1.0 + off], asked=asked)
    assert certificate.verified == verified
    if verified:
        assert certificate.tracking.max_angle_error == pytest.approx(off, abs=1e-3)
        assert certificate.tracking.max_angle_error >= off


def test_a_turn_between_two_samples_is_a_detour(tmp_path: Path) -> None:
    """One turn in the middle of 21 samples: that part is off the path, as with many samples."""
    robot = spindle(tmp_path, 0.0)
    still = [0.0] * 10 + [2.0 * np.pi] * 11
    few = along_y(robot, still, asked=[LEVEL, LEVEL])
    (detour,) = few.detours
    many = along_y(robot, np.interp(np.linspace(0, 20, 1001), np.arange(21), still).tolist(), asked=[LEVEL, LEVEL])
    (expected,) = many.detours
    # the step from 0.18 to 0.20 m, and one step of `few` to each side
    assert detour.path_from == pytest.approx(0.16)
    assert detour.path_to == pytest.approx(0.22)
    assert few.tracking.left_out == pytest.approx(0.06)
    assert detour.path_from < expected.path_from < expected.path_to < detour.path_to


# --- corners ------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [2, 3, 4, 16, 151])
def test_few_samples_do_not_hide_an_acceleration(planar4: bp.Robot, samples: int) -> None:
    """3 rad in 3 s at one rate: from rest to 1 rad/s within 0.02 s is 50 rad/s^2."""
    end = [4.0 * np.cos(3.0), 4.0 * np.sin(3.0), 0.0]
    content = {
        "version": 1,
        "start": {"joints": {f"joint{j}": 0.0 for j in range(1, 5)}},
        "task": {"goal": {"position": end}},
        "limits": {"acceleration": {"joint1": 0.35}},
    }
    part = np.linspace(0.0, 1.0, samples)
    motion = bp.Trajectory.from_steps(3.0 * part, np.outer(part, [3.0, 0.0, 0.0, 0.0]))
    certificate = bp.certify(planar4, bp.scene_from_dict(content), motion)
    assert certificate.acceleration.ratio == pytest.approx(50.0 / 0.35, rel=1e-6)
    assert not certificate.safe
    assert any("acceleration" in problem for problem in certificate.problems)


@pytest.mark.parametrize("rest", [0.0, 10.0])
def test_rest_before_a_start_does_not_hide_its_acceleration(planar4: bp.Robot, rest: float) -> None:
    """0.1 rad/s at once is 5 rad/s^2, also after a long rest."""
    time = np.array([0.0, 1.0]) if rest == 0.0 else np.array([0.0, rest, rest + 1.0])
    q = np.zeros((len(time), 4))
    q[-1, 0] = 0.1
    problem = build_problem(planar4, bp.scene_from_dict({"version": 1, **GOAL}))
    usage = limit_usage(problem, bp.Trajectory.from_steps(time, q))
    column = usage.ratio[:, usage.names.index("acceleration joint1")]
    at_samples = column[np.diff(usage.moments.segment, prepend=-1) > 0]
    np.testing.assert_allclose(at_samples, [2.5, 2.5] if rest == 0.0 else [0.0, 2.5, 2.5])


GOAL = {
    "start": {"joints": {f"joint{j}": 0.0 for j in range(1, 5)}},
    "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
}


def rounded(motion: bp.Trajectory, step: float) -> bp.Trajectory:
    """The motion with its corners rounded off at constant acceleration within 0.02 s around each sample."""
    half = 0.5 * SAMPLE_PERIOD
    time = np.arange(0.0, motion.duration + 2.0 * half + 0.5 * step, step)
    q = np.tile(motion.q[0], (len(time), 1))
    for moment, change in zip(motion.time, motion.velocity_changes(), strict=True):
        since = np.clip(time - moment, 0.0, 2.0 * half)  # all is half a period later
        beyond = np.maximum(time - moment - 2.0 * half, 0.0)
        q += np.outer(since**2 / (4.0 * half) + beyond, change)
    return bp.Trajectory.from_steps(time, q)


@pytest.mark.parametrize("seed", range(4))
def test_the_limit_use_of_a_coarse_motion_is_that_of_its_rounded_corners(backhoe: bp.Robot, seed: int) -> None:
    """Acceleration, torque and power at corners: not less than in 1 ms samples of the rounded motion, nor much more.

    In 1 ms the velocity changes by a twentieth of the jump.
    """
    rng = np.random.default_rng(seed)
    q = np.array([0.0, 0.2, -1.2, -0.9]) + rng.uniform(-0.05, 0.05, (6, 4))
    coarse = bp.Trajectory.from_steps(np.linspace(0.0, 5.0, 6), q)
    joints = dict(zip(backhoe.joint_names, q[0].tolist(), strict=True))
    tip = bp.Kinematics(backhoe).at(q[-1]).tip_position.tolist()
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": tip}}, "payload": 300.0}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    few, many = limit_usage(problem, coarse), limit_usage(problem, rounded(coarse, 0.001))
    for name, most, expected in zip(few.names, few.ratio.max(axis=0), many.ratio.max(axis=0), strict=True):
        if name.startswith(("acceleration", "torque", "engine")):
            assert 0.995 * expected <= most <= 1.15 * expected, name


@pytest.mark.parametrize("period", [0.045, 0.1])
@pytest.mark.parametrize("samples", [4, 5, 6])
def test_a_coarse_cut_that_brakes_counts_what_it_takes_between_its_corners(
    backhoe: bp.Robot, period: float, samples: int
) -> None:
    """Inertia helps at every corner; in between, the joints move evenly against soil and weight, by a few mrad."""
    pitches = ((4.2, -1.6), (3.9, -1.7))
    targets = [bp.TipTarget(np.array([x, 0.0, -0.3]), pitch=(pitch, pitch)) for x, pitch in pitches]
    begin, end = (bp.solve_inverse_kinematics(backhoe, target).q for target in targets)
    at = {"joints": dict(zip(backhoe.joint_names, begin.tolist(), strict=True))}
    content = {"version": 1, "start": at, "task": {"goal": at}, "soil": {"cohesion": 3000.0}}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    left = 1.0 - np.linspace(0.0, 1.0, samples)
    time = np.linspace(0.0, period * (samples - 1), samples)
    motion = bp.Trajectory.from_steps(time, begin + 0.1 * (1.0 - left**2)[:, None] * (end - begin))
    middle = 0.5 * (motion.q[1:] + motion.q[:-1])
    within = drive_of(problem).use(middle, motion.segment_velocities(), np.zeros_like(middle))
    usage = limit_usage(problem, motion)
    most = dict(zip(usage.names, usage.ratio.max(axis=0).tolist(), strict=True))
    assert most["engine power"] >= np.max(within.power) > 0.01
    assert max(most[f"torque {name}"] for name in backhoe.joint_names) >= np.max(within.effort)


@pytest.mark.parametrize(("tolerance", "verified"), [(None, False), (0.049, False), (0.051, True)])
def test_the_rotation_tolerance_of_a_path_limits_the_angle_error(
    tmp_path: Path, tolerance: float | None, verified: bool
) -> None:
    """The tool is 0.05 rad from the requested angle all along."""
    robot = spindle(tmp_path, 0.2)
    high = 0.2 * np.sin(0.35)
    ends = [{"position": [0.2 * np.cos(0.35), y, high], "pitch": 0.3} for y in (-0.5, 0.5)]
    path = {"waypoints": ends} | ({} if tolerance is None else {"rotation_tolerance": tolerance})
    scene = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    motion = bp.Trajectory.from_steps(np.array([0.0, 1000.0]), np.array([[-0.5, 0.35], [0.5, 0.35]]))
    found = bp.certify(robot, scene, motion)
    assert found.verified is verified, found.problems
    if verified:
        assert found.tracking.max_angle_error == pytest.approx(0.05, abs=1e-9)


def test_a_turn_between_two_samples_of_a_path_breaks_the_pitch_to_keep(tmp_path: Path) -> None:
    """Both samples keep the pitch; halfway the tool points backwards."""
    robot = spindle(tmp_path, 0.04)
    ends = [{"position": [0.04, y, 0.0]} for y in (-0.5, 0.5)]
    task = {"path": {"waypoints": ends, "tolerance": 0.9}, "keep": {"pitch": [-0.2, 0.2]}}
    scene = bp.scene_from_dict({"version": 1, "task": task})
    for turn, kept in ((0.0, True), (0.1, True), (2.0 * np.pi, False)):
        q = np.array([[-0.5, 0.0], [0.5, turn]])
        (use,) = bp.certify(robot, scene, bp.Trajectory.from_steps(np.array([0.0, 1000.0]), q)).keep
        assert use.kept is kept
    assert use.time == pytest.approx(500.0)
    assert use.margin == pytest.approx(0.2 - np.pi)


def test_the_link_that_seems_nearest_to_the_ground_is_measured_first(
    backhoe: bp.Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the piece that seems nearest to the ground is measured without a limit of distance."""
    heights = np.random.default_rng(4).normal(-0.6, 0.005, (81, 81))
    np.savetxt(tmp_path / "ground.csv", heights, delimiter=",")
    ground = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [20.0, 20.0], "clearance": 0.1}
    task = {"goal": {"joints": {"swing": 0.5, "boom": 0.7, "stick": -1.2, "bucket": -1.2}}}
    start = {"joints": {"swing": -0.5, "boom": 0.7, "stick": -1.2, "bucket": -1.2}}
    scene = bp.scene_from_dict({"version": 1, "start": start, "task": task, "obstacles": [ground]}, folder=tmp_path)
    q = np.tile([0.0, 0.7, -1.2, -1.2], (101, 1))
    q[:, 0] = np.linspace(-0.5, 0.5, 101)
    motion = bp.Trajectory.from_steps(np.linspace(0.0, 4.0, 101), q)
    reaches, nearest = [], ClusterDistances.nearest

    def counted(self: ClusterDistances, *given: Any, reach: float, **named: Any) -> Any:
        reaches.append(reach)
        return nearest(self, *given, reach=reach, **named)

    monkeypatch.setattr(ClusterDistances, "nearest", counted)
    (found,) = (one for one in bp.certify(backhoe, scene, motion).clearances if one.name == "ground")
    far = sum(reach > 5.0 for reach in reaches)
    proximity = bp.Proximity(backhoe, bp.build_obstacles(scene, backhoe), self_collision=False)
    true = min(proximity.distance_of(pair, row) for row in q[::5] for pair in range(len(proximity.pairs))) - 0.1
    assert 0.97 * true <= found.margin <= true
    assert far == 1


# --- motions of many samples --------------------------------------------------------------

SLIDE = """<robot name="slide"><link name="base"/>
<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="ball"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"""


def passing(folder: Path, clearance: float, **obstacle: object) -> tuple[bp.Proximity, bp.Trajectory]:
    """A ball passes a sphere in 201 samples, 0.06 - 0.01 - 0.03 = 0.02 m away at 0.7 of the time."""
    path = folder / "slide.urdf"
    path.write_text(SLIDE)
    robot = bp.load_robot(path, tip="ball")
    sphere = {"name": "post", "shape": "sphere", "radius": 0.03, "position": [0.4, 0.06, 0.0], "clearance": clearance}
    scene = bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": {"slide": 0}},
            "task": {"goal": {"joints": {"slide": 0}}},
            "obstacles": [sphere | obstacle],
        }
    )
    q = np.linspace(-1.0, 1.0, 201)[:, None]
    return bp.Proximity(robot, bp.build_obstacles(scene, robot)), bp.Trajectory.from_steps(
        np.linspace(0.0, 10.0, 201), q
    )


@pytest.mark.parametrize("clearance", [0.019, 0.021])
def test_the_nearest_of_many_samples_decides_the_clearance(tmp_path: Path, clearance: float) -> None:
    proximity, motion = passing(tmp_path, clearance)
    (nearest,) = find_clearances(proximity, motion)
    assert nearest.distance == pytest.approx(0.02, abs=1.1e-4)
    assert nearest.distance <= 0.02
    assert nearest.time == pytest.approx(7.0, abs=0.05)
    assert motion_is_clear(proximity, motion.time, motion.q) == (clearance < 0.02)


@pytest.mark.parametrize(("appears", "distance"), [(6.0, 0.02), (7.53, np.hypot(0.106, 0.06) - 0.04)])
def test_an_obstacle_that_appears_between_two_samples_counts_from_then_on(
    tmp_path: Path, appears: float, distance: float
) -> None:
    """At 7.53 s the ball is at 0.506, 0.106 m past the sphere and moving away."""
    for clearance, clear in ((distance + 1e-3, False), (0.9 * distance, True)):
        proximity, motion = passing(tmp_path, clearance, appears_at=appears)
        (nearest,) = find_clearances(proximity, motion)
        assert nearest.distance == pytest.approx(distance, abs=2e-4)
        assert motion_is_clear(proximity, motion.time, motion.q) == clear


def test_the_distance_to_an_approaching_obstacle_is_that_of_the_moment(tmp_path: Path) -> None:
    """From y = 0.16 at 0.01 m/s the sphere is at 0.09 at 7 s, when the ball passes it."""
    proximity, motion = passing(tmp_path, 0.01, position=[0.4, 0.16, 0.0], velocity=[0.0, -0.01, 0.0])
    (nearest,) = find_clearances(proximity, motion)
    y = 0.16 - 0.01 * motion.time
    dense = np.hypot(motion.q[:, 0] - 0.4, y).min() - 0.04
    assert dense - 1e-3 <= nearest.distance <= dense
    assert motion_is_clear(proximity, motion.time, motion.q)
