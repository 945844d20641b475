"""The scene file: valid scenes are read as meant, errors are explained."""

from __future__ import annotations

import copy
import json
import math
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from strategies import scenes

from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.live import Servo
from backhoe_planner.machine import load_robot, shipped_folder
from backhoe_planner.site import (
    Capsule,
    HalfSpace,
    Pose,
    Scene,
    load_scene,
    obstacle_from_dict,
    scene_from_dict,
    scene_schema,
)

Data = dict[str, Any]

GOAL: Data = {"version": 1, "start": {"joints": {"swing": 0.0}}, "task": {"goal": {"position": [4.2, 1.0, -1.0]}}}
POINTS: list[Data] = [{"position": [5.0, 0.0, -0.6]}, {"position": [3.0, 0.0, -1.2]}]
SPHERE: Data = {"name": "boulder", "shape": "sphere", "radius": 0.4}

# Every key of the contract, in one scene.
WHOLE = """
version: 1
name: trench beside a gas pipe
tip: bucket_tip
start: {joints: {swing: 0.0, boom: 0.4, stick: -1.6, bucket: -0.9}}
task:
  path:
    waypoints:
      - {position: [5.0, 0.0, -0.6]}
      - {position: [3.0, 0.0, -1.2], pitch: -1.4}
    speed: 0.5
    tolerance: 0.005
    detour: true
clearance: 0.05
influence: 0.6
obstacles:
  - {name: gas pipe,   shape: capsule, from: [1, -3, -1], to: [1, 3, -1], radius: 0.1, clearance: 0.5}
  - {name: truck,      shape: box, size: [2.4, 6.0, 1.5], position: [4, 4, 1.2], rpy: [0, 0, 0.2]}
  - {name: pole,       shape: cylinder, radius: 0.15, length: 8.0, position: [3, -2, 4]}
  - {name: boulder,    shape: sphere, radius: 0.4, position: [4, 0.5, -0.3]}
  - {name: power line, shape: halfspace, point: [0, 0, 6], normal: [0, 0, -1], clearance: 3.0}
  - {name: spoil,      shape: mesh, file: spoil.stl, position: [2, 3, 0]}
  - {name: terrain,    shape: heightmap, file: terrain.csv, size: [12, 12], links: [boom, stick]}
  - {name: scan,       shape: pointcloud, file: scan.ply, resolution: 0.1}
  - {name: worker,     shape: capsule, from: [5, 2, 0], to: [5, 2, 1.8], radius: 0.3,
     clearance: 1.0, appears_at: 2.0, velocity: [0, -0.8, 0]}
gains: {s_e: 0.2, s_o: 0.2, s_k: {boom: 0.01, stick: 0.01}}
limits:
  velocity_scale: 1.0
  acceleration: {swing: 0.4, boom: 0.7}
  velocity: {swing: 0.5}
  effort: {boom: 60000.0}
  position: {stick: [-2.2, -0.4]}
hold: {stabilizer: 0.2}
objective: work
payload: 250.0
soil: {density: 1700, cohesion: 5000, friction: 0.55}
"""


def scene(**changes: object) -> Data:
    return {**copy.deepcopy(GOAL), **changes}


def goal(**keys: object) -> Data:
    return scene(task={"goal": {"position": [4.2, 1.0, -1.0], **keys}})


def path(*waypoints: Data, **keys: object) -> Data:
    return scene(task={"path": {"waypoints": list(waypoints), **keys}})


def obstacle(**keys: object) -> Data:
    return scene(obstacles=[{**SPHERE, **keys}])


def shaped(kind: str, **keys: object) -> Data:
    return scene(obstacles=[{"name": "thing", "shape": kind, **keys}])


# --- valid scenes -------------------------------------------------------------


