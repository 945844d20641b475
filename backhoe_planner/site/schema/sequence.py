"""The task of a scene: a goal, a path, or a sequence of legs done one after the other."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from backhoe_planner.files.records import Record, exactly_one
from backhoe_planner.site.schema.digging import Soil
from backhoe_planner.site.schema.names import Name, check_name
from backhoe_planner.site.schema.obstacle_shapes import ObstacleSpec, shape_records
from backhoe_planner.site.schema.quantities import NonNegative, Positive, Vector3
from backhoe_planner.site.schema.tasks import SLOWEST, Goal, Goals, JointsGoal, Keep, PathTask, TiltRange

ObjectiveName = Literal["velocity_norm", "kinetic", "effort", "work", "hydraulic", "time"]

_WIDE_TILT = 1.0  # tolerance of a tilt that is rather meant in degrees: no cup or fork is level at 57 deg [rad]
_WIDE_TOLERANCE = 1.0  # tolerance of a position that is rather meant in millimetres; chosen [m]
_NOT_CARRIED = ("appears_at", "velocity", "links", "legs", "clearance")  # keys that only an obstacle on the site has


def wide_tilt(key: str, tilt: TiltRange | None) -> tuple[str, ...]:
    """A tilt so wide that its tolerance may be meant in degrees, in words."""
    if tilt is None or (given := tilt.tolerance) < _WIDE_TILT:
        return ()
    words = f"{given:g} rad are {math.degrees(given):.1f} deg; {given:g} degrees are {math.radians(given):.4g} rad"
    return (f"{key}.tolerance: {words}",)


def _wide_tolerance(key: str, given: float | None) -> tuple[str, ...]:
    """A tolerance of a position so wide that it may be meant in millimetres, in words."""
    if given is None or given < _WIDE_TOLERANCE:
        return ()
    return (f"{key}.tolerance: {given:g} m are wide; {given:g} mm are {1e-3 * given:.4g} m",)


def _some_goal(goal: Any) -> Any:
    if goal == ():
        raise ValueError("a list of goals holds at least one; found []")
    return goal


def _listed(goal: Goals | None) -> tuple[Goal | JointsGoal, ...]:
    if goal is None:
        return ()
    return goal if isinstance(goal, tuple) else (goal,)


def _kept(goals: tuple[Goal | JointsGoal, ...], beside: Keep | None) -> Keep | None:
    """The conditions to keep on the way to any of `goals`, given `beside` them or in the only one.

    Raises
    ------
    ValueError: they are given twice, or in one of several goals: on the way it is not known which is reached.
    """
    for index, goal in enumerate(goals):
        if goal.keep is not None and len(goals) > 1:
            raise ValueError(f"goal[{index}].keep: of several goals any will do; give keep once, beside the list")
        if goal.keep is not None and beside is not None:
            raise ValueError("keep is given twice, beside the goal and in it")
    return next((goal.keep for goal in goals if goal.keep is not None), beside)


def _check_max_duration(asked: float | None, goals: tuple[Goal | JointsGoal, ...]) -> None:
    if asked is not None and not goals:
        raise ValueError("max_duration needs a goal; a path has a speed, and a wait a time of its own")


class Leg(Record):
    """One part of a sequence: exactly one of goal, path, wait. It begins where the previous leg ends."""

    name: Name
    """Unique within the sequence; appears in reports and on the page."""
    goal: Goals | None = None
    """A pose of the tip, or the joints; or a list of such goals, any of which is enough."""
    path: PathTask | None = None
    """A path that the tip follows; the motion to its beginning is part of the leg."""
    wait: Positive | None = None
    """How long the machine stands still [s]."""
    keep: Keep | None = None
    """Conditions that hold along the whole leg."""
    payload: NonNegative | None = None
    """Mass in the bucket during the leg [kg]; the scene's by default."""
    payload_at: Vector3 | None = None
    """Centre of that mass from the tip, in the tip's axes [m]; the scene's by default."""
    soil: Soil | None = None
    """The soil that the bucket digs in during the leg; the scene's by default."""
    objective: ObjectiveName | None = None
    """What the leg minimises; the scene's by default, or else the time to a goal and the work along a path."""
    speed: Positive | None = None
    """Greatest speed of the tip [m/s]: along a path like its own `speed`, and on the whole motion to a goal."""
    max_duration: Positive | None = None
    """Longest time that the motion to a goal may take [s]."""
    carries: ObstacleSpec | None = None
    """A load hanging from the tip or in the bucket, in the tip's frame: part of the machine's shape in this leg."""

    _one = exactly_one("goal", "path", "wait")
    _check_goal = field_validator("goal")(_some_goal)

    @model_validator(mode="after")
    def _consistent(self) -> Leg:
        _kept(self.goals, self.keep)
        if self.wait is not None:
            given = [key for key in ("keep", "objective", "speed") if getattr(self, key) is not None]
            if given:
                raise ValueError(f"a wait has no {' and no '.join(given)}: the machine stands")
        _check_max_duration(self.max_duration, self.goals)
        if self.speed is not None and self.speed < SLOWEST:
            raise ValueError(f"a speed of {self.speed:.3g} m/s is slower than 0.1 mm/s")
        if self.path is not None and self.speed is not None and self.path.speed is not None:
            raise ValueError(
                f"speed is given twice, as {self.speed:g} for the leg and as {self.path.speed:g} for its path"
            )
        if self.carries is not None:
            if self.carries.is_land:
                allowed = ", ".join(sorted(name for name, record in shape_records().items() if not record.is_land))
                raise ValueError(f"carries: a {self.carries.shape} cannot be carried; allowed shapes: {allowed}")
            wrong = [key for key in _NOT_CARRIED if key in self.carries.model_fields_set]
            if wrong:
                raise ValueError(f"carries: {wrong[0]} applies only to obstacles on the site; leave it out")
        return self

    @property
    def goals(self) -> tuple[Goal | JointsGoal, ...]:
        """All goals, of which any is enough; none for a path or a wait."""
        return _listed(self.goal)

    @property
    def kept(self) -> Keep | None:
        """The conditions along the whole leg, given beside the goal or in it."""
        return _kept(self.goals, self.keep)

    @property
    def followed_path(self) -> PathTask | None:
        """The path, with the leg's speed if it has one."""
        if self.path is None or self.speed is None:
            return self.path
        return self.path.model_copy(update={"speed": self.speed})


