"""The successive cuts of a pattern on the changing ground, without the motions between them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from small_jobs import small_job

import backhoe_planner as bp
from backhoe_planner.job import BladeSweep, Worksite, build_worksite, plan_job, swept
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cycles.cut_leg import CutPath, cut_path, cut_problem
from backhoe_planner.job.cycles.patterns import NextCut, Pattern, next_cut
from backhoe_planner.job.worksite.arm_clearance import ArmOutline
from backhoe_planner.job.worksite.lanes import ENTRY, LEAVE, Lane, allowed_heights, lanes_of
from backhoe_planner.machine import Base


@pytest.mark.parametrize(("cell", "off"), [pytest.param(0.025, 0.009, marks=pytest.mark.long), (0.05, 0.031)])
def test_a_trench_is_dug_to_its_design_on_any_columns_of_the_ground(cell: float, off: float) -> None:
    """A trench of 1.4 m, 0.8 m deep: near its end boom and stick clear the ground only with the bucket curled in."""
    low = np.array([0.5, -1.5]) + off
    ground = {"low": low.tolist(), "high": (low + np.array([5.0, 3.0])).tolist(), "cell": cell}
    dig = {"trench": {"from": [3.8, 0.0], "to": [2.4, 0.0], "width": 0.6, "depth": 0.8}}
    site = build_worksite(
        small_job(ground=ground, dig=dig, site={"clearance": 0.1}, dump={"heap": {"at": [2.5, -1.3]}})
    )
    lanes, design = lanes_of(site), site.design_heights()
    allowed, _ = allowed_heights(site, lanes, design)
    now, bank, cuts = site.ground, 0.0, 0
    while isinstance(found := next_cut(site, lanes, Pattern("face", 0.4), now), NextCut):
        sweep = swept(now, BladeSweep(found.cut.position, found.cut.across, found.cut.bucket.width))
        now, bank, cuts = sweep.terrain, bank + float(sweep.bank[-1]), cuts + 1
        assert cuts < 10
    assert found is None
    assert np.max((now.surface - allowed)[site.share > 1.0 - 1e-9]) <= 0.05
    # the section less the wedges at its ends, over the width of the blade
    wedges = 0.5 * 0.8**2 * (1.0 / np.tan(ENTRY) + 1.0 / np.tan(LEAVE))
    assert bank == pytest.approx((1.4 * 0.8 - wedges) * site.bucket.width, rel=0.05)


@pytest.mark.parametrize("width", [0.7, pytest.param(0.9, marks=pytest.mark.long)])
def test_a_trench_wider_than_the_bucket_is_dug_to_its_walls(width: float) -> None:
    """A trench of 1.5 m, 0.4 m deep: no whole column remains more than the tolerance above the allowed heights."""
    dig = {"trench": {"from": [4.2, 0.0], "to": [2.7, 0.0], "width": width, "depth": 0.4}}
    ground = {"low": [0.5, -1.5], "high": [5.5, 1.5]}
    site = build_worksite(
        small_job(ground=ground, dig=dig, site={"clearance": 0.1}, dump={"heap": {"at": [2.5, -1.3]}})
    )
    lanes, design = lanes_of(site), site.design_heights()
    allowed, _ = allowed_heights(site, lanes, design)
    assert len(lanes) > 1
    now, bank, cuts = site.ground, 0.0, 0
    while isinstance(found := next_cut(site, lanes, Pattern("face", 0.4), now), NextCut):
        sweep = swept(now, BladeSweep(found.cut.position, found.cut.across, found.cut.bucket.width))
        now, bank, cuts = sweep.terrain, bank + float(sweep.bank[-1]), cuts + 1
        assert cuts < 15
    whole = site.share > 1.0 - 1e-9
    assert np.max((now.surface - allowed)[whole]) <= 0.05
    # the middle of its length has no wedges: it has the depth of the design from wall to wall
    middle = whole & (np.abs(site.nodes[..., 0] - 3.45) < 0.3)
    assert np.ptp(site.nodes[..., 1][middle]) >= width - 0.11
    assert np.max(now.surface[middle]) <= -0.35
    # at most the tolerance is dug beside it on each side, and less than the wedges at both ends is left
    assert bank <= 1.5 * (width + 0.1) * 0.4
    assert bank >= 0.9 * (1.5 * 0.4 - 0.5 * 0.4**2 * (1.0 / np.tan(ENTRY) + 1.0 / np.tan(LEAVE))) * width


def test_only_the_part_of_a_column_covered_by_the_blade_may_be_dug() -> None:
    """A column with its middle 1 cm inside a lane 0.5 m deep: 0.7 of it belongs to that, 0.3 to a lane 0.2 m deep."""
    dig = {"trench": {"from": [4.2, 0.0], "to": [2.7, 0.0], "width": 1.2, "depth": 0.5}}
    ground = {"low": [0.5, -1.505], "high": [5.5, 1.495]}  # has columns at y = 0.295 and 0.345
    site = build_worksite(
        small_job(ground=ground, dig=dig, site={"clearance": 0.1}, dump={"heap": {"at": [2.5, -1.3]}})
    )
    assert site.bucket.width == pytest.approx(0.61)
    r = np.arange(1.5, 5.0, 0.025)
    level, beside, none = np.full(len(r), -0.5), np.full(len(r), -0.2), np.zeros(len(r), dtype=np.int64)
    lanes = (
        Lane(0.0, r, level, level, level, none, (("", ""),), 4.2, 2.7),
        Lane(0.03, r, level, beside, beside, none, (("", ""),), 4.2, 2.7),
    )
    (row, *_), column = np.argwhere(np.isclose(site.ground.y, 0.295))[0], int(np.argmin(np.abs(site.ground.x - 3.5)))
    allowed, by = allowed_heights(site, lanes[:1], site.design_heights())
    assert allowed[row, column] == pytest.approx(-0.7 * 0.5, abs=0.0126)  # the rest is the ground, to half a strip
    assert allowed[row + 1, column] == pytest.approx(0.0)
    assert by[row + 1, column] == -1
    allowed, _ = allowed_heights(site, lanes, site.design_heights())
    assert allowed[row, column] == pytest.approx(-0.7 * 0.5 - 0.3 * 0.2, abs=0.0126)
    assert allowed[row - 1, column] == pytest.approx(-0.5)


@cache
def across_a_pipe(x: float) -> tuple[Worksite, tuple[Lane, ...]]:
    """A trench of 3 m, 1.2 m deep, across a pipe, and its lanes; the machine is at `x` [m], in line with it."""
    pipe = {"name": "pipe", "shape": "capsule", "from": [4.1, -4, -0.95], "to": [4.1, 4, -0.95], "radius": 0.08}
    site = build_worksite(
        small_job(
            site={
                "base": {"position": [x, 0.0], "heading": 0.0},
                "clearance": 0.1,
                "obstacles": [pipe | {"clearance": 0.3}],
            },
            ground={"low": [0.0, -1.5], "high": [7.0, 1.5]},
            dig={"trench": {"from": [4.9, 0.0], "to": [1.9, 0.0], "width": 0.6, "depth": 1.2}},
            dump={"heap": {"at": [2.2, -1.4]}},
        )
    )
    return site, lanes_of(site)


@pytest.mark.long
@pytest.mark.parametrize(
    ("x", "depth"),
    [(0.3, 0.4), (0.3, 0.55), (0.0, 0.2)],
)
def test_everything_that_may_be_dug_beside_a_pipe_is_dug(x: float, depth: float) -> None:
    """Nothing is left beside the steep ground that stays above the pipe, and every cut has a path to it."""
    site, lanes = across_a_pipe(x)
    allowed, _ = allowed_heights(site, lanes, site.design_heights())
    now, cuts = site.ground, 0
    while isinstance(found := next_cut(site, lanes, Pattern("face", depth), now), NextCut):
        path = cut_path(site, found.cut, now)
        assert isinstance(path, CutPath), path
        now = swept(now, BladeSweep(found.cut.position, found.cut.across, found.cut.bucket.width)).terrain
        cuts += 1
        assert cuts < 20
    assert found is None
    assert np.max((now.surface - allowed)[site.share > 1.0 - 1e-9]) <= 0.05


@pytest.mark.parametrize("x", [0.3, pytest.param(0.0, marks=pytest.mark.long)])
def test_the_bucket_has_room_behind_the_teeth_along_the_lowest_line(x: float) -> None:
    """At the best of many pitches, against the ground that remains; a cut keeps a gap of 3 cm."""
    site, (lane,) = across_a_pipe(x)
    back_x, back_y = site.bucket.back.T  # from the teeth
    pitches = np.arange(-3.0, -0.3, 0.01)
    dug = np.flatnonzero(np.isfinite(lane.design) & (lane.line < -0.3))
    assert len(dug) > 60
    for index in dug.tolist():
        r, z = float(lane.r[index]), float(lane.line[index])
        q = site.plane.joints(lane.swing, np.full(len(pitches), r), np.full(len(pitches), z), pitches)
        pitch = pitches[np.isfinite(q[:, 0])][:, None]
        at_r = r + back_x * np.cos(pitch) - back_y * np.sin(pitch)
        at_z = z + back_x * np.sin(pitch) + back_y * np.cos(pitch)
        room = np.where(at_r > r, at_z - np.interp(at_r, lane.r, lane.line), np.inf)
        assert float(room.min(axis=1).max()) > 0.03, (r, z)


def test_the_arm_clears_level_ground_up_to_the_lowest_corner_of_boom_and_stick() -> None:
    site, _ = across_a_pipe(0.3)
    robot = site.robot
    q = np.array([robot.random_q(np.random.default_rng(seed)) for seed in range(20)])
    data, lowest = robot.model.createData(), np.full(len(q), np.inf)
    for k, row in enumerate(q):
        pin.forwardKinematics(robot.model, data, row)
        for one in robot.pieces:
            if 2 <= one.joint < robot.n:
                heights = [data.oMi[one.joint].act(corner)[2] for corner in np.asarray(one.piece.hull)]
                lowest[k] = min(lowest[k], min(heights) - float(one.piece.radius))
    r = np.array([-10.0, 10.0])
    for k, row in enumerate(q):
        for off, clear in ((-1e-3, True), (1e-3, False)):
            level = np.full(2, lowest[k] + off)
            assert site.arm.clears(row[None], (r, level)).tolist() == [clear]
            np.testing.assert_array_equal(site.arm.clears(q, (r, level))[k], clear)


def test_the_arm_clears_a_wall_beyond_its_outermost_corner(backhoe: bp.Robot) -> None:
    """The machine is away from the origin and turned, and the ground is low up to the wall."""
    robot = backhoe.with_base(Base((3.0, -2.0), 0.7))
    plane = ArmPlane(robot)
    arm, data, r = ArmOutline(plane, clearance=0.1), robot.model.createData(), np.arange(0.1, 8.0, 0.025)
    for q in (robot.random_q(np.random.default_rng(seed)) for seed in range(20)):
        pin.forwardKinematics(robot.model, data, q)
        out, _ = plane.directions(float(q[0]))
        pieces = [one for one in robot.pieces if 2 <= one.joint < robot.n]
        corners = np.array([data.oMi[one.joint].act(corner) for one in pieces for corner in one.piece.hull])
        farthest = float(np.max((corners[:, :2] - plane.axis) @ out))
        for wall, clear in ((farthest + 0.03, True), (farthest - 0.03, False)):
            assert arm.clears(q[None], (r, np.where(r > wall, 10.0, -10.0))).tolist() == [clear]


@pytest.mark.parametrize("stick", [(-2.8, -0.1), (0.1, 2.8)])
def test_the_elbow_is_on_the_side_that_the_limits_allow(backhoe: bp.Robot, stick: tuple[float, float]) -> None:
    lower, upper = np.array([-1.5, -3.0, stick[0], -3.0]), np.array([1.5, 3.0, stick[1], 3.0])
    plane = ArmPlane(backhoe, limits=replace(backhoe.limits, lower=lower, upper=upper))
    r, z, pitch = np.linspace(2.0, 4.5, 12), np.linspace(-1.5, 1.5, 12), np.linspace(-2.4, -0.4, 12)
    q = plane.joints(0.3, r, z, pitch)
    found = ~np.isnan(q[:, 0])
    assert np.count_nonzero(found) > 8
    assert np.all((q[found, 2] >= stick[0]) & (q[found, 2] <= stick[1]))
    np.testing.assert_allclose(np.column_stack(plane.place(q[found])), np.column_stack((r, z, pitch))[found], atol=1e-9)


def test_joints_for_many_rows_of_places_equal_those_for_each_row() -> None:
    """All of them put the teeth at the requested places."""
    site, (lane,) = across_a_pipe(0.3)
    r, z = np.meshgrid(np.linspace(1.0, 5.5, 10), np.linspace(-2.0, 3.0, 7), indexing="ij")
    pitch = np.linspace(-2.5, 0.5, 7)
    q = site.plane.joints(lane.swing, r, z, pitch)
    for row, at_r, at_z in zip(q, r, z, strict=True):
        np.testing.assert_array_equal(row, site.plane.joints(lane.swing, at_r, at_z, pitch))
    found = ~np.isnan(q[..., 0])
    assert 10 < np.count_nonzero(found) < found.size
    wanted = np.stack([r, z, np.broadcast_to(pitch, r.shape)])[:, found]
    np.testing.assert_allclose(site.plane.place(q[found]), wanted, atol=1e-9)


@pytest.mark.parametrize(
    "width", [pytest.param(0.67, marks=pytest.mark.long), pytest.param(0.75, marks=pytest.mark.long)]
)
def test_the_proof_of_a_cut_along_a_wall_counts_all_soil_and_holds_after_loading(width: float, tmp_path: Path) -> None:
    """Along a wall the ends of the blade take soil that a profile of its middle does not contain."""
    dig = {"trench": {"from": [4.2, 0.0], "to": [2.9, 0.0], "width": width, "depth": 0.4}}
    plan = plan_job(small_job(dig=dig, pattern={"face": 0.4}), effort="quick")
    assert plan.verified, plan.note
    assert any(cycle.step == "walls" for cycle in plan.cycles)
    site = build_worksite(plan.job)
    for cycle in plan.cycles:
        motion = next(leg.trajectory for leg in cycle.legs if leg.name == "cut")
        problem = cut_problem(site, cycle.load, cycle.digging, site.problem, cycle.before)
        assert problem.ground is not None
        depth = problem.ground.contact(site.plane.kinematics.at(motion.q).tip_position).depth
        seen = site.bucket.width * abs(np.trapezoid(np.maximum(depth, 0.0), site.plane.place(motion.q)[0]))
        assert seen > 0.9 * (cycle.bank + cycle.taken)
    plan.save(tmp_path / "job.json")
    assert bp.load_job_plan(tmp_path / "job.json").verified