def test_a_scene_with_every_key_is_read_as_written(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(WHOLE)
    found = load_scene(file)
    assert (found.name, found.tip, found.clearance, found.payload) == (
        "trench beside a gas pipe",
        "bucket_tip",
        0.05,
        250.0,
    )
    assert (found.folder, found.file) == (tmp_path, file)
    assert found.start is not None
    assert found.start.joints == {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
    assert [waypoint.pitch_range for waypoint in found.waypoints()] == [None, (-1.4, -1.4)]
    assert [thing.shape for thing in found.obstacles] == [
        "capsule",
        "box",
        "cylinder",
        "sphere",
        "halfspace",
        "mesh",
        "heightmap",
        "pointcloud",
        "capsule",
    ]
    pipe, worker = found.obstacles[0], found.obstacles[-1]
    assert isinstance(pipe, Capsule)
    assert (pipe.start, pipe.end, pipe.clearance, pipe.velocity) == ((1, -3, -1), (1, 3, -1), 0.5, (0, 0, 0))
    assert (worker.appears_at, worker.velocity) == (2.0, (0.0, -0.8, 0.0))
    assert found.obstacles[6].links == ("boom", "stick")
    assert found.gains != "auto"
    assert found.gains.s_k == {"boom": 0.01, "stick": 0.01}
    assert found.limits.acceleration == {"swing": 0.4, "boom": 0.7}
    assert (found.limits.velocity, found.limits.effort) == ({"swing": 0.5}, {"boom": 6e4})
    assert found.limits.position == {"stick": (-2.2, -0.4)}
    assert found.hold == {"stabilizer": 0.2}
    assert found.soil is not None
    assert found.soil.density == 1700.0


def test_missing_keys_have_the_documented_defaults() -> None:
    found = scene_from_dict(GOAL)
    assert (found.tip, found.name, found.obstacles, found.gains, found.objective) == (None, "", (), "auto", None)
    assert (found.clearance, found.influence, found.payload, found.soil) == (0.05, 0.6, 0.0, None)
    assert (found.limits.velocity_scale, found.limits.acceleration) == (1.0, {})
    followed = scene_from_dict(path(*POINTS)).task.path
    assert followed is not None
    assert (followed.speed, followed.tolerance, followed.detour) == (None, 0.005, True)


def test_a_scene_without_a_name_has_the_title_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "bench.two.yaml"
    file.write_text(yaml.safe_dump(GOAL), encoding="utf-8")
    assert load_scene(file).title == "bench.two"
    assert scene_from_dict(GOAL).title == "untitled scene"
    assert scene_from_dict(GOAL | {"name": "dig"}).title == "dig"


def test_start_may_be_left_out_with_a_path() -> None:
    found = path(*POINTS)
    del found["start"]
    assert scene_from_dict(found).start is None


def only_goal(content: dict[str, Any]) -> Pose:
    (found,) = scene_from_dict(content).task.goals
    assert isinstance(found, Pose)
    return found


def test_pitch_is_a_number_or_a_range() -> None:
    for given_pitch, expected in ((-1.4, (-1.4, -1.4)), ([-2.2, -1.2], (-2.2, -1.2)), (None, None)):
        found = only_goal(goal(pitch=given_pitch))
        assert found.pitch_range == expected
        assert found.rotation is None


def test_rpy_and_quaternion_of_a_quarter_turn_about_z_are_one_rotation() -> None:
    half = np.sqrt(0.5)
    for keys in (
        {"rpy": [0, 0, np.pi / 2]},
        {"quaternion": [half, 0, 0, half]},
        {"quaternion": [0.7071, 0, 0, 0.7071]},
    ):
        found = only_goal(goal(**keys))
        assert found.rotation is not None
        np.testing.assert_allclose(found.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_normalising_a_unit_quaternion_or_normal_again_changes_no_digit() -> None:
    rng = np.random.default_rng(0)
    for parts in rng.normal(size=(500, 4)).tolist():
        unit = [part / math.hypot(*parts) for part in parts]
        goal_once = only_goal(goal(quaternion=unit))
        again = only_goal(goal(quaternion=goal_once.quaternion))
        assert again.quaternion == goal_once.quaternion
        once = scene_from_dict(shaped("halfspace", point=[0, 0, 0], normal=parts[:3])).obstacles[0]
        assert isinstance(once, HalfSpace)
        twice = scene_from_dict(shaped("halfspace", point=[0, 0, 0], normal=once.normal)).obstacles[0]
        assert isinstance(twice, HalfSpace)
        assert twice.normal == once.normal


def test_a_normal_of_any_length_becomes_a_unit_vector() -> None:
    for normal in ([0, 3, 4], [0, 3e-9, 4e-9], [0, 3e200, 4e200]):
        thing = scene_from_dict(shaped("halfspace", point=[0, 0, 0], normal=normal)).obstacles[0]
        assert isinstance(thing, HalfSpace)
        np.testing.assert_allclose(thing.normal, [0.0, 0.6, 0.8], atol=1e-15)


def test_scene_cannot_be_changed_after_reading() -> None:
    with pytest.raises(ValueError, match="does not change once it is made"):
        scene_from_dict(GOAL).clearance = 1.0


def test_reading_does_not_change_the_data_it_is_given() -> None:
    given_data = obstacle()
    before = copy.deepcopy(given_data)
    scene_from_dict(given_data)
    assert given_data == before


def test_shipped_scenes_are_read_and_found_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files = sorted(shipped_folder("scenes").glob("*.yaml"))
    assert files
    for file in files:
        assert load_scene(f"scenes/{file.name}") == load_scene(file)


def test_a_single_obstacle_is_read_with_the_same_keys_as_in_a_scene() -> None:
    found = obstacle_from_dict(SPHERE)
    assert found == scene_from_dict(scene(obstacles=[SPHERE])).obstacles[0]


NO_OBSTACLE: list[tuple[Data, list[str]]] = [
    ({"shape": "ball", "name": "b"}, ["b: is not an obstacle", "no shape 'ball'", "Allowed: box, capsule, cylinder"]),
    ({"name": "b"}, ["b: is not an obstacle: shape is missing", "box, capsule"]),
    ({"shape": "sphere", "name": "b"}, ["b: is not an obstacle: radius: is missing"]),
    ({"shape": "sphere", "radius": 1.0}, ["obstacle: is not an obstacle: name: is missing"]),
    ({"shape": "sphere", "name": "b", "radios": 1.0, "radius": 1.0}, ["radios", "did you mean 'radius'?"]),
]


@pytest.mark.parametrize(("data", "said"), NO_OBSTACLE)
def test_errors_in_a_single_obstacle_are_one_line_that_names_it(data: Data, said: list[str]) -> None:
    servo = Servo(load_robot("example:planar4"), scene_from_dict(scene()), q=np.zeros(4))
    for read in (obstacle_from_dict, servo.add):
        with pytest.raises(InputError) as caught:
            read(data)
        for fragment in said:
            assert fragment in str(caught.value)
        assert "http" not in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


# --- errors -------------------------------------------------------------------

BAD: dict[str, tuple[Data, list[str]]] = {
    "unknown key": (scene(clearence=0.1), ["clearence", "no such key", "did you mean 'clearance'?", "influence"]),
    "unknown key, like none": (scene(wibble=1), ["wibble: there is no such key. Allowed: base, clearance"]),
    "key that is cut short": (scene(clear=0.1), ["clear: there is no such key; did you mean 'clearance'?"]),
    "unknown key of an obstacle": (obstacle(radios=1), ["obstacles[0].radios", "did you mean 'radius'?", "velocity"]),
    "key of another shape": (obstacle(length=1), ["obstacles[0].length", "no such key"]),
    "unknown key of a goal": (goal(pich=1), ["task.goal.pich", "did you mean 'pitch'?"]),
    "unknown key of a waypoint": (
        path(POINTS[0], {**POINTS[1], "pitc": 1}),
        ["task.path.waypoints[1].pitc", "'pitch'"],
    ),
    "unknown key of a path": (path(*POINTS, sped=1), ["task.path.sped", "did you mean 'speed'?"]),
    "unknown key of gains": (scene(gains={"s_x": 1}), ["gains.s_x", "s_e, s_k, s_o"]),
    "unknown key of limits": (scene(limits={"velocity_scal": 1}), ["limits.velocity_scal", "'velocity_scale'"]),
    "joints one level too high": (
        scene(start={"swing": 0.0, "boom": 1}),
        ["start.swing: there is no such key; did you mean 'joints.swing'? Allowed: joints, tip"],
    ),
    "unknown key beside joints": (scene(start={"joints": {}, "swing": 0.0}), ["start.swing", "no such key. Allowed"]),
    "goal outside its task": (
        scene(goal={"position": [3.0, 0.0, 1.0]}),
        ["goal: there is no such key; did you mean 'task.goal'?"],
    ),
    "speed outside its path": (scene(speed=0.3), ["speed: there is no such key; did you mean 'task.path.speed'?"]),
    "objective inside its goal": (
        goal(objective="work"),
        ["task.goal.objective: there is no such key; did you mean 'objective' at the top level? Allowed: "],
    ),
    "objective in two places": (
        goal(objective="work") | {"objective": "work"},
        ["task.goal.objective: there is no such key. Allowed: "],
    ),
    "duration inside its goal": (
        goal(max_duration=3.0),
        ["task.goal.max_duration: there is no such key; did you mean 'task.max_duration'? Allowed: "],
    ),
    "payload inside the goal of a leg": (
        scene(task={"sequence": [{"name": "a", "goal": [{"position": [3.0, 0.0, 1.0], "payload": 3.0}]}]}),
        ["task.sequence[0].goal[0].payload: there is no such key; did you mean 'task.sequence[0].payload'? Allowed: "],
    ),
    "key with many places": (scene(pitch=0.3), ["pitch: there is no such key. Allowed"]),
    "key with many places, spelt nearly as another": (
        scene(task={"pitch": 0.3, "goal": {"position": [1.0, 0.0, 0.0]}}),
        ["task.pitch: there is no such key. Allowed"],
    ),
    "number for a list": (
        shaped("box", size=12),
        ["obstacles[0].size: is not a list; found 12; allowed: a list of 3 numbers"],
    ),
    "unknown key of soil": (scene(soil={"densty": 1}), ["soil.densty", "did you mean 'density'?"]),
    "a key of something else": (scene(soil={"position": 1}), ["soil.position: there is no such key. Allowed: "]),
    "unknown key of the start": (scene(start={"joint": {}}), ["start.joint", "did you mean 'joints'?"]),
    "key that is no text": (scene(obstacles=[]) | {1: 2}, ["1", "strings"]),  # type: ignore[dict-item]
    "no version": ({"task": GOAL["task"], "start": GOAL["start"]}, ["version: is missing; allowed: version: 1"]),
    "later version": (scene(version=2), ["version", "1", "found 2"]),
    "version in quotes": (scene(version="1"), ["version", "found '1'; allowed: 1 (without quotes)"]),
    "no task": ({"version": 1}, ["task: is missing"]),
    "no radius": (shaped("sphere"), ["obstacles[0].radius: is missing"]),
    "no name": (scene(obstacles=[{"shape": "sphere", "radius": 1}]), ["obstacles[0].name: is missing"]),
    "empty name": (obstacle(name=""), ["obstacles[0].name", "at least 1 character"]),
    "no shape": (scene(obstacles=[{"name": "thing"}]), ["obstacles[0]: shape is missing", "box, capsule, cylinder"]),
    "unknown shape": (shaped("sfere"), ["no shape 'sfere'", "did you mean 'sphere'?", "halfspace, heightmap"]),
    "no end of a capsule": (shaped("capsule", **{"from": [0, 0, 0], "radius": 1}), ["obstacles[0].to: is missing"]),
    "obstacle that is text": (scene(obstacles=["boulder"]), ["obstacles[0]", "found 'boulder'"]),
    "decimal comma": (obstacle(radius="0,3"), ["radius", "takes a decimal point", "found '0,3'", "allowed: 0.3"]),
    "decimal commas in a vector": (
        obstacle(position=[3, 0, 2, 0, 0, 8]),
        ["position", "at most 3", "takes a decimal point, not a comma"],
    ),
    "text for a number": (obstacle(radius="big"), ["obstacles[0].radius", "valid number, in m; found 'big'"]),
    "quoted number": (obstacle(radius="0.3"), ["obstacles[0].radius", "valid number", "found '0.3'"]),
    "truth for a number": (obstacle(radius=True), ["obstacles[0].radius", "valid number", "found True"]),
    "number for a name": (obstacle(name=5), ["obstacles[0].name", "string", "found 5"]),
    "number for a vector": (goal(position=5), ["task.goal.position", "found 5"]),
    "vector of two": (
        scene(task={"goal": {"position": [1, 2]}}),
        ["task.goal.position: has 2 entries, allowed: 3 numbers; found [1, 2]"],
    ),
    "two angles": (
        scene(task={"goal": {"position": [1, 2, 3], "rpy": [0, 1]}}),
        ["task.goal.rpy: has 2 entries, allowed: 3 numbers; found [0, 1]"],
    ),
    "vector of four": (scene(task={"goal": {"position": [1, 2, 3, 4]}}), ["task.goal.position", "at most 3"]),
    "NaN": (scene(task={"goal": {"position": [1, 2, float("nan")]}}), ["task.goal.position[2]", "finite", "nan"]),
    "infinite": (scene(clearance=float("inf")), ["clearance", "finite", "found inf"]),
    "infinite joint": (scene(start={"joints": {"boom": float("-inf")}}), ["start.joints.boom", "finite"]),
    "negative radius": (obstacle(radius=-1), ["obstacles[0].radius", "greater than or equal to 0.000001", "found -1"]),
    "zero radius": (obstacle(radius=0), ["obstacles[0].radius", "greater than or equal to 0.000001", "found 0"]),
    "radius of rounding": (obstacle(radius=1e-300), ["obstacles[0].radius", "equal to 0.000001", "found 1e-300"]),
    "negative edge": (shaped("box", size=[1, -1, 1]), ["obstacles[0].size[1]", "equal to 0.000001", "-1"]),
    "thin block": (shaped("box", size=[1, 1e-9, 1]), ["obstacles[0].size[1]", "equal to 0.000001", "found 1e-09"]),
    "thin cylinder": (
        shaped("cylinder", radius=1.0, length=1e-9),
        ["obstacles[0].length", "equal to 0.000001", "found 1e-09"],
    ),
    "flat cylinder": (
        shaped("cylinder", radius=1e5, length=1e-3),
        [
            "obstacles[0]: a cylinder's",
            "length is 1e-05 to 100000 times its radius",
            "0.001 m and 100000 m (1e-08 times)",
        ],
    ),
    "needle": (shaped("cylinder", radius=1e-5, length=10.0), ["obstacles[0]", "10 m and 1e-05 m (1e+06 times)"]),
    "fine voxels": (shaped("pointcloud", file="a.xyz", resolution=1e-9), ["obstacles[0].resolution", "0.000001"]),
    "wall of three coordinates": (
        scene(zones=[{"name": "w", "kind": "wall", "from": [5, 0, 1], "to": [5, 3]}]),
        ["zones[0].from", "three coordinates", "two, x and y", "found [5, 0, 1]", "point and normal"],
    ),
    "negative clearance": (scene(clearance=-0.1), ["clearance", "greater than or equal to 0", "-0.1"]),
    "appears in the past": (obstacle(appears_at=-1), ["obstacles[0].appears_at", "greater than or equal to 0"]),
    "negative payload": (scene(payload=-1), ["payload", "greater than or equal to 0 kg; found -1"]),
    "no speed": (path(*POINTS, speed=0), ["task.path.speed", "greater than 0"]),
    "more than full rate": (
        scene(limits={"velocity_scale": 1.5}),
        ["limits.velocity_scale", "less than or equal to 1"],
    ),
    "no rate": (scene(limits={"velocity": {"boom": 0.0}}), ["limits.velocity.boom", "greater than 0"]),
    "a rate for ages": (scene(limits={"velocity": {"boom": 1e-300}}), ["limits.velocity.boom", "is too slow: 1e-300"]),
    "a scale for ages": (scene(limits={"velocity_scale": 1e-6}), ["limits.velocity_scale", "at least 0.0001"]),
    "list in a list of goals": (
        scene(task={"goal": [[{"position": [1, 2, 3]}]]}),
        ["task.goal[0]: is a list; allowed: {key: value, ...}"],
    ),
    "three numbers in a list of goals": (
        scene(task={"goal": [[1, 2, 3]]}),
        ["task.goal[0]: is a list of numbers; allowed: {position: [1, 2, 3]}"],
    ),
    "finer than is measured": (goal(tolerance=1e-13), ["task.goal.tolerance", "found 1e-13"]),
    "range of one": (scene(limits={"position": {"boom": [0.1]}}), ["limits.position.boom"]),
    "held nowhere": (scene(hold={"boom": None}), ["hold.boom", "valid number"]),
    "no acceleration": (scene(limits={"acceleration": {"boom": 0}}), ["limits.acceleration.boom", "greater than 0"]),
    "steep friction": (scene(soil={"friction": 2.0}), ["soil.friction", "less than 1.57"]),
    "friction in degrees": (scene(soil={"friction": 30.0}), ["soil.friction", "radians", "30 degrees are 0.5236 rad"]),
    "density as a weight": (scene(soil={"density": 18.0}), ["soil.density", "18 kN/m^3 are 1835 kg/m^3"]),
    "density in tonnes": (scene(soil={"density": 1.8}), ["soil.density", "1.8 t/m^3 are 1800 kg/m^3"]),
    "unknown objective": (scene(objective="energy"), ["objective", "'work'", "found 'energy'"]),
    "misspelt objective": (scene(objective="tim"), ["objective", "found 'tim'", "did you mean 'time'?"]),
    "list without entries": (obstacle(links=[]), ["obstacles[0].links: has 0 entries, allowed: at least 1"]),
    "key without a list": (scene(obstacles=None), ["obstacles: has no value; give a list, or leave the key out"]),
    "key without keys": (
        scene(limits={"velocity": None}),
        ["limits.velocity: has no value; give keys and values, or leave the key out"],
    ),
    "number for one by joint": (scene(limits={"velocity": 0.5}), ["limits.velocity", "found 0.5", "{key: value, ...}"]),
    "perhaps": (path(*POINTS, turn_on_the_spot="maybe"), ["turn_on_the_spot: is not true or false; found 'maybe'"]),
    "no step at all": (
        path(*POINTS, max_joint_step=0),
        ["site/trench.yaml: task.path.max_joint_step: input should be greater than 0 rad or m; found 0"],
    ),
    "unknown gains": (scene(gains="automatic"), ["gains", "'auto'", "found 'automatic'"]),
    "tolerance of an orientation to be kept in degrees": (
        goal(keep={"rotation": {"rpy": [0, 1.5, 0], "tolerance": 5}}),
        ["rotation.tolerance", "radians, below 3.142", "5 degrees are 0.08727 rad"],
    ),
    "goal turned by degrees": (goal(rpy=[0, 90, 0]), ["task.goal.rpy", "[0.0, 90.0, 0.0] looks like degrees"]),
    "box turned by degrees": (
        shaped("box", size=[1, 1, 1], rpy=[0, 0, -45]),
        ["obstacles[0].rpy", "radians, within one turn either way", "looks like degrees"],
    ),
    "path turned by degrees": (path(*POINTS, origin={"rpy": [0, 0, 30]}), ["task.path.origin.rpy", "degrees"]),
    "cab turned by degrees": (
        scene(zones=[{"name": "c", "kind": "cab", "size": [1, 1, 1], "position": [0, 0, 2], "rpy": [0, 0, 90]}]),
        ["zones[0].rpy", "looks like degrees"],
    ),
    "goal and path": (
        scene(task={"goal": {"position": [1, 2, 3]}, "path": {"waypoints": POINTS}}),
        ["task", "exactly one of goal, path"],
    ),
    "neither goal nor path": (scene(task={}), ["task", "exactly one of goal, path"]),
    "waypoints and file": (path(*POINTS, file="p.csv"), ["task.path", "exactly one of waypoints, file"]),
    "neither waypoints nor file": (scene(task={"path": {}}), ["task.path", "exactly one of waypoints, file"]),
    "joints and tip": (scene(start={"joints": {}, "tip": POINTS[0]}), ["start", "exactly one of joints, tip"]),
    "empty start": (scene(start={}), ["start", "exactly one of joints, tip"]),
    "goal without start": ({"version": 1, "task": GOAL["task"]}, ["a goal needs start"]),
    "path of one point": (path(POINTS[0]), ["task.path", "at least 2 waypoints", "has 1"]),
    "path of no point": (path(), ["task.path", "at least 2 waypoints", "has 0"]),
    "path in one point": (path(POINTS[0], POINTS[0], POINTS[0]), ["task.path", "all lie in one point"]),
    "mixed path": (
        path({**POINTS[0], "pitch": 0.1}, {**POINTS[1], "rpy": [0, 0, 0]}),
        ["task.path", "mixes pitch and full orientation"],
    ),
    "pitch and quaternion": (
        goal(pitch=0.1, quaternion=[1, 0, 0, 0]),
        ["task.goal", "only one of", "pitch and quaternion"],
    ),
    "rpy and quaternion": (goal(rpy=[0, 0, 0], quaternion=[1, 0, 0, 0]), ["task.goal", "rpy and quaternion"]),
    "rpy and quaternion of a box": (
        shaped("box", size=[1, 1, 1], rpy=[0, 0, 0], quaternion=[1, 0, 0, 0]),
        ["obstacles[0]: only one of rpy, quaternion"],
    ),
    "reversed pitch range": (goal(pitch=[-1.2, -2.2]), ["task.goal", "reversed", "[-1.2, -2.2]"]),
    "pitch of three": (goal(pitch=[1, 2, 3]), ["task.goal.pitch", "at most 2"]),
    "long quaternion": (goal(quaternion=[1, 1, 0, 0]), ["task.goal.quaternion", "length 1", "1.414"]),
    "no quaternion": (goal(quaternion=[0, 0, 0, 0]), ["task.goal.quaternion", "length 1"]),
    "no normal": (shaped("halfspace", point=[0, 0, 0], normal=[0, 0, 0]), ["obstacles[0].normal", "no direction"]),
    "two of one name": (
        scene(obstacles=[SPHERE, SPHERE]),
        ["obstacles[1].name: is the name of obstacles[0]; found boulder"],
    ),
    "goal of three numbers": (
        scene(task={"goal": [2.4, 3, 1.2]}),
        ["site/trench.yaml: task.goal: is a list of numbers; allowed: {position: [2.4, 3, 1.2]}"],
    ),
    "waypoint of three numbers": (
        scene(task={"path": {"waypoints": [POINTS[0], [3, 0, 1]]}}),
        ["task.path.waypoints[1]: is a list of numbers; allowed: {position: [3, 0, 1]}"],
    ),
    "waypoints of one place": (
        scene(task={"path": {"waypoints": [1, 2, 3]}}),
        ["yaml: task.path.waypoints: is a list of numbers; allowed: [{position: [1, 2, 3]}, ...]"],
    ),
    "waypoints of numbers": (
        scene(task={"path": {"waypoints": [[1, 2, 3], [3, 0, 1], [1, 2]]}}),
        ["yaml: task.path.waypoints: are lists of numbers; allowed: [{position: [1, 2, 3]}, ...]"],
    ),
    "goals of numbers": (
        scene(task={"goal": [[1, 2, 3], [2, 3, 4]]}),
        ["yaml: task.goal: are lists of numbers; allowed: [{position: [1, 2, 3]}, ...]"],
    ),
    "one goal of numbers": (
        scene(task={"goal": [{"position": [1, 2, 3]}, [2, 3, 4]]}),
        ["yaml: task.goal[1]: is a list of numbers; allowed: {position: [2, 3, 4]}"],
    ),
    "goal of two numbers": (
        scene(task={"goal": [2.4, 3]}),
        ["yaml: task.goal: is a list of numbers; allowed: {position: [x, y, z]}"],
    ),
    "goal that is no number": (
        scene(task={"goal": [2.4, 3, math.nan]}),
        ["yaml: task.goal: is a list of numbers; allowed: {position: [x, y, z]}"],
    ),
    "several at once": (scene(clearence=1, payload=-1), ["2 problems", "clearence", "payload"]),
}


@pytest.mark.parametrize(("data", "said"), BAD.values(), ids=BAD.keys())
def test_errors_in_a_scene_name_the_key(data: Data, said: list[str]) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_dict(data, file=Path("site/trench.yaml"))
    message = str(caught.value)
    assert message.startswith("site/trench.yaml: ")
    for fragment in said:
        assert fragment in message
    for inner in ("tuple", "validation", "literal[", "union", "tagged", "function-", "pydantic", "Value error"):
        assert inner not in message, "a name of the schema's machinery, not of the scene"


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ([1, -1, 1], "obstacles[0].scale[1]: input should be greater than 0; found -1"),
        (-2, "obstacles[0].scale: input should be greater than 0; found -2"),
        ([1, 1], "obstacles[0].scale: has 2 entries, allowed: 3 numbers; found [1, 1]"),
        ("big", "obstacles[0].scale: input should be a valid number; found 'big'"),
    ],
)
def test_errors_in_a_scale_concern_only_the_form_that_was_given(scale: Any, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_dict(shaped("mesh", file="rock.stl", scale=scale))
    assert str(caught.value) == said


def test_scene_error_is_an_input_error_and_a_value_error() -> None:
    for kind in (InputError, ValueError):
        with pytest.raises(kind):
            scene_from_dict({})


# --- YAML ---------------------------------------------------------------------


def load_text(folder: Path, text: str) -> Scene:
    file = folder / "scene.yaml"
    file.write_text(text)
    return load_scene(file)


BAD_YAML = {
    "duplicate key": ("version: 1\nname: a\ntask: {}\nname: b\n", ["name: the key stands twice", "line 2 and line 4"]),
    "duplicate key inside": (
        "version: 1\nobstacles:\n  - name: a\n    radius: 1\n    radius: 2\n",
        ["obstacles.0.radius|obstacles[0].radius", "line 4 and line 5"],
    ),
    "decimal comma in a line": (
        "version: 1\nstart: {joints: {boom: 0,9, stick: -1}}\n",
        ["start.joints.boom (line 2)", "takes a decimal point", "found 0,9", "allowed: 0.9"],
    ),
    "tab": ("version: 1\ntask:\n\tgoal: 1\n", ["line 3", "tab", "spaces"]),
    "empty": ("", ["the file is empty"]),
    "blank": (" \n\n", ["the file is empty"]),
    "comments only": ("# nothing yet\n", ["does not hold keys and values"]),
    "a list": ("- version: 1\n", ["does not hold keys and values"]),
    "a word": ("trench\n", ["does not hold keys and values"]),
    "unclosed quote": ('name: "trench\n', ["line 2", "is not YAML"]),
    "unclosed bracket": (
        "task: {goal: {position: [1, 2, 3}\n",
        ["line 1", "the [ of line 1, column 25 is not closed"],
    ),
    "two documents": ("version: 1\n---\nversion: 1\n", ["line 2", "another document"]),
    "unknown alias": ("name: *other\n", ["line 1", "other"]),
    "Python object": ("name: !!python/object:os.system x\n", ["name (line 1)", "none of YAML's core"]),
    "word for a flag": ("name: !!bool foo\n", ["a tag does not fit its value"]),
    "list for a number": ("payload: !!int [1]\n", ["a tag does not fit its value"]),
    "date": ("name: !!timestamp 2020-01-01\n", ["name (line 1): the tag is none of", "timestamp", "!!bool"]),
    "ordered mapping": ("obstacles: !!omap [a: 1]\n", ["obstacles (line 1): the tag is none of", "omap"]),
    "half of a character": ('tip: "\\ud800"\n', ["tip (line 1): a text contains an incomplete character", r"'\ud800'"]),
    "title of two lines": (
        'version: 1\nname: "a\\nb"\ntask: {goal: {position: [1, 2, 3]}}\n',
        ["name (line 2): is no title", r"a\nb"],
    ),
    "control character": ("name: a\x00b\n", ["is not YAML", "#x0000"]),
    "list as a key": ("? [1]\n: 2\n", ["line 1", "is not YAML"]),
    "endless nesting": ("a: &a [*a]\n", ["cannot be understood"]),
    "deep nesting": ("a: " + "[" * 1000 + "\n", ["cannot be understood"]),
    "aliases of aliases": (
        "a: &a [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n"
        + "".join(f"{y}: &{y} [{', '.join(['*' + x] * 10)}]\n" for x, y in pairwise("abcdefghi")),
        ["more than 200000 entries"],
    ),
    "number of 5000 digits": ("payload: " + "9" * 5000 + "\n", ["cannot be understood", "digits"]),
    "line of a wrong value": (
        "version: 1\nstart: {joints: {}}\ntask: {goal: {position: [1, 2, 3]}}\nobstacles:\n"
        "  - {name: a, shape: sphere, radius: 1}\n  - name: b\n    shape: sphere\n    radius: -2\n",
        ["obstacles[1].radius (line 8)", "equal to 0.000001", "found -2"],
    ),
    "line of an unknown key": ("version: 1\ntask: {}\n\nclearanc: 1\n", ["clearanc (line 4)", "'clearance'"]),
}


@pytest.mark.parametrize(("text", "said"), BAD_YAML.values(), ids=BAD_YAML.keys())
def test_errors_in_a_scene_file_name_the_file_once_and_the_line(text: str, said: list[str], tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        load_text(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "scene.yaml"))
    assert message.count(str(tmp_path)) == 1
    for fragment in said:
        assert any(either in message for either in fragment.split("|")), message


def test_a_file_that_is_not_utf8_is_named(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes("name: Gräben".encode("latin-1"))
    with pytest.raises(SceneError, match=r"scene\.yaml: is not UTF-8 text: .* at byte 8"):
        load_scene(file)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"nowhere\.yaml: no such scene file"):
        load_scene(tmp_path / "nowhere.yaml")
    with pytest.raises(SceneError, match="is a folder, not a scene file"):
        load_scene(tmp_path)


TASK = "task: {goal: {position: [0, 0, 0]}}\n"
NUMBERS = [("1e-3", 1e-3), (".5", 0.5), ("5.", 5.0), ("+2", 2.0), ("1E2", 100.0), ("007", 7.0), ("1.5e+1", 15.0)]


@pytest.mark.parametrize(("text", "value"), NUMBERS)
def test_numbers_are_read_as_in_yaml_1_2(text: str, value: float, tmp_path: Path) -> None:
    found = load_text(tmp_path, f"version: 1\nstart: {{joints: {{boom: {text}}}}}\n{TASK}")
    assert found.start is not None
    assert found.start.joints == {"boom": value}


@pytest.mark.parametrize("text", ["no", "yes", "on", "off", "y", "2024-01-01", "1_000", "1:30", "0x10", "NO", "<<"])
def test_words_with_a_special_meaning_in_yaml_1_1_are_read_as_text(text: str, tmp_path: Path) -> None:
    found = load_text(tmp_path, f"version: 1\nname: {text}\nstart: {{joints: {{}}}}\n{TASK}")
    assert found.name == text


def test_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + WHOLE.strip().replace("\n", "\r\n").encode())
    assert load_scene(file).name == "trench beside a gas pipe"


def test_anchors_are_understood(tmp_path: Path) -> None:
    found = load_text(
        tmp_path,
        "version: 1\ntask: {path: {waypoints: [{position: &a [1, 2, 3]}, {position: [0, 0, 0]}, {position: *a}]}}\n",
    )
    assert [waypoint.position for waypoint in found.waypoints()] == [(1, 2, 3), (0, 0, 0), (1, 2, 3)]


# --- path files ---------------------------------------------------------------


def from_path_file(folder: Path, text: str | bytes | None) -> Scene:
    if text is not None:
        (folder / "path.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return scene_from_dict(scene(task={"path": {"file": "path.csv"}}), folder=folder)


def test_path_file_of_positions(tmp_path: Path) -> None:
    found = from_path_file(tmp_path, "x,y,z\n1,2,3\n4,5.5,-6e-1\n").waypoints()
    assert [waypoint.position for waypoint in found] == [(1.0, 2.0, 3.0), (4.0, 5.5, -0.6)]


def test_path_file_with_pitch_in_any_order_of_columns(tmp_path: Path) -> None:
    found = from_path_file(tmp_path, "pitch, z, y, x\n-1.4, 3, 2, 1\n\n-1.5, 6, 5, 4\n").waypoints()
    assert [(waypoint.position, waypoint.pitch) for waypoint in found] == [((1, 2, 3), -1.4), ((4, 5, 6), -1.5)]


def test_a_path_file_may_have_semicolons_decimal_commas_and_an_upper_case_header(tmp_path: Path) -> None:
    found = from_path_file(tmp_path, "X;Y;Z;Pitch\n1,5;2;-0,25;-1,4\n4;5;6;-1,5\n").waypoints()
    assert [(waypoint.position, waypoint.pitch) for waypoint in found] == [((1.5, 2, -0.25), -1.4), ((4, 5, 6), -1.5)]


def test_path_file_with_quaternions(tmp_path: Path) -> None:
    found = from_path_file(tmp_path, "x,y,z,qw,qx,qy,qz\n1,2,3,1,0,0,0\n4,5,6,0,0,0,1\n").waypoints()
    assert found[1].rotation is not None
    np.testing.assert_allclose(found[1].rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-15)


def test_path_file_saved_by_a_spreadsheet(tmp_path: Path) -> None:
    assert len(from_path_file(tmp_path, b"\xef\xbb\xbfx,y,z\r\n1,2,3\r\n4,5,6\r\n").waypoints()) == 2


def test_unused_columns_of_a_path_file_give_a_warning(tmp_path: Path) -> None:
    """Whatever they contain: `time` too, since speed and limits determine the timing."""
    found = from_path_file(tmp_path, "time,x,y,z,note,pich\n0,1,2,3,begin,0.1\n,4,5,6,,\n")
    assert [waypoint.position for waypoint in found.waypoints()] == [(1, 2, 3), (4, 5, 6)]
    assert [waypoint.pitch for waypoint in found.waypoints()] == [None, None]
    file = tmp_path / "path.csv"
    assert found.warnings() == (
        f"{file}: the column time is not used: the scene's speed and the machine's limits time the motion",
        f"{file}: the column note is not used; columns that are: x, y, z, pitch, qw, qx, qy, qz",
        f"{file}: the column pich is not used; columns that are: x, y, z, pitch, qw, qx, qy, qz "
        "(did you mean 'pitch'?)",
    )


def test_a_path_file_of_known_columns_gives_no_warning(tmp_path: Path) -> None:
    assert from_path_file(tmp_path, "x,y,z\n1,2,3\n4,5,6\n").warnings() == ()
    assert scene_from_dict(path(*POINTS)).warnings() == ()


def test_a_tilt_that_may_be_meant_in_degrees_gives_a_warning_with_the_radians() -> None:
    """3 rad are 171.9 deg; 3 deg are 0.05236 rad."""
    cup = {"axis": [0, 0, -1], "tolerance": 3.0}
    kept = scene_from_dict(scene(task={"goal": {"position": [3, 0, 1]}, "keep": {"tilt": cup}}))
    words = "3 rad are 171.9 deg; 3 degrees are 0.05236 rad"
    assert kept.warnings() == (f"task.keep.tilt.tolerance: {words}",)
    legs: list[Data] = [{"name": "first", "goal": {"position": [3, 0, 1]}, "keep": {"tilt": cup | {"tolerance": 0.99}}}]
    legs += [{"name": "last", "goal": [{"position": [3, 0, 1], "tilt": cup}, {"position": [3, 1, 1], "tilt": cup}]}]
    assert scene_from_dict(scene(task={"sequence": legs})).warnings() == (
        f"task.sequence[1].goal.tilt.tolerance: {words}",
    )


def test_a_tolerance_that_may_be_meant_in_millimetres_gives_a_warning() -> None:
    def warnings_of(task: Data) -> tuple[str, ...]:
        return scene_from_dict(scene(task=task)).warnings()

    assert warnings_of({"goal": {"position": [3, 0, 1], "tolerance": 0.99}}) == ()
    assert warnings_of({"goal": {"position": [3, 0, 1], "tolerance": 50.0}}) == (
        "task.goal.tolerance: 50 m are wide; 50 mm are 0.05 m",
    )
    points = [{"position": [3, 0, 1]}, {"position": [4, 0, 1]}]
    legs = [{"name": "first", "path": {"waypoints": points, "tolerance": 5}}]
    assert warnings_of({"sequence": legs}) == ("task.sequence[0].path.tolerance: 5 m are wide; 5 mm are 0.005 m",)


BAD_PATHS: dict[str, tuple[str | bytes | None, list[str]]] = {
    "missing": (None, ["no such path file"]),
    "empty": ("", ["empty"]),
    "blank": ("\n\n", ["empty"]),
    "commas only": (",,\n,,\n", ["the file is empty"]),
    "quaternion of a pose": (
        "x,y,z,pose.orientation.w,ow\n1,2,3,1,0\n4,5,6,1,0\n",
        ["header", "other", "found pose.orientation.w"],
    ),
    "roll in degrees": (
        "x,y,z,roll_deg,pitch [rad]\n1,2,3,0,1\n4,5,6,0,1\n",
        ["header", "found roll_deg, pitch [rad]"],
    ),
    "header only": ("x,y,z\n", ["at least 2 waypoints", "found 0"]),
    "one row": ("x,y,z\n1,2,3\n", ["at least 2 waypoints", "found 1"]),
    "no header": ("1,2,3\n4,5,6\n", ["header", "a column is missing: x, y, z", "found 1,2,3"]),
    "missing column": ("x,y\n1,2\n3,4\n", ["header", "a column is missing", "z"]),
    "column twice": ("x,y,z,z\n1,2,3,4\n4,5,6,7\n", ["header", "twice", "z"]),
    "half a quaternion": ("x,y,z,qw\n1,2,3,1\n4,5,6,1\n", ["header", "a column is missing", "qx, qy, qz"]),
    "quaternion without w": ("x,y,z,qx,qy,qz\n1,2,3,1,0,0\n4,5,6,1,0,0\n", ["header", "a column is missing", "qw"]),
    "quaternion in other words": (
        "x,y,z,q_w,q_x,q_y,q_z\n1,2,3,1,0,0,0\n4,5,6,1,0,0,0\n",
        ["header", "other names", "found q_w, q_x, q_y, q_z", "qw, qx, qy, qz for a whole"],
    ),
    "roll and yaw": ("x,y,z,Roll,pitch,Yaw\n1,2,3,0,1,0\n4,5,6,0,1,0\n", ["header", "found Roll, Yaw", "pitch [rad]"]),
    "pitch and quaternion": (
        "x,y,z,pitch,qw,qx,qy,qz\n1,2,3,0,1,0,0,0\n4,5,6,0,1,0,0,0\n",
        ["line 2", "only one of", "pitch and quaternion"],
    ),
    "word in a cell": ("x,y,z\n1,2,3\n4,five,6\n", ["line 3, y", "not a number", "'five'"]),
    "underscore in a number": ("x,y,z\n1_0,2,3\n4,5,6\n", ["line 2, x", "not a number", "'1_0'"]),
    "digits of another script": ("x,y,z\n1,2,3\n4,٣,6\n", ["line 3, y", "not a number", "'٣'"]),
    "hexadecimal": ("x,y,z\n1,2,0x10\n4,5,6\n", ["line 2, z", "not a number", "'0x10'"]),
    "empty cell": ("x,y,z\n1,2,3\n4,,6\n", ["line 3, y", "not a number", "''"]),
    "NaN": ("x,y,z\n1,2,nan\n4,5,6\n", ["line 2, z", "not finite"]),
    "short row": ("x,y,z\n1,2,3\n4,5\n", ["line 3", "2 cells", "header 3"]),
    "not a unit quaternion": ("x,y,z,qw,qx,qy,qz\n1,2,3,1,0,0,0\n4,5,6,1,1,0,0\n", ["line 3", "length 1"]),
    "all in one point": ("x,y,z\n1,2,3\n1,2,3\n", ["all lie in one point"]),
    "not text": (b"\xff\xfe\x00x", ["is not UTF-8 text"]),
}


@pytest.mark.parametrize(("text", "said"), BAD_PATHS.values(), ids=BAD_PATHS.keys())
def test_errors_in_a_path_file_name_file_and_line(text: str | bytes | None, said: list[str], tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        from_path_file(tmp_path, text).waypoints()
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "path.csv"))
    for fragment in said:
        assert any(either in message for either in fragment.split("|")), message


# --- moved paths --------------------------------------------------------------


def moved(*waypoints: Data, **origin: object) -> Scene:
    return scene_from_dict(path(*waypoints, origin=origin))


def test_a_path_is_moved_and_turned_as_a_whole() -> None:
    """A quarter turn to the left, then [10, 20, 30]: x becomes y, y becomes -x."""
    waypoints: list[Data] = [{"position": [1, 0, 0], "pitch": -1.2}, {"position": [1, 2, 5]}]
    found = moved(*waypoints, position=[10.0, 20.0, 30.0], rpy=[0.0, 0.0, math.pi / 2]).waypoints()
    np.testing.assert_allclose([waypoint.position for waypoint in found], [[10, 21, 30], [8, 21, 35]], atol=1e-12)
    assert [waypoint.pitch for waypoint in found] == [-1.2, None]


def test_full_orientations_turn_with_their_path() -> None:
    """A roll by a quarter turn: x stays x, y becomes z, z becomes -y; on an orientation from the left."""
    waypoints: list[Data] = [
        {"position": [1, 2, 3], "rpy": [0, 0, math.pi / 2]},
        {"position": [0, 0, 1], "quaternion": [1, 0, 0, 0]},
    ]
    first, second = moved(*waypoints, rpy=[math.pi / 2, 0, 0]).waypoints()
    np.testing.assert_allclose([first.position, second.position], [[1, -3, 2], [0, -1, 0]], atol=1e-12)
    assert first.rotation is not None
    assert second.rotation is not None
    np.testing.assert_allclose(second.rotation, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    # columns are the images of x, y, z: to y, -x, z by the waypoint, then to z, -x, -y
    np.testing.assert_allclose(first.rotation, [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-12)


def test_an_origin_moves_the_waypoints_of_a_path_file(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("x,y,z\n1,2,3\n4,5,6\n")
    task = {"path": {"file": "path.csv", "origin": {"position": [1, 1, 1]}}}
    found = scene_from_dict(scene(task=task), folder=tmp_path).waypoints()
    assert [waypoint.position for waypoint in found] == [(2, 3, 4), (5, 6, 7)]


def test_an_origin_that_tilts_waypoints_with_a_pitch_is_refused(tmp_path: Path) -> None:
    """For a path file the error comes when the file is read."""
    tilted, said = [0.0, 0.1, 0.4], "a path whose waypoints ask for a pitch may turn about z alone"
    with pytest.raises(SceneError, match=said) as caught:
        moved({"position": [1, 0, 0], "pitch": -1.2}, {"position": [1, 2, 5]}, rpy=tilted)
    assert "task.path" in str(caught.value)
    (tmp_path / "path.csv").write_text("x,y,z,pitch\n1,2,3,-1\n4,5,6,-1\n")
    task = {"path": {"file": "path.csv", "origin": {"rpy": tilted}}}
    with pytest.raises(SceneError, match=said):
        scene_from_dict(scene(task=task), folder=tmp_path).waypoints()
    assert len(moved(*POINTS, rpy=tilted).waypoints()) == 2


def test_an_origin_that_puts_a_waypoint_too_far_away_is_named() -> None:
    far = moved({"position": [1, 0, 0]}, {"position": [1, 2, 5]}, position=[1e5 - 1.5, 99_999, 0.0])
    with pytest.raises(SceneError, match=r"task\.path\.origin: puts waypoint 2 too far away: .*100000; found 100001"):
        far.waypoints()


def test_an_origin_needs_position_or_rpy() -> None:
    with pytest.raises(SceneError, match=r"task\.path\.origin: .*position, rpy or both"):
        moved(*POINTS)


# --- round trip, schema -------------------------------------------------------


@cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(scene_schema())


def check_schema(data: object) -> None:
    validator().validate(data)


def test_the_scene_schema_is_a_valid_json_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(scene_schema())


@settings(max_examples=40)
@given(data=scenes())
def test_valid_scenes_pass_the_schema_and_survive_a_round_trip(
    data: Data, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Through `to_dict`, and through a JSON file, since JSON is YAML."""
    first = scene_from_dict(data)
    check_schema(data)
    again = scene_from_dict(json.loads(json.dumps(first.to_dict())))
    assert again == first
    assert again.to_dict() == first.to_dict()
    file = tmp_path_factory.getbasetemp() / "drawn.yaml"
    file.write_text(json.dumps(data, ensure_ascii=False), encoding="utf-8")
    assert load_scene(file).to_dict() == first.to_dict()


def test_the_schema_accepts_a_scene_with_every_key_and_its_round_trip(tmp_path: Path) -> None:
    check_schema(yaml.safe_load(WHOLE))
    check_schema(load_text(tmp_path, WHOLE).to_dict())


SHAPELY = [
    "unknown key",
    "unknown key, like none",
    "unknown key of an obstacle",
    "key of another shape",
    "unknown key of a goal",
    "unknown key of a waypoint",
    "unknown key of a path",
    "unknown key of gains",
    "unknown key of limits",
    "unknown key of soil",
    "unknown key of the start",
    "no version",
    "later version",
    "no task",
    "no radius",
    "no name",
    "empty name",
    "no shape",
    "unknown shape",
    "no end of a capsule",
    "obstacle that is text",
    "text for a number",
    "quoted number",
    "truth for a number",
    "number for a name",
    "number for a vector",
    "vector of two",
    "vector of four",
    "negative radius",
    "zero radius",
    "radius of rounding",
    "negative edge",
    "thin block",
    "thin cylinder",
    "fine voxels",
    "wall of three coordinates",
    "negative clearance",
    "appears in the past",
    "negative payload",
    "no speed",
    "more than full rate",
    "no acceleration",
    "steep friction",
    "friction in degrees",
    "density in tonnes",
    "density as a weight",
    "unknown objective",
    "unknown gains",
    "pitch of three",
]


@pytest.mark.parametrize("name", SHAPELY)
def test_the_schema_refuses_what_the_loader_refuses(name: str) -> None:
    """Errors of a single key; rules between several keys are known to the loader alone."""
    with pytest.raises(jsonschema.ValidationError):
        check_schema(BAD[name][0])


def test_the_schema_describes_the_keys_as_the_code_does() -> None:
    schema = scene_schema()
    assert schema["properties"]["payload"]["description"] == "Mass in the bucket [kg]."
    assert set(schema["$defs"]["Capsule"]["properties"]) >= {"from", "to", "radius"}


def test_the_schema_describes_soil_and_the_default_of_each_key() -> None:
    schema = scene_schema()
    assert "digs" in schema["properties"]["soil"]["description"]
    for key, record in schema["$defs"]["Soil"]["properties"].items():
        assert "default" in record["description"], key
        default = record["default"]
        if default is not None:
            assert f"{default:g} by default" in record["description"]


def test_the_shipped_schema_file_equals_that_of_the_code() -> None:
    beside = shipped_folder("scenes") / "scene.schema.json"
    assert json.loads(beside.read_text(encoding="utf-8")) == scene_schema()


LEVEL: Data = {"pitch": [-0.3, 0.3]}


def keeping(goal: Any, **beside: Any) -> Data:
    return GOAL | {"task": {"goal": goal, **beside}}


def test_keep_may_be_inside_the_goal_or_beside_it() -> None:
    position = {"position": [4.2, 1.0, -1.0]}
    inside = scene_from_dict(keeping(position | {"keep": LEVEL})).task
    beside = scene_from_dict(keeping(position, keep=LEVEL)).task
    assert inside.kept == beside.kept
    assert inside.kept is not None
    assert inside.kept.pitch == (-0.3, 0.3)
    leg = {"name": "swing", "goal": {"joints": {"swing": 0.5}, "keep": LEVEL}}
    legs = scene_from_dict(GOAL | {"task": {"sequence": [leg]}}).task.sequence
    assert legs is not None
    assert legs[0].kept == inside.kept


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (keeping({"position": [4, 1, -1], "keep": LEVEL}, keep=LEVEL), "task: keep is given twice"),
        (keeping([{"position": [4, 1, -1], "keep": LEVEL}, {"position": [4, 2, -1]}]), r"goal\[0\].keep: of several"),
        (keeping({"position": [4, 1, -1], "keep": {"pich": [0, 1]}}), "task.goal.keep.pich.*did you mean 'pitch'"),
    ],
)
def test_keep_given_twice_or_for_one_of_several_goals_is_refused(data: Data, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene_from_dict(data)
