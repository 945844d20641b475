"""One rule for the names of obstacles and zones, whatever their source."""

from __future__ import annotations

from typing import Any

import pytest

from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.live import Servo
from backhoe_planner.machine import Robot
from backhoe_planner.site import check_name, obstacle_from_dict, scene_from_dict

SECTOR = {"kind": "swing_sector", "name": "swing", "start": -1.0, "end": 1.0}
CEILING = {"kind": "ceiling", "name": "power line", "height": 9.0}
NOT_NAMES = [
    "",
    "   ",
    "\t\n",
    "self: boom",
    "the machine itself",
    "the machine itself (boom)",
    "the limit of joint boom",
]


def ball(name: str) -> dict[str, Any]:
    return {"name": name, "shape": "sphere", "radius": 0.1, "position": [0.0, 0.0, 30.0]}


def scene(**keys: Any) -> dict[str, Any]:
    joints = {"swing": 0.0, "boom": 0.3, "stick": -0.9, "bucket": -0.5}
    return {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": [4.0, 0.0, 0.0]}}, **keys}


@pytest.mark.parametrize("name", NOT_NAMES)
def test_words_that_reports_use_for_the_machine_are_refused_as_names(name: str, backhoe: Robot) -> None:
    """Plan files write ``self: LINK`` for a pair of the machine's own links."""
    with pytest.raises(InputError, match="name"):
        check_name(name)
    with pytest.raises(InputError, match="name"):
        obstacle_from_dict(ball(name))
    with pytest.raises(SceneError, match=r"obstacles.*name"):
        scene_from_dict(scene(obstacles=[ball(name)]))
    with pytest.raises(SceneError, match=r"zones.*name"):
        scene_from_dict(scene(zones=[{**CEILING, "name": name}]))
    servo = Servo(backhoe, scene_from_dict(scene()))
    with pytest.raises(InputError, match="name"):
        servo.add(ball(name))
    with pytest.raises(InputError, match="name"):
        servo.add_points(name, [[0.0, 0.0, 30.0]])
    assert servo.obstacles == ()


@pytest.mark.parametrize("name", ["selfie: x", "swing ", "self", "{0}", "<img src=x>", "Baugrube 3 – Süd", "x" * 500])
def test_other_words_are_valid_names(name: str) -> None:
    assert check_name(name, in_use={"swing": "a zone"}) == name


@pytest.mark.parametrize("name", [None, 3, b"ball", ["ball"]])
def test_a_name_must_be_a_string(name: Any) -> None:
    with pytest.raises(InputError, match="is no name"):
        check_name(name)


def test_the_message_about_a_name_in_use_says_what_has_it() -> None:
    with pytest.raises(InputError) as caught:
        check_name("swing", in_use={"pole": "an obstacle", "swing": "a zone of the scene"}, key="add")
    assert str(caught.value) == "add: is the name of a zone of the scene; found swing"


@pytest.mark.parametrize("zone", [SECTOR, CEILING], ids=["no solid", "a solid"])
def test_a_live_obstacle_cannot_have_the_name_of_a_zone(zone: dict[str, Any], backhoe: Robot) -> None:
    """A swing sector is not a solid, so that no obstacle of the servo has its name."""
    servo = Servo(backhoe, scene_from_dict(scene(zones=[zone])))
    there = servo.obstacles
    with pytest.raises(InputError, match="is the name of a zone"):
        servo.add(ball(zone["name"]))
    with pytest.raises(InputError, match="is the name of a zone"):
        servo.add({**ball(zone["name"]), "appears_at": 3.0})
    with pytest.raises(InputError, match="is the name of a zone"):
        servo.add_points(zone["name"], [[0.0, 0.0, 30.0]])
    assert servo.obstacles == there
    for name in there:
        servo.remove(name)
    with pytest.raises(InputError, match="is the name of a zone"):  # its scene still has the zone
        servo.add(ball(zone["name"]))


def test_a_removed_zone_can_be_added_again(backhoe: Robot) -> None:
    servo = Servo(backhoe, scene_from_dict(scene(zones=[CEILING])))
    (solid,) = servo.snapshot()
    servo.remove("power line")
    servo.add(solid)
    assert servo.obstacles == ("power line",)


@pytest.mark.parametrize("name", ["a\nverified", "red\x1b[31m", "\t"])
def test_a_name_must_be_one_printable_line(name: str) -> None:
    with pytest.raises(InputError, match="is no name"):
        check_name(name)
