"""Obstacles that come, go and move while the servo runs: the records of them stay consistent."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import Separation, Servo, shifted
from backhoe_planner.machine import Robot
from backhoe_planner.site import Obstacle, Proximity, build_obstacle, obstacle_from_dict
from backhoe_planner.site.schema import obstacle_shapes

BALL = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [4.7, 1.6, -0.6]}

SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"radius": 0.3, "position": [4.7, 1.6, -0.6]},
    "box": {"size": [0.4, 0.5, 0.6]},  # at the origin
    "cylinder": {"radius": 0.2, "length": 1.0, "position": [5.0, 0.0, 0.0], "rpy": [0.3, 0.0, 0.0]},
    "capsule": {"from": [4.0, -1.0, 0.0], "to": [4.0, 1.0, 0.4], "radius": 0.1},
    "halfspace": {"point": [0.0, 0.0, -3.0], "normal": [0.1, 0.0, 1.0]},
    "mesh": {"file": "peak.obj", "position": [5.0, 1.0, -2.0]},
    "heightmap": {"file": "ground.csv", "size": [3.0, 2.0], "position": [4.0, 0.0, -3.0]},
    "pointcloud": {"file": "scan.csv", "resolution": 0.1, "position": [5.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.5]},
}


@pytest.fixture
def servo(backhoe: Robot) -> Servo:
    joints = dict(zip(backhoe.joint_names, [0.0, 0.3, -0.9, -0.5], strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}
    return Servo(backhoe, bp.scene_from_dict({**content, "clearance": 0.05}), dt=0.005)


def test_moving_obstacles_can_be_removed_and_the_others_keep_moving(servo: Servo) -> None:
    for number in range(6):
        servo.add(
            {**BALL, "name": f"ball {number}", "velocity": [0.0, 0.01 * number, 0.0], "position": [0, 9 + number, 0]}
        )
    servo.step()
    for number in (0, 2, 5):
        servo.remove(f"ball {number}")
    state = servo.step([0.0, 0.1, 0.0])
    assert servo.last_error is None
    assert state.v.any()
    assert servo.obstacles == ("ball 1", "ball 3", "ball 4")
    np.testing.assert_allclose(servo.shift_of("ball 3"), [0.0, 2 * 0.005 * 0.03, 0.0], atol=1e-15)


def test_obstacles_of_a_scene_are_added_in_one_pass(backhoe: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of passes over all pairs does not depend on theirs; the result is that of adding them one by one."""
    looked_through: list[int] = []
    refresh = Separation._refresh

    def counted(self: Separation) -> None:
        looked_through.append(len(self))
        refresh(self)

    monkeypatch.setattr(Separation, "_refresh", counted)
    joints = dict(zip(backhoe.joint_names, [0.0, 0.3, -0.9, -0.5], strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}}
    rng = np.random.default_rng(4)
    balls = [
        {**BALL, "name": f"ball {number}", "position": [4.0 * np.cos(angle), 4.0 * np.sin(angle), 2.5]}
        for number, angle in enumerate(rng.uniform(0.5, 5.5, 40).tolist())
    ]
    balls[7]["velocity"], balls[9]["appears_at"] = [0.0, 0.0, -0.1], 0.1
    visits, servos = [], []
    for count in (4, 40):
        looked_through.clear()
        servos.append(Servo(backhoe, bp.scene_from_dict({**content, "obstacles": balls[:count]}), dt=0.005))
        visits.append(len(looked_through))
    assert visits[0] == visits[1]
    few, many = servos
    for ball in balls[4:]:
        few.add(ball)
    for number in range(60):
        wish = [0.4 if number < 30 else -0.4, 0.5, 0.2]
        np.testing.assert_array_equal(few.step(wish).q, many.step(wish).q)
    assert few.obstacles == many.obstacles
    assert len(many.obstacles) == 40
    assert few.last_error is many.last_error is None


def test_an_obstacle_yet_to_appear_reserves_its_name_and_can_be_removed(servo: Servo) -> None:
    servo.add({**BALL, "appears_at": 0.02})
    with pytest.raises(bp.InputError, match="is the name of an obstacle"):
        servo.add(BALL)
    with pytest.raises(bp.InputError, match="is the name of an obstacle"):
        servo.add_points("ball", [[4.0, 3.0, 0.0]])
    with pytest.raises(bp.InputError, match="has not appeared yet"):
        servo.move("ball", [0.0, 0.0, 1.0])
    servo.remove("ball")
    for _ in range(8):
        servo.step()
    assert servo.obstacles == ()


