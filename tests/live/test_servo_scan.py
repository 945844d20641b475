"""The servo near a scan: whatever the wish, it keeps the clearance from every voxel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner import InputError, Servo
from backhoe_planner.live import Placements

# opens the wall: built objects, box searches and checks of pairs are counted within
from backhoe_planner.live.boxes import cluster_pairs
from backhoe_planner.live.boxes.box_places import MOST_PARTS, Line, box_urgency, inexact_boxes
from backhoe_planner.live.boxes.cluster_pairs import ClusterPairs
from backhoe_planner.live.braking.braking_path import JointState
from backhoe_planner.live.clearance import box_bounds, pair_bounds
from backhoe_planner.live.clearance.box_bounds import BoxBounds
from backhoe_planner.live.planes import cluster_boxes, plane_gaps
from backhoe_planner.live.planes.pair_choice import stalest_pair
from backhoe_planner.live.planes.separation import Separation
from backhoe_planner.machine import Robot
from backhoe_planner.machine.clusters import cluster
from backhoe_planner.machine.clusters.distance_grid import DistanceGrid, GridFrame
from backhoe_planner.machine.clusters.tiles import Tiles
from backhoe_planner.site import Proximity, scene_from_dict

START = [0.0, 0.7, -1.2, -1.2]
SCENE = {
    "version": 1,
    "start": {"joints": {"swing": 0.0, "boom": 0.7, "stick": -1.2, "bucket": -1.2}},
    "task": {"goal": {"position": [4.0, 0.0, 1.0]}},
    "clearance": 0.1,
}


def ground_and_wall(rng: np.random.Generator) -> np.ndarray:
    ground = rng.uniform([-1.0, -4.0, -0.3], [6.0, 4.0, -0.2], (60_000, 3))
    wall = rng.uniform([1.0, 1.5, -0.3], [6.0, 1.6, 2.5], (40_000, 3))
    return np.vstack((ground, wall))


@pytest.mark.parametrize(("tip_velocity", "seed"), [([0.0, 0.5, -0.3], 0), ([0.3, 0.0, -0.6], 1)])
def test_a_machine_driven_into_a_scan_stops_before_it(backhoe: Robot, tip_velocity: list[float], seed: int) -> None:
    servo = Servo(backhoe, scene_from_dict(SCENE), dt=0.01)
    servo.add_points("scan", ground_and_wall(np.random.default_rng(seed)), resolution=0.1)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    least = np.inf
    for step in range(250):
        state = servo.step(tip_velocity)
        assert servo.last_error is None
        if step % 5 == 0:
            least = min(least, float(np.min(gauge.distances(state.q) - gauge.clearance)))
    assert -1e-6 <= least < 0.15
    assert np.max(np.abs(state.q - START)) > 0.1


@pytest.mark.parametrize(
    ("value", "said"), [(np.nan, "is not finite; found nan"), (-2000.0, "is too far away; found -2000")]
)
def test_an_invalid_scan_point_is_named(backhoe: Robot, value: float, said: str) -> None:
    servo = Servo(backhoe, scene_from_dict(SCENE), dt=0.01)
    with pytest.raises(InputError, match=f"points of a: point 2, coordinate 3: {said}; allowed: .* at most 1000 m"):
        servo.add_points("a", [[5.0, 0.0, 0.0], [5.0, 0.0, value]], resolution=0.1)


def test_a_scan_that_is_moved_away_no_longer_blocks(backhoe: Robot) -> None:
    servo = Servo(backhoe, scene_from_dict(SCENE), dt=0.01)
    servo.add_points("scan", ground_and_wall(np.random.default_rng(2)), resolution=0.1)
    for _ in range(300):
        blocked = servo.step([0.0, 0.6, 0.0])
    servo.move("scan", [0.0, 10.0, -10.0])
    for _ in range(200):
        free = servo.step([0.0, 0.6, 0.0])
    assert blocked.tip_position[1] < 1.4 < free.tip_position[1]
    servo.remove("scan")
    assert servo.obstacles == ()


def test_an_approaching_scan_is_evaded(backhoe: Robot) -> None:
    servo = Servo(backhoe, scene_from_dict(SCENE), dt=0.01)
    rng = np.random.default_rng(3)
    servo.add_points("truck", rng.uniform([3.0, 1.5, 0.0], [5.0, 2.0, 2.0], (30_000, 3)), resolution=0.1)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    assert float(np.min(gauge.distances(np.array(START)))) > 0.9  # beyond the distance within which boxes are searched
    servo.set_velocity("truck", [0.0, -0.15, 0.0])
    for _ in range(1000):
        state = servo.step([0.0, 0.0, 0.0])
        assert servo.last_error is None
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    assert float(np.min(gauge.distances(np.array(START)))) < 0.0
    assert float(np.min(gauge.distances(state.q))) > 0.0


def test_the_tip_rises_freely_from_coarse_ground_cells(backhoe: Robot, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "ground.csv", np.full((61, 61), -0.7), delimiter=",")  # cells of 0.4 m
    ground = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [24.0, 24.0]}
    servo = Servo(backhoe, scene_from_dict({**SCENE, "obstacles": [ground]}, folder=tmp_path), dt=0.01)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    for _ in range(150):
        servo.step([0.0, 0.0, -0.4])
    low = servo.step([0.0, 0.0, 0.4])
    assert 0.1 - 1e-6 <= float(np.min(gauge.distances(low.q))) < 0.4
    for _ in range(200):
        state = servo.step([0.0, 0.0, 0.4])
    assert state.tip_position[2] > low.tip_position[2] + 0.6


@pytest.mark.long
def test_nearly_every_braking_path_is_proven_during_descents_to_rough_ground(backhoe: Robot, tmp_path: Path) -> None:
    """Boxes found far above the ground must not forbid a path that the previous ones allowed."""
    x, proven, steps = np.linspace(-6.0, 6.0, 241), 0, 0
    for seed, tip_velocity in ((20, [0.3, 0.0, -0.9]), (21, [0.0, 0.6, -0.6]), (22, [0.6, -0.4, -0.8])):
        rough = np.random.default_rng(seed).normal(0.0, 0.005, (len(x), len(x)))
        heights = -0.6 + 0.06 * np.sin(1.3 * x[None, :]) * np.cos(0.9 * x[:, None]) + rough
        np.savetxt(tmp_path / "ground.csv", heights, fmt="%.4f", delimiter=",")
        ground = {"name": "ground", "shape": "heightmap", "file": "ground.csv", "size": [12.0, 12.0]}
        servo = Servo(backhoe, scene_from_dict({**SCENE, "obstacles": [ground]}, folder=tmp_path), dt=0.004)
        for _ in range(500):
            state = servo.step(tip_velocity)
            assert servo.last_error is None
            proven, steps = proven + state.proven, steps + 1
        assert state.nearest is not None, "it came down to the ground"
        assert state.nearest.margin < 0.02
    assert proven > 0.98 * steps


def test_a_step_builds_no_grids_and_replaces_at_most_two_sets_of_boxes(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Work of tens of milliseconds is done before the first step, even where nothing was near at that time."""
    servo = Servo(backhoe, scene_from_dict(SCENE))
    below = np.array([0.0, 1.0, -1.0])
    servo.add_points("scan", below + ground_and_wall(np.random.default_rng(4)), resolution=0.1)
    measured: list[int] = []

    def must_not(*_: object, **__: object) -> None:
        raise AssertionError("this takes longer than a step may")

    def count(*args: Any) -> np.ndarray:
        measured[-1] += 1
        return put(*args)

    put = cluster_boxes.put_boxes
    for module in (cluster_boxes, box_bounds):
        monkeypatch.setattr(module, "put_boxes", count)
    for kind in (Tiles, DistanceGrid, GridFrame):
        monkeypatch.setattr(kind, "__init__", must_not)
    for _ in range(1500):
        measured.append(0)
        servo.step([0.4, 1.2, -1.0])
        assert servo.last_error is None
    assert sum(measured) > 5
    assert max(measured) <= 2


