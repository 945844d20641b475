"""What stands on the ground of a point cloud: told from the ground, kept as an obstacle, never dug away."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull
from small_jobs import TINY, small_job

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.job import (
    Job,
    OffGround,
    Terrain,
    build_worksite,
    ground_warnings,
    job_from_dict,
    join_voxels,
    load_job_plan,
    off_ground_obstacles,
    plan_job,
    read_ground,
    scanned,
)
from backhoe_planner.job.ground.grids import HeightGrid, empty_grid
from backhoe_planner.job.ground.raised import raised_beyond
from backhoe_planner.job.ground.scanned import scanned_around
from backhoe_planner.job.ground.surveys import split
from backhoe_planner.job.worksite.checks import check_place
from backhoe_planner.site import read_points

LOW, HIGH, CELL = (0.0, -2.0), (6.0, 2.0), 0.1


def grid(low: tuple[float, float], high: tuple[float, float], step: float) -> Matrix:
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1e-9, step), np.arange(low[1], high[1] + 1e-9, step))
    return np.column_stack((x.ravel(), y.ravel()))


def at(places: Matrix, z: float | Matrix) -> Matrix:
    return np.column_stack((places, np.broadcast_to(z, len(places))))


def upright(x: tuple[float, float], y: float, height: float, step: float) -> Matrix:
    """Points of a wall along x, from the ground up."""
    places = grid((x[0], 0.0), (x[1], height), step)
    return np.column_stack((places[:, 0], np.full(len(places), y), places[:, 1]))


LEVEL = at(grid(LOW, HIGH, CELL), 0.0)


def ground_of(points: Matrix, roughness: float = 0.15) -> Terrain:
    return Terrain.from_points(points, LOW, HIGH, CELL, roughness=roughness)


def test_what_stands_is_told_from_the_ground_and_the_ground_under_it_is_that_around_it() -> None:
    """A wall of 2 m, a canopy above the ground, and a roof of 2 x 3 m that hides the ground, at 1.5 m."""
    wall = upright((1.0, 3.0), -1.0, 2.0, 0.1)
    canopy = at(grid((4.0, 0.0), (5.0, 1.0), 0.1), 3.0)
    roof = at(grid((0.5, 0.0), (3.5, 1.9), 0.1), 1.5)
    is_open = ~((LEVEL[:, 0] > 0.45) & (LEVEL[:, 0] < 3.55) & (LEVEL[:, 1] > -0.05) & (LEVEL[:, 1] < 1.95))
    # a slope of 0.1 m per m along x lies under all of them
    for slope in (0.0, 0.1):
        points = np.vstack((LEVEL[is_open], wall, canopy, roof))
        points[:, 2] += slope * points[:, 0]
        found = ground_of(points)
        np.testing.assert_allclose(found.surface, np.tile(slope * found.x, (found.shape[0], 1)), atol=1e-9)
        assert found.off_ground is not None
        stands = points[points[:, 2] > slope * points[:, 0] + 0.15 + slope * CELL]
        keys = {tuple(key) for key in found.off_ground.keys.tolist()}
        assert {tuple(key) for key in np.floor(stands / found.off_ground.edge).astype(int).tolist()} <= keys
        # under the roof nothing was seen, and the space below counts; under the canopy the ground was seen
        middle = {(19, 9, z) for z in range(2, 15)}
        assert found.off_ground.edge == CELL
        assert middle <= keys
        assert not any(x == 45 and y == 5 and z < 28 for x, y, z in keys)
        assert len(found.off_ground.things) == 3
    # nothing stands for whoever says so
    assert ground_of(points, roughness=5.0).off_ground is None


def test_slopes_steps_and_heaps_are_ground() -> None:
    """Nothing stands, and every column has the mean of its points, as it always had."""
    places = grid((-0.04, -2.04), (6.04, 2.04), 0.04)
    x, y = places.T
    rng = np.random.default_rng(3)
    noise = rng.uniform(-0.03, 0.03, len(places))
    heap = np.maximum(1.2 - np.tan(0.8) * np.hypot(x - 4.0, y), 0.0)
    bank = np.where(x < 2.0, 0.0, -1.2)
    step = np.column_stack((np.full(800, 2.0), rng.uniform(-2.0, 2.0, 800), rng.uniform(-1.2, 0.0, 800)))
    for points in (at(places, 1.5 * x), at(places, heap + noise), np.vstack((at(places, bank + noise), step))):
        found = ground_of(points)
        assert found.off_ground is None
        row = 20  # y = 0
        here = np.abs(points[:, 1]) <= 0.05 - 1e-9
        mean = [points[here & (np.abs(points[:, 0] - one) < 0.05 - 1e-9), 2].mean() for one in found.x[1:-1]]
        np.testing.assert_allclose(found.surface[row, 1:-1], mean, atol=1e-9)


def test_stray_points_below_the_ground_do_not_turn_it_into_a_thing() -> None:
    """A column in every square metre or so has a point 2 m below; the wall stands on another one."""
    stray = LEVEL[37::97] - [0.0, 0.0, 2.0]
    wall = upright((1.0, 3.0), -1.0, 2.0, 0.1)
    found = ground_of(np.vstack((LEVEL, stray, [[2.0, -1.0, -2.0]], wall)))
    assert found.off_ground is not None
    stands = wall[wall[:, 2] > 0.15]
    assert {tuple(key) for key in found.off_ground.keys.tolist()} == {
        tuple(key) for key in np.floor(stands / CELL).astype(int).tolist()
    }
    assert np.all(found.surface == 0.0)
    # a third of the columns has no point, and some have a stray one alone
    seen = np.random.default_rng(8).random(len(LEVEL)) < 0.67
    sparse = split(np.vstack((LEVEL[seen], stray)), empty_grid(LOW, HIGH, CELL), 0.15)
    assert sparse.off_ground is None
    known = np.isfinite(sparse.heights.z)
    assert 0.6 < known.mean() < 0.75
    assert np.all(sparse.heights.z[known] == 0.0)
    # a pit of 2 x 2 columns is no stray point
    pit = LEVEL - [[0.0, 0.0, 1.0]] * np.isin(np.arange(len(LEVEL)), [900, 901, 961, 962])[:, None]
    assert np.count_nonzero(ground_of(pit).surface == -1.0) == 4


def test_a_warning_says_how_many_columns_have_something_on_them(tmp_path: Path) -> None:
    wall = upright((3.0, 5.0), -1.0, 2.0, 1.0)
    keys = {"file": "ground.xyz", "cell": CELL, "low": list(LOW), "high": list(HIGH)}
    content = small_job().to_dict() | {"ground": keys}
    np.savetxt(tmp_path / "ground.xyz", np.vstack((LEVEL, wall)))
    (found,) = ground_warnings(job_from_dict(content, folder=tmp_path))
    # three columns: x 3, 4 and 5
    assert "on 3 of 2501 columns something stands, up to 2.00 m high at x 3.00, y -1.00" in found
    assert "far apart" in found
    np.savetxt(tmp_path / "ground.xyz", np.vstack((LEVEL, wall, [[8.0, 0.0, 0.0], [8.0, 0.0, 3.0]])))
    (found,) = ground_warnings(job_from_dict(content, folder=tmp_path))
    assert "1 points stand beyond the modelled ground" in found
    np.savetxt(tmp_path / "ground.xyz", LEVEL)
    assert ground_warnings(job_from_dict(content, folder=tmp_path)) == ()
    assert ground_warnings(small_job()) == ()


def test_a_cloud_is_read_once_for_warnings_and_worksites_and_again_if_it_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []

    def counting(file: Path, **keys: tuple[float, ...]) -> Matrix:
        read.append(file)
        return read_points(file, **keys)

    monkeypatch.setattr("backhoe_planner.job.ground.surveys.read_points", counting)
    for count, wall in ((1, WALL), (2, WALL + np.array([0.0, 0.5, 0.0]))):
        job = walled_job(tmp_path, wall)
        (words,) = ground_warnings(job)
        sites = [build_worksite(job), build_worksite(job)]
        assert len(read) == count
        assert f"y {wall[0, 1]:.2f}" in words
        assert sites[0].ground.off_ground is sites[1].ground.off_ground


def walled_job(folder: Path, wall: Matrix) -> Job:
    """Half of the trench of `TINY`, half as deep, on its level ground, and a wall from a cloud."""
    low, high = TINY["ground"]["low"], TINY["ground"]["high"]
    np.savetxt(folder / "ground.xyz", np.vstack((at(grid(low, high, 0.05), 0.0), wall)), fmt="%.4f")
    trench = TINY["dig"]["trench"] | {"to": [3.7, 0.0], "depth": 0.2}
    keys = {"ground": {"file": "ground.xyz", "low": low, "high": high}, "dig": {"trench": trench}}
    return job_from_dict(TINY | keys, folder=folder)


WALL = upright((2.6, 5.0), -1.4, 2.0, 0.05) + 0.02  # across the swing from the trench to the heap


def test_a_job_is_planned_around_a_wall_that_its_ground_contains(tmp_path: Path) -> None:
    job = walled_job(tmp_path, WALL)
    plan = plan_job(job, effort="quick")
    assert plan.verified
    assert plan.start.surface.max() <= 0.02
    assert plan.cycles[-1].after.off_ground is plan.start.off_ground
    names = {obstacle.name for leg in plan.cycles[0].legs for obstacle in leg.problem.obstacles}
    assert "what stands at x 3.8, y -1.4 m" in names
    # no point of the wall is in a hull of the machine
    stands = WALL[WALL[:, 2] > 0.15]
    pieces = [(one.joint, ConvexHull(one.piece.hull).equations, one.piece.radius)
              for one in plan.robot.pieces if len(one.piece.hull) > 3]  # fmt: skip
    data, off = plan.robot.model.createData(), []
    for q in np.vstack([leg.trajectory.q[::10] for cycle in plan.cycles for leg in cycle.legs]):
        pin.forwardKinematics(plan.robot.model, data, q)
        for joint, planes, radius in pieces:
            place = data.oMi[joint]
            local = (stands - place.translation) @ place.rotation
            off.append((local @ planes[:, :3].T + planes[:, 3]).max(axis=1).min() - radius)
    assert min(off) > 0.0
    # read again, it holds on the same wall, and not on a file whose wall is elsewhere
    plan.save(tmp_path / "plan.json")
    assert load_job_plan(tmp_path / "plan.json").verified
    walled_job(tmp_path, WALL + np.array([0.0, 0.1, 0.0]))
    refuted = load_job_plan(tmp_path / "plan.json")
    assert "the ground before the first cycle is not that of the job" in refuted.note


def test_no_soil_is_dumped_where_something_stands(tmp_path: Path) -> None:
    """A sheet over the heap, 1 m above the ground; one 4 m above it leaves room for heap and bucket."""
    sheet = at(grid((2.0, -3.2), (2.8, -2.4), 0.05), 1.0)
    with pytest.raises(InputError, match=r"dump\.heap\.at: is where something stands"):
        plan_job(walled_job(tmp_path, sheet))
    site = build_worksite(walled_job(tmp_path, sheet + np.array([0.0, 0.0, 3.0])))
    assert site.ground.off_ground is not None
    assert not site.taken.any()


def test_a_motion_through_a_wall_is_refuted_with_its_name(tmp_path: Path) -> None:
    """A plan for the ground without the wall, read with the wall in the ground and in its file."""
    plan = plan_job(walled_job(tmp_path, WALL[:0]), effort="quick")
    assert plan.verified
    assert plan.start.off_ground is None
    plan.save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text())
    walled_job(tmp_path, np.vstack((WALL, through_the_tractor(1.0))))
    # 49 columns along x; in each, points from 0.17 to 2.02 m; and 60 across the tractor
    stacks = [[x, -28, 3, 38] for x in range(52, 101)] + [[-30, y, 3, 17] for y in range(-30, 30)]
    content["ground"]["off_ground"] = {"edge": 0.05, "stacks": stacks}
    (tmp_path / "plan.json").write_text(json.dumps(content))
    found = load_job_plan(tmp_path / "plan.json")
    assert not found.verified
    assert "what stands at x 3.8, y -1.4 m" in found.note
    assert found.start.off_ground is not None
    assert len(found.start.off_ground.keys) == 49 * 38 + 60 * 17
    assert "chassis of the machine is in what stands at x -1.5, y 0.0 m" in found.note


def test_what_stands_in_a_survey_during_a_job_is_kept(tmp_path: Path) -> None:
    """The wall of the first scan stays where the second does not look; what that one sees is added."""
    job = walled_job(tmp_path, WALL)
    own = build_worksite(job).ground
    assert own.off_ground is not None
    places = grid(TINY["ground"]["low"], TINY["ground"]["high"], 0.05)
    seen = places[places[:, 1] > -1.0]
    dug = np.where((np.abs(seen[:, 1]) < 0.26) & (np.abs(seen[:, 0] - 3.7) < 0.46), -0.2, 0.0)
    post = np.column_stack((np.full(20, 1.0), np.full(20, 0.5), np.linspace(0.0, 1.0, 20)))
    np.savetxt(tmp_path / "scan.xyz", np.vstack((at(seen, dug), post)), fmt="%.4f")
    found = read_ground(job, tmp_path / "scan.xyz")
    assert found.terrain.loose_volume == 0.0
    assert found.terrain.bank_volume_below(own) == pytest.approx(np.count_nonzero(dug) * 0.05**2 * 0.2, rel=1e-6)
    assert found.terrain.off_ground is not None
    stays = {tuple(key) for key in own.off_ground.keys.tolist()}
    now = {tuple(key) for key in found.terrain.off_ground.keys.tolist()}
    assert found.terrain.off_ground.edge == own.off_ground.edge
    assert stays < now
    assert all(np.allclose([0.025 + 0.05 * x, 0.05 * y], [1.0, 0.5], atol=0.06) for x, y, _ in now - stays)
    assert "up to 1.00 m high at x 1.00, y 0.50" in found.remark


@pytest.mark.parametrize("name", ["scan.xyz", "scan.csv"])
def test_ground_that_was_heaped_beyond_the_modelled_ground_is_an_obstacle(name: str, tmp_path: Path) -> None:
    """The job's ground ends at x = 5.5 m. A later survey has a bank there, from 6 m on, that rises by 0.6 to 1.5 m."""
    job = job_from_dict(TINY | {"ground": TINY["ground"] | {"cell": 0.1}}, folder=tmp_path)
    known = Terrain.level(0.0, (0.5, -4.5), (5.5, 1.0), 0.1)
    places = grid((0.5, -4.5), (11.0, 1.0), known.cell)
    heights = np.clip(0.6 * (places[:, 0] - 6.0), 0.0, 1.5)
    if name.endswith(".csv"):
        np.savetxt(tmp_path / name, heights.reshape(-1, len(np.unique(places[:, 0]))), delimiter=",", fmt="%.4f")
        found = scanned(known, tmp_path / name, low=known.low, cell=known.cell)
    else:
        np.savetxt(tmp_path / name, at(places, heights), fmt="%.4f")
        found = read_ground(job, tmp_path / name)
        names = [one.name for one in build_worksite(job, terrain=found.terrain).problem.obstacles]
        assert any(one.startswith("what stands at x ") for one in names)
    assert np.array_equal(found.terrain.surface, known.surface)
    stands = found.terrain.off_ground
    assert stands is not None
    assert stands.edge == known.cell
    there = {tuple(key) for key in stands.keys.tolist()}
    for x in (6.5, 8.0, 10.5):
        level = np.arange(0.5 * known.cell, min(0.6 * (x - 6.0), 1.5), known.cell)
        asked = np.column_stack((np.full(len(level), x), np.full(len(level), -2.0), level)) + 1e-6
        assert {tuple(key) for key in np.floor(asked / known.cell).astype(int).tolist()} <= there
    assert stands.centres[:, 0].min() == pytest.approx(6.25, abs=1.6 * known.cell)  # 0.15 m of height
    assert "up to 1.50 m higher than before, at x 8.5" in found.remark
    # ground that was as high before is no obstacle
    before = HeightGrid(known.low, known.cell, heights.reshape(-1, len(np.unique(places[:, 0]))))
    again = scanned_around(known, before, tmp_path / name, low=known.low, cell=known.cell)
    assert again.terrain.off_ground is None
    assert again.remark == ""


