"""The messages that a page may send to a driving session, and the joint rates that its joysticks command.

A message is one JSON object with a `type`. A message that cannot be understood changes nothing; the answer says in
a sentence why.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.numbers import number
from backhoe_planner.site.schema import obstacle_shapes

LARGEST = 16_384  # characters or bytes of a message; chosen, those of the page itself have a few hundred
_LONGEST_NAME = 60  # characters; chosen, so that a row of the panel can show it
_SMALLEST, _FARTHEST = 0.001, 1000.0  # m: sizes and coordinates of a new obstacle; chosen, others are mistakes
_FASTEST = 10.0  # m/s or rad/s; chosen, faster than any machine

_Part = Annotated[float, number(ge=-1.0, le=1.0)]
_Rate = Annotated[float, number(ge=-_FASTEST, le=_FASTEST)]
_Near = Annotated[float, number(ge=-_FARTHEST, le=_FARTHEST)]
_Name = Annotated[str, Field(strict=True, min_length=1, max_length=_LONGEST_NAME)]
_Number = Annotated[int, Field(strict=True, ge=0, le=2**53)]  # integers up to which JavaScript is exact
_Switch = Annotated[bool, Field(strict=True)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    id: _Number | None = None
    """Returned with the answer."""


class Take(_Message):
    """The page wants to drive."""

    type: Literal["take"]


class Release(_Message):
    """The driver releases the controls."""

    type: Literal["release"]


class HandOver(_Message):
    """The driver lets another page drive."""

    type: Literal["hand_over"]
    to: _Number
    """The other page's number."""


class Tip(_Message):
    """A wish for the motion of the tip. It holds until the next wish, or until the watchdog ends it."""

    type: Literal["tip"]
    velocity: tuple[_Rate, _Rate, _Rate]
    """Velocity [m/s]; in the arm's frame: outward, to the left, up."""
    frame: Literal["arm", "world"] = "arm"
    pitch_rate: _Rate | None = None
    """Rate of the pitch [rad/s]; if left out, pitch is free."""


class Sticks(_Message):
    """The deflections of two joysticks. They hold as long as a wish for the tip."""

    type: Literal["sticks"]
    pattern: Literal["iso", "sae"]
    left: tuple[_Part, _Part]
    """Left stick: to the right, and forward."""
    right: tuple[_Part, _Part]
    """Right stick: to the right, and forward."""
    speed: Annotated[float, number(ge=0.0, le=1.0)] = 1.0
    """Part of every joint's greatest rate at full deflection."""


def joint_rates(sticks: Sticks, velocity: Vector) -> Vector:
    """(n,) joint rates that an excavator's joysticks command [rad/s or m/s].

    In both patterns, moving the left stick sideways swings, and moving the right stick sideways turns the bucket
    (curl to the left, dump to the right). The patterns differ in which hand has the boom:

        ISO:  left stick forward and back: the stick;  right: the boom
        SAE:  left stick forward and back: the boom;   right: the stick

    In both, forward lowers the boom and extends the stick.

    Parameters
    ----------
    velocity: (n,) the joints' greatest rates [rad/s or m/s]. The first four joints are swing, boom, stick and
        bucket; further joints are not moved.
    """
    (left_x, left_y), (right_x, right_y) = sticks.left, sticks.right
    boom, stick = (right_y, left_y) if sticks.pattern == "iso" else (left_y, right_y)
    # positive joint rates raise the outer links: the boom rises when its joystick is pulled back
    roles = np.array([-left_x, -boom, stick, right_x])[: len(velocity)]
    parts = np.pad(roles, (0, len(velocity) - len(roles)))
    return np.asarray(sticks.speed * parts * velocity)


class Stop(_Message):
    """Stop now, within the acceleration limits."""

    type: Literal["stop"]


Droppable = Annotated[
    obstacle_shapes.Sphere | obstacle_shapes.Box | obstacle_shapes.Cylinder | obstacle_shapes.Capsule,
    Field(discriminator="shape"),
]  # no files, and nothing unbounded


class Add(_Message):
    """Add an obstacle."""

    type: Literal["add"]
    obstacle: Droppable


class Move(_Message):
    """Move an obstacle."""

    type: Literal["move"]
    name: _Name
    to: tuple[_Near, _Near, _Near]
    """Displacement from its first place [m], world."""


class Remove(_Message):
    """Take an obstacle away."""

    type: Literal["remove"]
    name: _Name


class PutBack(_Message):
    """Put back an obstacle of the scene that was taken away."""

    type: Literal["put_back"]
    name: Annotated[str, Field(strict=True, min_length=1)]


class Record(_Message):
    """Begin a recording, or bring the machine to rest and write the recording."""

    type: Literal["record"]
    on: _Switch


class Circulate(_Message):
    """Whether a tip that is pushed straight into an obstacle goes round it."""

    type: Literal["circulate"]
    on: _Switch


Message = Take | Release | HandOver | Tip | Sticks | Stop | Add | Move | Remove | PutBack | Record | Circulate
_MESSAGE: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def parse(text: str | bytes) -> Message:
    """The message that a page sent.

    Raises
    ------
    InputError: the text is too long, not JSON, or not one of the messages.
    """
    if len(text) > LARGEST:
        raise InputError("is too long", key="message", found=f"{len(text)} characters", allowed=f"up to {LARGEST}")
    try:
        message = _MESSAGE.validate_json(text)
    except ValidationError as error:
        raise InputError(_first(error), key="message") from None
    except ValueError as error:  # the text is not Unicode
        raise InputError(f"is not JSON: {type(error).__name__}", key="message") from None
    if isinstance(message, Add):
        _check(message.obstacle)
    return message


def _check(spec: Droppable) -> None:
    """Check what the types of the fields do not cover."""
    if len(spec.name) > _LONGEST_NAME:
        raise InputError("is too long", key="obstacle.name", allowed=f"up to {_LONGEST_NAME} characters")
    if any(spec.velocity) or spec.appears_at > 0.0:
        raise InputError("a new obstacle stands still and is there at once", key="obstacle")
    lengths = (
        [("size", edge) for edge in spec.size] if isinstance(spec, obstacle_shapes.Box) else [("radius", spec.radius)]
    )
    if isinstance(spec, obstacle_shapes.Cylinder):
        lengths.append(("length", spec.length))
    for key, value in lengths:
        if not _SMALLEST <= value <= _FARTHEST:
            allowed = f"{_SMALLEST:g} to {_FARTHEST:g} m"
            raise InputError("is not the size of an obstacle", key=f"obstacle.{key}", found=value, allowed=allowed)
    if max(abs(number) for key in spec.points for number in getattr(spec, key)) > _FARTHEST:
        raise InputError("is too far away", key="obstacle", allowed=f"up to {_FARTHEST:g} m")


def _first(error: ValidationError) -> str:
    """The first of pydantic's messages, short enough for a page."""
    detail = error.errors(include_url=False, include_context=False, include_input=False)[0]
    place = ".".join(str(part) for part in detail["loc"])[:200]
    problem = detail["msg"][0].lower() + detail["msg"][1:300]
    return f"{place}: {problem}" if place else problem