class Task(Record):
    """The task: exactly one of goal, path, sequence."""

    goal: Goals | None = None
    """A pose of the tip, or the joints; or a list of such goals, any of which is enough."""
    path: PathTask | None = None
    sequence: Annotated[tuple[Leg, ...], Field(min_length=1)] | None = None
    """Legs, done one after the other."""
    keep: Keep | None = None
    """Conditions that hold along the whole motion to a goal, or to a path and along it."""
    max_duration: Positive | None = None
    """Longest time that the motion to a goal may take [s]."""

    _one = exactly_one("goal", "path", "sequence")
    _check_goal = field_validator("goal")(_some_goal)

    @model_validator(mode="after")
    def _legs(self) -> Task:
        _kept(self.goals, self.keep)
        legs = self.sequence
        if legs is None:
            _check_max_duration(self.max_duration, self.goals)
            return self
        for key in ("keep", "max_duration"):
            if getattr(self, key) is not None:
                raise ValueError(f"{key} is given beside a sequence; give it to the legs in which it holds")
        in_use: dict[str, str] = {}
        for index, leg in enumerate(legs):
            check_name(leg.name, in_use=in_use, key=f"sequence[{index}].name")
            in_use[leg.name] = f"sequence[{index}]"
        if all(leg.wait is not None for leg in legs):
            raise ValueError("the sequence does nothing but wait; at least one leg has a goal or a path")
        return self

    @property
    def goals(self) -> tuple[Goal | JointsGoal, ...]:
        """All goals, of which any is enough; none if a path or a sequence is given."""
        return _listed(self.goal)

    @property
    def kept(self) -> Keep | None:
        """The conditions along the whole motion, given beside the goal or in it."""
        return _kept(self.goals, self.keep)

    def warnings(self) -> tuple[str, ...]:
        """Tolerances so wide that they may be meant in degrees, of tilts, or in millimetres, in words."""
        parts: list[tuple[str, Task | Leg]] = [("task", self)]
        parts += [(f"task.sequence[{index}]", leg) for index, leg in enumerate(self.sequence or ())]
        found: list[str] = []
        for where, part in parts:
            tilts = [("keep.tilt", None if part.kept is None else part.kept.tilt)]
            tilts += [("goal.tilt", goal.tilt) for goal in part.goals if isinstance(goal, Goal)]
            found += [warning for key, tilt in tilts for warning in wide_tilt(f"{where}.{key}", tilt)]
            wide = [("goal", goal.tolerance) for goal in part.goals if isinstance(goal, Goal)]
            wide += [] if part.path is None else [("path", part.path.tolerance)]
            found += [warning for key, given in wide for warning in _wide_tolerance(f"{where}.{key}", given)]
        return tuple(dict.fromkeys(found))

    @property
    def leg_names(self) -> tuple[str, ...]:
        """Names of the legs of the sequence; none if a goal or a path is given."""
        return tuple(leg.name for leg in self.sequence or ())