def test_much_that_was_heaped_is_filled_with_larger_voxels() -> None:
    """A block of 6 x 5.8 x 4 m has 1.1 million voxels of 5 cm, and 139,200 of 10 cm."""
    z = np.full((120, 120), 4.0)
    z[:4] = 0.0
    raised = raised_beyond(HeightGrid(np.zeros(2), 0.05, z), (slice(0, 4), slice(0, 120)), z[:4], None, 0.15)
    assert raised.voxels is not None
    assert raised.voxels.edge == 0.1
    assert len(raised.voxels.keys) == 60 * 58 * 40
    assert raised.voxels.centres.min(axis=0) == pytest.approx([0.05, 0.25, 0.05])


def test_voxels_of_two_sizes_are_joined_without_losing_space() -> None:
    rng = np.random.default_rng(4)
    fine = OffGround(0.05, rng.integers(-40, 40, (30, 3)))
    coarse = OffGround(0.07, rng.integers(-20, 20, (30, 3)))
    both = join_voxels(coarse, fine)
    assert both is not None
    assert both.edge == 0.07
    inside = fine.edge * (fine.keys[:, None, :] + rng.uniform(0.001, 0.999, (1, 50, 3))).reshape(-1, 3)
    keys = {tuple(key) for key in both.keys.tolist()}
    assert {tuple(key) for key in np.floor(inside / 0.07).astype(int).tolist()} <= keys
    assert {tuple(key) for key in coarse.keys.tolist()} <= keys
    assert off_ground_obstacles(None, 0.1) == ()