def test_a_failed_box_search_is_repeated_in_the_next_step(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a failed search the machine must not go on with boxes that no longer hold."""
    servo = Servo(backhoe, scene_from_dict(SCENE), dt=0.01)
    servo.add_points("scan", ground_and_wall(np.random.default_rng(5)), resolution=0.1)
    one = servo._separation.clusters[-1]
    one.covered = 0.0
    servo._separation.places.note(one)

    def fails(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patched:
        patched.setattr(BoxBounds, "find", fails)
        servo.step(joint_velocity=[0.1, 0.0, 0.0, 0.0])
    assert isinstance(servo.last_error, ZeroDivisionError)
    assert one.covered == 0.0
    servo.step(joint_velocity=[0.1, 0.0, 0.0, 0.0])
    assert one.covered > 0.1


@pytest.mark.parametrize("dt", [0.001, 0.01])
def test_a_links_motion_in_several_steps_and_braking_stays_within_its_bound(backhoe: Robot, dt: float) -> None:
    """At all velocities that the accelerations allow, wherever braking begins."""
    servo, steps, rng = Servo(backhoe, scene_from_dict(SCENE), dt=dt), 10, np.random.default_rng(8)
    servo.add_points("scan", ground_and_wall(rng), resolution=0.1)
    separation, joints, at = servo._separation, servo._joints, Placements(backhoe, MOST_PARTS + 1)
    tightest = np.inf
    for _ in range(30):
        q, v = backhoe.random_q(rng), rng.uniform(-0.7, 0.7, 4) * servo.limits.velocity
        begun = JointState(q, v, q + 0.5 * joints.braking_time(v) * v)
        line = Line.ahead(
            begun, joints, steps,
            travel=separation.travel, furthest=separation.furthest, turning=separation.turning,
        )  # fmt: skip
        for sample, end in enumerate(line.ends):
            at.place(sample, end)
        bound = [
            separation.places.way_of(one, at.T[: len(line.ends)]) + float(line.beside[one.classes])
            for one in separation.clusters
        ]
        corners = [placed_corners(separation, one, at, q) for one in separation.clusters]
        push = rng.choice([-1.0, 0.0, 1.0], 4)
        for _ in range(int(rng.integers(1, steps + 2))):
            v = v + push * joints.change * rng.uniform(0.9, 1.0)
            q = q + dt * v
        for part in (0.0, 0.4, 1.0):  # of the braking distance
            after = q + part * 0.5 * joints.braking_time(v) * v
            for one, most, here in zip(separation.clusters, bound, corners, strict=True):
                moved = float(np.linalg.norm(placed_corners(separation, one, at, after) - here, axis=1).max())
                assert moved <= most
                tightest = min(tightest, most - moved)
                assert most < line.way[one.classes] + 0.05
    assert tightest < 0.1


def placed_corners(separation: Separation, one: ClusterPairs, at: Placements, q: np.ndarray) -> np.ndarray:
    """(V, 3) corners of a link in the world [m]."""
    at.place(MOST_PARTS, q)
    T = at.T[MOST_PARTS, separation.own.pieces[one.piece].joint]
    return np.asarray(one.own.hull @ T[:3, :3].T + T[:3, 3])


def test_the_urgency_of_new_boxes_equals_the_hand_calculation() -> None:
    """Four links: 25 cm left; inexact and moved; nothing left; not there."""
    found = box_urgency(
        np.array([[0.05, 0.05, 0.05, 0.05], [0.1, 0.1, 0.4, 0.4]]), np.full(4, 0.5), np.array([0.1, 0.1, 0.1, 0.1]),
        np.full(4, 0.1), np.zeros(4), np.array([1.0, 1.0, 1.0, 0.0]), np.zeros(4, dtype=np.intp),
        np.array([0.05]), 0.3, np.array([0.0, 1.0, 1.0, 1.0]), (0.2, 0.02),
    )  # fmt: skip
    # left: 0.5 - 0.1 - 0.1 - 0.05; moved: 0.05 of the 0.02 that is a fifth of 0.1
    np.testing.assert_allclose(found, [0.02 / 0.25, 2.5, np.inf, 0.0])


@pytest.mark.parametrize(
    ("aside", "height", "ahead", "expected"),
    [
        (0.0, 0.1, 0.0, 0.0),  # over the cell
        (0.06, 0.1, 0.0, 0.0),  # the cell is 0.1166 away, and 0.85 of that is 0.0991
        (0.07, 0.1, 0.0, 1.0),  # 0.85 of 0.1221 is 0.1038
        (0.2, 0.2, 0.0, 0.0),  # beyond the distance that has to be exact
        (0.2, 0.2, -0.04, 0.0),  # on its path still beyond the distance that may hold it back
        (0.2, 0.2, -0.06, 1.0),  # on its path within that distance
        (0.2, 0.17, 0.0, 1.0),  # so near that the obstacle acts
    ],
)
def test_boxes_stay_exact_where_their_cell_is_hardly_further_away(
    aside: float, height: float, ahead: float, expected: float
) -> None:
    """By hand: a corner over a box with its face at z = 0 and its cell at the origin, and a box of unknown cell."""
    T = np.tile(np.eye(4), (2, 2, 1, 1))
    T[0, 1, :3, 3] = aside, 0.0, height
    T[1, 1, :3, 3] = aside, 0.0, height + ahead
    corner, nothing, unknown = np.array([[[0.0], [0.0], [0.0], [1.0]]]), np.zeros(1), np.full(1, -1.0)
    link, pair = np.ones(1, dtype=np.intp), np.zeros(1, dtype=np.intp)
    for witness, found in ((0.0, expected), (np.nan, float(height + ahead < 0.15 or height < 0.18))):
        inexact = inexact_boxes(
            T, link, corner, np.full((1, 1, 6), witness), np.array([[0.0, 0.0, 1.0, 0.0]]), pair, pair,
            np.full(1, 0.1), nothing, nothing, nothing, unknown, nothing, unknown, nothing, (0.08, 0.05, 0.85),
        )  # fmt: skip
        assert inexact.tolist() == [found]


def test_the_choice_of_the_plane_to_renew_equals_the_hand_calculation() -> None:
    """Pairs at 0.3, 0.05 and 0.18 m of margin that have moved by 5, 1 and 4 cm since they were measured."""
    pairs, distance, clearance = np.array([0, 1, 2]), np.array([1.4, 1.15, 1.28]), np.full(3, 0.1)
    renewed, classes, odometer = np.array([0.95, 0.99, 0.96]), np.zeros(3, dtype=np.intp), np.ones(1)

    def chosen(*, nearest_first: bool, far: bool, close: float = 0.1, least: float = 0.1) -> int:
        rules = close, 0.02, least
        return stalest_pair(pairs, distance, clearance, renewed, classes, odometer, nearest_first, far, rules)

    # 0.05 / 0.32 = 0.156, 0.01 / 0.07 = 0.143, 0.04 / 0.2 = 0.2
    assert chosen(nearest_first=False, far=False) == 2
    assert chosen(nearest_first=True, far=False) == 1
    assert chosen(nearest_first=True, far=False, least=0.15) == 2
    assert chosen(nearest_first=True, far=False, least=0.25) == -1
    assert chosen(nearest_first=True, far=False, close=0.01) == -1
    assert chosen(nearest_first=True, far=True, close=0.01) == 2


def test_a_swung_links_distance_from_the_place_of_its_boxes_is_the_chord(backhoe: Robot) -> None:
    """Turned by an angle about an axis, a point at a distance r from it has moved by 2 r sin(angle / 2)."""
    servo = Servo(backhoe, scene_from_dict(SCENE))
    servo.add_points("scan", ground_and_wall(np.random.default_rng(5)), resolution=0.1)
    separation, at, q = servo._separation, Placements(backhoe, 1), np.array(START)
    at.place(0, q)
    np.testing.assert_allclose(separation.places.moved(at.T[:1])[0], 0.0, atol=1e-12)
    data = backhoe.model.createData()
    pin.forwardKinematics(backhoe.model, data, q)
    for angle in (0.02, -0.3, 1.0):
        at.place(0, q + np.array([angle, 0.0, 0.0, 0.0]))
        moved = separation.places.moved(at.T[:1])[0]
        for one, far in zip(separation.counting_clusters, moved.tolist(), strict=True):
            own = separation.own.pieces[one.piece]
            corners = np.array([data.oMi[own.joint].act(corner) for corner in own.piece.hull])
            from_axis = np.linalg.norm(corners[:, :2] - data.oMi[1].translation[:2], axis=1).max()
            assert far == pytest.approx(2.0 * from_axis * np.sin(abs(angle) / 2.0))


def test_checking_distant_pairs_less_often_hardly_changes_the_motion(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the warning distance the servo looks for near pairs less than half as often and moves nearly the same."""
    rng = np.random.default_rng(6)
    wishes = [rng.normal(0.0, 0.25, 3) for _ in range(6)]
    found = []
    for anew in (pair_bounds._SEEN_ANEW, -1.0):
        monkeypatch.setattr(pair_bounds, "_SEEN_ANEW", anew)
        asked, ask = [0], plane_gaps.gaps_here

        def count(*args: Any, ask: Any = ask, asked: list[int] = asked) -> Any:
            asked[0] += 1
            return ask(*args)

        monkeypatch.setattr(pair_bounds, "gaps_here", count)
        servo = Servo(backhoe, scene_from_dict(SCENE))
        servo.add_points("scan", ground_and_wall(np.random.default_rng(6)), resolution=0.1)
        gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
        configurations, margins = [], []
        for step in range(600):
            state = servo.step(wishes[step // 100])
            assert servo.last_error is None
            configurations.append(state.q)
            margins.append(np.inf if state.nearest is None else state.nearest.margin)
            if step % 30 == 0:
                true = float(np.min(gauge.distances(state.q) - gauge.clearance))
                assert margins[-1] == np.inf or margins[-1] <= true + 1e-6
        found.append((asked[0], np.array(configurations), np.array(margins)))
        monkeypatch.undo()
    (few, q, margin), (many, q_anew, margin_anew) = found
    assert 2 * few < many
    assert np.abs(q - q_anew).max() < 0.01
    both = np.isfinite(margin) & np.isfinite(margin_anew)
    assert np.count_nonzero(both) > 200
    assert np.abs(margin - margin_anew)[both].max() < 0.05


@pytest.mark.parametrize("by_coal", [False, True])
def test_boxes_found_bit_by_bit_cover_as_much_as_those_found_at_once_and_bound_distances(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch, by_coal: bool
) -> None:
    """The machine moves meanwhile: boxes and covered distance belong to the configuration of the request."""
    if by_coal:
        monkeypatch.setattr(cluster, "boxes_of_voxels", lambda *_: None)
        monkeypatch.setattr(cluster, "boxes_of_cells", lambda *_: None)
    servo = Servo(backhoe, scene_from_dict(SCENE), self_collision=False)
    servo.add_points("scan", ground_and_wall(np.random.default_rng(7)), resolution=0.1)
    separation, bounds, at = servo._separation, servo._bounds, Placements(backhoe, 18)
    boxes = BoxBounds(separation, bounds)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    rng, compared, several = np.random.default_rng(8), 0, 0
    for _ in range(6):
        q = np.array(START) + rng.normal(0.0, 0.15, 4)
        for one in separation.counting_clusters:
            at.place(0, q)
            once = cluster_boxes.find_boxes(separation, one, at, reach=0.6, exact=0.4, slack=0.15, is_new=True)
            assert once is not None
            covered, nearest = one.covered, one.nearest
            if one.was_inside or not boxes.search(one, at, reach=0.6):
                continue
            bounds.required[one.pairs] = -1.0  # nothing was proven at the place that it has jumped to
            later, bits = q + rng.normal(0.0, 0.02, 4), 0
            at.place(0, later)
            bounds.advance(later - q, None)
            while boxes.searches:
                boxes.search_on(at, servo._check.path(later, np.zeros(4), step=False))
                bits += 1
            assert (one.covered, one.nearest) == (covered, nearest)
            assert (bounds.lower()[one.pairs] <= once).all()
            moved = separation.places.moved(at.T[:1])[0][separation.counting_clusters.index(one)]
            assert 0.0 < moved < 0.5
            pair = next(number for number, own in enumerate(gauge.pairs) if own.piece == one.piece)
            true = gauge.distance_of(pair, later)
            assert min(float(bounds.lower()[one.pairs].min()), covered - moved) <= true + 1e-6
            compared, several = compared + 1, several + (bits > 2)
    assert compared > 10
    assert several > 5 or not by_coal


def test_new_boxes_that_prove_less_of_the_path_give_way_to_the_previous_ones(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Boxes found bit by bit are not due yet: the previous ones still hold, and the machine need not brake."""
    servo = Servo(backhoe, scene_from_dict(SCENE), self_collision=False)
    servo.add_points("scan", ground_and_wall(np.random.default_rng(7)), resolution=0.1)
    separation, bounds, at, q = servo._separation, servo._bounds, Placements(backhoe, 18), np.array(START)
    boxes = BoxBounds(separation, bounds)
    path = servo._check.path(q, np.array([0.5, 0.5, 0.5, 0.5]), step=False)
    monkeypatch.setattr(box_bounds, "proven_along", lambda _, pairs, *__: np.full(len(pairs), 0.01))
    at.place(0, q)
    put_back = 0
    for one in separation.counting_clusters:
        before = separation.planes.copy(), bounds.lower(), bounds.required.copy(), np.array([one.covered, one.boxes])
        measured = separation.measured
        if not boxes.search(one, at, reach=0.6):
            continue
        while boxes.searches:
            boxes.search_on(at, path)
        assert not boxes.short
        now = separation.planes, bounds.lower(), bounds.required, np.array([one.covered, one.boxes])
        if separation.measured > measured and all(np.array_equal(*both) for both in zip(now, before, strict=True)):
            put_back += 1
            bodies = [separation.body[pair] for pair in one.pairs.tolist()[: one.boxes]]
            assert None not in bodies
            assert all(separation._bodies_of[one.number].count(body) == 1 for body in bodies if body is not None)
    assert put_back >= 2


@pytest.mark.parametrize("depth", [0.1, pytest.param(0.3, marks=pytest.mark.long)])
def test_a_machine_sunk_in_fine_ground_comes_up(backhoe: Robot, tmp_path: Path, depth: float) -> None:
    q = np.array([0.1, 0.1, -1.3, -0.8])
    data = backhoe.model.createData()
    pin.forwardKinematics(backhoe.model, data, q)
    lowest = min((data.oMi[one.joint].act(x))[2] for one in backhoe.pieces if one.joint for x in one.piece.hull)
    x = np.linspace(-8.0, 8.0, 161)
    np.savetxt(tmp_path / "fine.csv", lowest + depth + 0.03 * np.sin(1.3 * x)[:, None] * np.cos(x), delimiter=",")
    ground = {"name": "ground", "shape": "heightmap", "file": "fine.csv", "size": [16.0, 16.0]}
    scene = {**SCENE, "start": {"joints": dict(zip(backhoe.joint_names, q.tolist(), strict=True))}}
    servo = Servo(backhoe, scene_from_dict({**scene, "obstacles": [ground]}, folder=tmp_path), dt=0.01)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    assert float(np.min(gauge.distances(q))) < 0.0
    for _ in range(400):
        state = servo.step()
        assert servo.last_error is None
    assert float(np.min(gauge.distances(state.q) - gauge.clearance)) > -1e-6


def slid_along_a_wall(backhoe: Robot, *, most: int = 330) -> Servo:
    """A servo after `most` steps of 10 ms of sliding along a wall of rough cells, in which it kept the clearance."""
    start = dict(zip(backhoe.joint_names, [0.0, 0.2, -1.3, -0.8], strict=True))
    servo = Servo(backhoe, scene_from_dict({**SCENE, "start": {"joints": start}}), dt=0.01)
    wall = np.random.default_rng(0).uniform([4.3, -3.0, -2.0], [4.4, 3.0, 1.0], (4000, 3))
    servo.add_points("scan", wall, resolution=0.05)
    gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
    for step in range(most):
        state = servo.step([0.4, 0.4, 0.0])
        assert servo.last_error is None
        if step % 20 == 0:
            assert float(np.min(gauge.distances(state.q) - gauge.clearance)) > -1e-6
    came = float(np.min(gauge.distances(state.q) - gauge.clearance)) < 0.05
    assert came or most < 330, "it came to the wall"
    return servo


@pytest.mark.parametrize("places", [cluster_pairs.SLOTS, pytest.param(2, marks=pytest.mark.long)])
def test_new_boxes_do_not_lock_the_machine_next_to_the_cells(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch, places: int
) -> None:
    """Also with so few boxes that everywhere they are closer to the machine than the cells."""
    monkeypatch.setattr(cluster_pairs, "SLOTS", places)
    servo = slid_along_a_wall(backhoe)
    before = servo.q
    for _ in range(40):
        state = servo.step([-0.3, 0.0, 0.0])
    assert state.proven
    assert np.abs(state.q - before).max() > 0.02


def test_insufficient_boxes_are_searched_again_only_every_tenth_step_while_braking(
    backhoe: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one step of braking they would prove as little, and a search takes as long as ten steps."""
    servo = slid_along_a_wall(backhoe, most=20)
    (one, *_), boxes = servo._separation.counting_clusters, servo._boxes
    found: list[int] = []
    step = 0
    monkeypatch.setattr(boxes._box_bounds, "short", [one])
    monkeypatch.setattr(boxes._box_bounds, "find", lambda *_, **__: found.append(step))
    for step in range(100, 135):
        boxes._blocking, boxes._due = one, step + 1
        boxes.renew(servo._state, step)
    assert found == [100, 110, 120, 130]
    at_rest = servo._state._replace(v=np.zeros(4))
    for step in range(200, 203):
        boxes._due = step + 1
        boxes.renew(at_rest, step)
    assert found[4:] == [200, 201, 202]


@pytest.mark.long
def test_a_machine_at_rest_next_to_a_scan_evades_an_approaching_person(backhoe: Robot) -> None:
    servo = slid_along_a_wall(backhoe)
    for _ in range(50):
        state = servo.step([0.0, 0.0, 0.0])
    assert np.abs(state.v).max() < 1e-6
    beside = state.tip_position + np.array([-0.8, -2.0, 0.0])
    servo.add({"name": "person", "shape": "sphere", "radius": 0.3, "position": beside.tolist()})
    servo.set_velocity("person", [0.0, 0.4, 0.0])
    least = np.inf
    for step in range(1000):
        state = servo.step([0.0, 0.0, 0.0])
        if step % 20 == 0:
            gauge = Proximity(backhoe, servo.snapshot(), self_collision=False)
            least = min(least, float(np.min(gauge.distances(state.q))))
    assert least > 0.09
