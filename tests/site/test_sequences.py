"""Sequences in a scene file: what is allowed, and the errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from backhoe_planner import InputError, Robot, build_problem, load_robot, scene_from_dict
from backhoe_planner.errors import SceneError
from backhoe_planner.site.schema.obstacle_shapes import Mesh

START = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
REACH: dict[str, Any] = {"name": "reach", "goal": {"position": [4.0, 0.0, 0.5]}}
SWING: dict[str, Any] = {
    "name": "swing",
    "goal": {"position": [0.5, 3.5, 1.0]},
    "payload": 200.0,
    "payload_at": [-0.5, 0.0, 0.2],
}
PATH = {"waypoints": [{"position": [4.0, 0.0, 0.5]}, {"position": [3.5, 0.0, 0.5]}]}


def scene(*legs: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {"version": 1, "start": START, "task": {"sequence": list(legs)}} | keys


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("example:backhoe")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (scene(), "task.sequence: has 0 entries, allowed: at least 1"),
        (scene(REACH, REACH), "task: sequence[1].name: is the name of sequence[0]"),
        (scene({"name": "rest", "wait": 1.0}), "the sequence does nothing but wait"),
        (scene(REACH, {"name": "rest", "wait": -1.0}), "task.sequence[1].wait: input should be greater than 0"),
        (scene(REACH, {"name": "rest"}), "task.sequence[1]: exactly one of goal, path, wait must be given"),
        (scene(REACH | {"wait": 1.0}), "task.sequence[0]: exactly one of goal, path, wait must be given"),
        (scene(REACH, {"name": "rest", "wait": 1.0, "speed": 0.5}), "task.sequence[1]: a wait has no speed"),
        (scene(REACH | {"goal": []}), "task.sequence[0].goal: a list of goals holds at least one"),
        (scene(REACH | {"payloads": 3.0}), "task.sequence[0].payloads: there is no such key; did you mean 'payload'?"),
        (scene(REACH | {"speed": 1e-6}), "slower than 0.1 mm/s"),
        (
            scene({"name": "cut", "path": PATH | {"speed": 0.2}, "speed": 0.3}),
            "speed is given twice, as 0.3 for the leg and as 0.2 for its path",
        ),
        (scene({"goal": REACH["goal"]}), "task.sequence[0].name: is missing"),
        (
            scene(REACH | {"carries": {"name": "wall", "shape": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 1]}}),
            "carries: a halfspace cannot be carried; allowed shapes: box, capsule, cylinder, mesh, sphere",
        ),
        (
            scene(REACH | {"carries": {"name": "pipe", "shape": "sphere", "radius": 0.2, "velocity": [1, 0, 0]}}),
            "carries: velocity applies only to obstacles on the site",
        ),
        (
            scene(REACH, obstacles=[{"name": "rock", "shape": "sphere", "radius": 0.3, "legs": ["reech"]}]),
            "obstacles[0] (rock).legs: the sequence has no leg 'reech'; did you mean 'reach'? Allowed: reach",
        ),
        (
            {"version": 1, "start": START, "task": {"goal": REACH["goal"]},
             "obstacles": [{"name": "rock", "shape": "sphere", "radius": 0.3, "legs": ["reach"]}]},
            "only a sequence has legs",
        ),
        (
            {"version": 1, "start": START, "task": {"sequence": [REACH], "keep": {"above": 0.0}}},
            "keep is given beside a sequence; give it to the legs",
        ),
        ({"version": 1, "task": {"sequence": [REACH]}}, "a sequence whose first leg is not a path needs start"),
        ({"version": 1, "start": START, "task": {"sequence": [REACH], "goal": REACH["goal"]}}, "exactly one of goal"),
    ],
)  # fmt: skip
def test_errors_in_a_sequence_name_leg_and_key(content: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError) as error:
        scene_from_dict(content)
    assert words in str(error.value)


def test_a_leg_with_an_error_is_not_also_reported_as_missing() -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_dict(scene(REACH | {"payloads": 3.0}))
    assert "entries" not in str(caught.value)


@pytest.mark.parametrize(
    ("leg", "key"),
    [
        ({"goal": {"joints": {"swing": 0.0}}}, "task.sequence[1] (next).goal.joints"),
        ({"path": PATH | {"max_joint_step": {"bom": 0.1}}}, "task.sequence[1] (next).path.max_joint_step"),
        ({"goal": REACH["goal"], "carries": {"name": "bucket", "shape": "sphere", "radius": 0.1}}, "carries"),
        ({"goal": REACH["goal"], "carries": {"name": "pipe", "shape": "mesh", "file": "none.stl"}}, "carries"),
    ],
)
def test_legs_that_do_not_fit_the_machine_are_refused_by_leg_and_key(
    robot: Robot, leg: dict[str, Any], key: str
) -> None:
    with pytest.raises(InputError) as error:
        build_problem(robot, scene_from_dict(scene(REACH, {"name": "next"} | leg)))
    assert key in str(error.value)
    assert "task.sequence[1] (next)" in str(error.value)


def test_each_leg_has_its_own_load_and_obstacles(robot: Robot) -> None:
    rocks = [
        {"name": "rock", "shape": "sphere", "radius": 0.3, "position": [4.0, 2.0, 0.0]},
        {"name": "spoil", "shape": "sphere", "radius": 0.3, "position": [3.0, 2.0, 0.0], "legs": ["swing"]},
    ]
    legs = (REACH | {"objective": "work"}, SWING | {"speed": 0.5}, {"name": "rest", "wait": 2.0})
    problem = build_problem(robot, scene_from_dict(scene(*legs, obstacles=rocks, payload=50.0)))
    reach, swing, rest = problem.legs
    assert [leg.name for leg in problem.legs] == ["reach", "swing", "rest"]
    assert [leg.scene.payload for leg in problem.legs] == [50.0, 200.0, 50.0]
    assert [leg.scene.payload_at for leg in problem.legs] == [None, (-0.5, 0.0, 0.2), None]
    assert [leg.objective.name for leg in problem.legs] == ["work", "time", "time"]
    assert [[one.name for one in leg.obstacles] for leg in problem.legs] == [["rock"], ["rock", "spoil"], ["rock"]]
    assert (reach.tip_speed, swing.tip_speed, rest.wait) == (None, 0.5, 2.0)
    assert reach.start_q is not None
    assert swing.start_q is None


def test_a_scene_with_a_sequence_survives_a_round_trip() -> None:
    content = scene(REACH, {"name": "cut", "path": PATH, "speed": 0.2}, {"name": "rest", "wait": 1.0})
    assert scene_from_dict(scene_from_dict(content).to_dict()) == scene_from_dict(content)


def test_open_meshes_are_named_by_their_file(tmp_path: Path) -> None:
    """A cube without its front, on the site and carried; missing files are reported elsewhere."""
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = [(1, 2, 4, 3), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4), (5, 7, 8, 6)]
    for file, faces in (("crate.obj", sides[:-1]), ("block.obj", sides)):
        lines = [*("v {} {} {}".format(*at) for at in corners), *("f {} {} {} {}".format(*side) for side in faces)]
        (tmp_path / file).write_text("\n".join(lines))
    placed = {"shape": "mesh", "position": [0.0, 0.0, 0.0]}
    files = {"skip": "crate.obj", "block": "block.obj", "lost": "none.obj"}
    obstacles = [{"name": name, "file": file, **placed} for name, file in files.items()]
    load = {"name": "load", "file": "crate.obj", **placed}
    content = scene(REACH | {"carries": load}, obstacles=obstacles)
    assert scene_from_dict(content, folder=tmp_path).open_meshes() == {"crate.obj": ("skip", "load")}


def test_a_mesh_in_many_places_is_read_once_for_the_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3")
    read = []

    def is_open(mesh: Mesh, folder: Path) -> bool:
        read.append(mesh.name)
        return True

    monkeypatch.setattr(Mesh, "is_open", is_open)
    obstacles = [
        {"name": f"flap {x}", "shape": "mesh", "file": "flap.obj", "position": [5.0 + x, 0.0, 0.0]} for x in range(3)
    ]
    assert scene_from_dict(scene(REACH, obstacles=obstacles), folder=tmp_path).open_meshes() == {
        "flap.obj": ("flap 0", "flap 1", "flap 2")
    }
    assert read == ["flap 0"]