def through_the_tractor(height: float) -> Matrix:
    """Points of a wall across the middle of the tractor, at x = -1.5 m."""
    return upright((-1.5, 1.5), 1.5, height, 0.05)[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]


def test_a_machine_that_stands_in_what_the_cloud_contains_is_refused(tmp_path: Path) -> None:
    """A wall of 1.5 m goes through the tractor; a kerb of 0.2 m is under it."""
    with pytest.raises(SceneError, match=r"site\.base: puts chassis of the machine into what stands at x -1\.5, y"):
        plan_job(walled_job(tmp_path, through_the_tractor(1.5)))
    # the sixth largest thing has no place in its name
    posts = np.vstack([upright((x, x), -4.0, 1.0, 0.1) for x in (0.8, 1.8, 2.8, 3.8, 4.8)])
    speck = [[-1.52, 0.02, 1.02]]
    with pytest.raises(SceneError, match=r"into what else stands on.*in its way at x -1\.55, y 0\.05, z 1\.05"):
        plan_job(walled_job(tmp_path, np.vstack((posts, speck))))
    site = build_worksite(walled_job(tmp_path, through_the_tractor(0.2)))
    assert site.ground.off_ground is not None
    check_place(site)


def test_things_far_away_are_no_obstacles_and_do_not_take_the_names(tmp_path: Path) -> None:
    """Five walls more than 9 m from the swing axis, whose arm reaches 6 m, and a post within its reach."""
    walls = [upright((8.0, 9.5), y, 2.0, 0.1) for y in (-6.0, -7.0, -8.0, -9.0, -10.0)]
    post = upright((1.0, 1.0), -3.5, 1.0, 0.1)
    site = build_worksite(walled_job(tmp_path, np.vstack((*walls, post))))
    (near,) = site.things
    assert "at x 1.0, y -3." in near.name
    assert site.ground.off_ground is not None
    assert [name for name, _ in site.ground.off_ground.things][-1] == "what else stands on the ground"
    # of a machine 6 m further along x, which digs towards the origin, the walls are within reach
    job = walled_job(tmp_path, np.vstack((*walls, post)))
    moved = job.to_dict() | {"site": {"base": {"position": [7.5, 0.0], "heading": np.pi}}}
    there = build_worksite(job_from_dict(moved, folder=tmp_path))
    assert len(there.things) > 1
    assert any("what stands at x 8." in one.name for one in there.things)


