"""The legs of a sequence, each as a scene of its own: its task, its load, and the obstacles present in it."""

from __future__ import annotations

from typing import Any

from backhoe_planner.errors import InputError, SceneError, check_kind
from backhoe_planner.machine import Robot
from backhoe_planner.site.scene_file import Scene
from backhoe_planner.site.schema.sequence import Leg


def leg_of(scene: Scene, index: int) -> Leg:
    """The leg with this index of a scene's sequence."""
    assert scene.task.sequence is not None
    return scene.task.sequence[index]


def leg_key(scene: Scene, index: int) -> str:
    """The key of a leg in the scene, for a message: ``task.sequence[1] (swing)``."""
    return f"task.sequence[{index}] ({leg_of(scene, index).name})"


def leg_scene(scene: Scene, index: int) -> Scene:
    """One leg as a scene of its own. It has a start only if it is the first.

    Parameters
    ----------
    scene: one whose task is a sequence.
    index: of the leg, from 0.
    """
    leg = leg_of(check_kind(scene, Scene, key="scene"), index)
    task = {"goal": leg.goal, "path": leg.followed_path, "keep": leg.keep, "max_duration": leg.max_duration}
    update: dict[str, Any] = {
        "task": scene.task.model_copy(update={"sequence": None} | {k: v for k, v in task.items() if v is not None}),
        "obstacles": tuple(one for one in scene.obstacles if one.legs is None or leg.name in one.legs),
    }
    for key in ("payload", "payload_at", "soil", "objective"):
        if getattr(leg, key) is not None:
            update[key] = getattr(leg, key)
    if index > 0:
        update["start"] = None
    return scene.model_copy(update=update)


def with_carried(robot: Robot, scene: Scene, index: int) -> Robot:
    """The machine with the load that it carries in a leg as part of its shape; unchanged if there is none.

    Raises
    ------
    SceneError: the load's file cannot be used, or a link has the load's name.
    """
    spec = leg_of(scene, index).carries
    if spec is None:
        return robot
    key = f"{leg_key(scene, index)}.carries"
    try:
        return robot.carrying(spec.name, spec.pieces(scene.folder))
    except InputError as error:
        raise SceneError(str(error), file=scene.file, key=key) from error