def test_a_scan_replaces_only_another_scan(servo: Servo) -> None:
    servo.add(BALL)
    with pytest.raises(bp.InputError, match="an obstacle that is no scan"):
        servo.add_points("ball", np.zeros((0, 3)))
    assert servo.obstacles == ("ball",)


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        ({"clearance": math.nan}, "clearance"),
        ({"clearance": -1.0}, "clearance"),
        ({"clearance": math.inf}, "clearance"),
        ({"clearance": "wide"}, "clearance"),
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": 1e-300}, "resolution"),
        ({"resolution": math.inf}, "resolution"),
        ({"points": [[1e300, 0.0, 0.0]]}, "too far"),
        ({"points": [[math.nan, 0.0, 0.0]]}, "is not finite"),
        ({"points": [[0.0, 0.0]]}, "shape"),
        ({"name": ""}, "name"),
        ({"name": None}, "name"),
    ],
)
def test_an_invalid_scan_is_refused(servo: Servo, keys: dict[str, Any], word: str) -> None:
    with pytest.raises(bp.InputError, match=word):
        servo.add_points(**{"name": "scan", "points": [[4.0, 3.0, 0.0]], **keys})
    assert servo.obstacles == ()


def test_a_move_out_of_the_allowed_range_is_refused(servo: Servo) -> None:
    servo.add(BALL)
    servo.move("ball", [900.0, 0.0, 0.0])
    with pytest.raises(bp.InputError, match="by"):
        servo.move("ball", [900.0, 0.0, 0.0])
    np.testing.assert_array_equal(servo.shift_of("ball"), [900.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "keys", [{"dt": 0.0}, {"dt": math.nan}, {"dt": "a"}, {"dt": 10.0}, {"watchdog": math.nan}, {"watchdog": -1.0}]
)
def test_an_invalid_step_or_watchdog_is_refused(servo: Servo, keys: dict[str, Any]) -> None:
    with pytest.raises(bp.InputError, match=next(iter(keys))):
        Servo(servo.robot, servo.scene, **keys)


def test_the_error_of_a_failed_step_is_kept(servo: Servo, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of the test")

    servo.add({**BALL, "position": [4.7, 0.7, -0.6]})
    near = servo.step([0.0, 0.1, 0.0])
    # opens the wall: a fault in the middle of a step, which nothing outside can cause
    monkeypatch.setattr(servo._tip, "wish", fails)
    state = servo.step([0.0, 0.1, 0.0])
    assert isinstance(servo.last_error, ZeroDivisionError)
    assert not state.proven
    assert state.nearest is not None
    assert near.nearest is not None
    assert (state.nearest.link, state.nearest.name) == (near.nearest.link, "ball")
    assert state.margin == pytest.approx(near.margin, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_records_stay_consistent_while_obstacles_come_move_and_go(servo: Servo, seed: int) -> None:
    """Every per-pair array has one entry per pair, and obstacles are where their own motion puts them."""
    rng = np.random.default_rng(seed)
    there: dict[str, np.ndarray] = {}
    speed: dict[str, np.ndarray] = {}
    for count in range(150):
        what = int(rng.integers(4))
        name = f"thing {rng.integers(6)}"
        if what == 0 and name not in there:
            there[name], speed[name] = np.zeros(3), rng.normal(size=3) * rng.integers(2)
            place = [6.0 + float(rng.uniform(2.0, 9.0)), float(rng.uniform(-9.0, 9.0)), 0.0]
            servo.add({**BALL, "name": name, "position": place, "velocity": speed[name].tolist()})
        elif what == 1 and name in there:
            servo.remove(name)
            del there[name], speed[name]
        elif what == 2 and name in there:
            by = rng.normal(size=3)
            servo.move(name, by)
            there[name] = there[name] + by
        elif what == 3 and name in there:
            speed[name] = rng.normal(size=3) * rng.integers(2)
            servo.set_velocity(name, speed[name])
        servo.step([0.0, 0.1 * (-1) ** count, 0.0])
        assert servo.last_error is None
        for known in there:
            there[known] = there[known] + 0.005 * speed[known]
            np.testing.assert_allclose(servo.shift_of(known), there[known], atol=1e-9)
        assert set(servo.obstacles) == set(there)
        # opens the wall: arrays that stay long when an obstacle goes show only here
        bounds = servo._bounds
        for array in (bounds._proven, bounds._distance, bounds.required, bounds._renewed_at, bounds._reach):
            assert len(array) == len(servo._separation)


@pytest.mark.parametrize("shape", obstacle_shapes.shape_records())
def test_an_obstacle_of_a_moved_record_is_where_the_built_one_is_shifted_to(
    servo: Servo, tmp_path: Path, shape: str
) -> None:
    (tmp_path / "peak.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    (tmp_path / "ground.csv").write_text("0,0.5\n0.2,0\n")
    (tmp_path / "scan.csv").write_text("x,y,z\n0,0,0\n0.3,0.2,0.1\n")
    spec, by = obstacle_from_dict({"name": "thing", "shape": shape, **SHAPES[shape]}), np.array([-0.7, 0.4, 0.2])

    def built(spec: obstacle_shapes.ObstacleSpec) -> Obstacle:
        return build_obstacle(spec, folder=tmp_path, clearance=0.0)

    moved, expected, still = (
        Proximity(servo.robot, [one], self_collision=False).distances(servo.q)
        for one in (built(spec.moved(by)), shifted(built(spec), by), built(spec))
    )
    np.testing.assert_allclose(moved, expected, atol=1e-9)
    assert np.abs(moved - still).max() > 0.01