def test_a_warning_says_how_high_the_ground_under_the_machine_is(tmp_path: Path) -> None:
    """Level ground in map coordinates, with a height of the map origin that is right, or 0.2 m too low."""
    places = grid((-6.0, -3.0), (6.0, 3.0), 0.5)
    np.savetxt(tmp_path / "ground.xyz", at(places, 40.0), fmt="%.2f")
    content = small_job().to_dict()
    for height, words in ((40.0, []), (39.8, ["under the machine is from 0.20 to 0.20 m high"])):
        ground = {"file": "ground.xyz", "cell": 0.5, "map_origin": [0.0, 0.0, height]}
        found = ground_warnings(job_from_dict(content | {"ground": ground}, folder=tmp_path))
        assert len(found) == len(words)
        assert all(one in said for one, said in zip(words, found, strict=True))


def test_a_warning_tells_below_what_a_sparse_cloud_may_only_have_missed_the_ground(tmp_path: Path) -> None:
    """A line 3 m above the ground. Every fourth column along x has no ground point, or no more than those of a wall.

    Of 61 x 41 columns 15 x 41 are empty, 15 of them below the line, and its own row is left out of the others.
    """
    line = at(grid((0.0, 0.0), (6.0, 0.0), CELL), 3.0)
    is_empty = np.round(LEVEL[:, 0] / CELL).astype(int) % 4 == 2
    for ground, told in ((LEVEL[~is_empty], True), (LEVEL, False)):
        np.savetxt(tmp_path / "line.xyz", np.vstack((ground, line)), fmt="%.4f")
        content = small_job().to_dict() | {
            "ground": {"file": "line.xyz", "low": list(LOW), "high": list(HIGH), "cell": CELL}
        }
        (found,) = ground_warnings(job_from_dict(content, folder=tmp_path))
        words = "on 15 of these columns it counts as solid down to the ground"
        assert (words in found) == told
        assert ("25 % of the columns where nothing stands have none either" in found) == told
