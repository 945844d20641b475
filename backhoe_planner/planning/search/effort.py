"""How much work a plan may take: counted, so that it does not depend on the computer or its load.

Every search ends by a count, so the same input, seed and effort give the same plan. The clock
matters only here: the `Brake` ends a search that takes far too long.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Literal, get_args

from backhoe_planner.errors import InputError

EffortName = Literal["quick", "normal", "thorough"]
MoreRounds = Literal["way_rounds", "led_rounds", "hop_rounds"]

# s: several times what plans take on one core, so that plans end by their counts
DEFAULT_BUDGETS: Mapping[EffortName, float] = MappingProxyType({"quick": 60.0, "normal": 60.0, "thorough": 600.0})

# counts of one second, in the middle of the rates that `Effort` gives
_A_SECOND = {"motions": 2_000.0, "law_steps": 1_000.0, "sweeps": 50.0, "rounds": 35.0}


@dataclass(frozen=True)
class Effort:
    """Upper bounds of the work of one plan.

    Each count of ``normal`` is about what one idle core does in 10 s to 20 s; the
    rates were measured on the random sites of `scripts/bench_planning.py` on a 2 GHz core.

    Attributes
    ----------
    motions_per_search: motions between two configurations that one sampled search checks
        (1,000 to 4,000 a second); half as many for a free detour, an eighth for one near the path.
    motions: the same for all searches of the plan, so that another search is possible if the first fails.
    starting_points: of the inverse kinematics for one target (1,000 a second); before a target is
        reported to be in collision, eight times as many are tried.
    law_steps: steps of the completed law in all attempts of the plan (200 to 3,000 a second).
    sweeps: of the dynamic programming that makes a path cheaper, for the whole plan (30 to 80 a
        second); it converges in 20 to 220.
    other_ways: along a path that leaves several dimensions free, away from the first way; they are made cheaper too.
    routes: routes through the layered graph whose motions are tested, for one resolution
        of a path (20 to 100 a second if a layer has some dozens of nodes).
    node_pairs: pairs of nodes of the graph that the search for these routes may examine, for one
        resolution (300 to 400 million a second): it bounds the routes through large layers.
    detours: unsuccessful searches for a detour off the path, for one resolution.
    nodes: drawn for a roadmap (6,000 a second).
    boxes: of configurations, from which the bound for all motions to a goal follows (30,000 a second). They are
        examined apart from the search, which does not wait for them.
    descent_rounds: of all descents of the plan (20 to 50 a second); half of the descents take less than 7.
    way_rounds: additional rounds, for descents from routes through roadmaps.
    led_rounds: additional rounds for another cost than the time, for descents from a way around an obstacle that is led
        to other postures.
    hop_rounds: additional rounds for little work, for descents from beside the best motion.
    pieces: of the curve that a descent bends; 20 instead of 12 gain 1 % and take twice as long.
    ways_at_once: how many straight lines to postures on a goal are tried, and how many sampled routes, of which the
        cheapest start descents.
    dull_searches: how many searches in a row may gain nothing before the search for better motions ends.
    begins_with: the effort of a search that comes first, so that more effort never costs more; empty for none.
    restarts: further searches for another cost than the time, each begun anew with the normal effort and random choices
        of its own.
    frugal: whether searches for another cost than the time end where little more can be expected: restarts at a cost
        little above that of the lift, or once two agree. For little work, also restarts after one that gained little
        or after a short first search with few postures, starts that fall behind others, and refining that gains
        little, or more than one refinement at a little cost.
    restarts_round: further searches if the best motion goes around an obstacle, each of which continues from what is
        known; none for little work with a frugal effort.
    restarts_long: further searches for the time, each begun anew with the normal effort, if the best motion takes
        much longer than the joints need, until one finds a motion that does not.
    rough: whether a descent on a coarse curve ends at larger gains, for another cost than the time: a finer curve
        continues from there, and mostly costs no more at the end.
    """

    motions_per_search: int
    motions: int
    starting_points: int
    law_steps: int
    sweeps: int
    other_ways: int
    routes: int
    node_pairs: int
    detours: int
    nodes: int
    boxes: int
    descent_rounds: int
    way_rounds: int
    led_rounds: int
    hop_rounds: int
    pieces: int
    ways_at_once: int
    dull_searches: int
    begins_with: EffortName | Literal[""]
    restarts: int
    frugal: bool
    restarts_round: int
    restarts_long: int
    rough: bool

    @property
    def is_hurried(self) -> bool:
        """Whether a search ends as soon as it has found a motion."""
        return self.dull_searches == 0


_NORMAL = Effort(
    motions_per_search=12_000,
    motions=24_000,
    starting_points=48,
    law_steps=12_000,
    sweeps=600,
    other_ways=4,
    routes=200,
    node_pairs=2_000_000_000,
    detours=24,
    nodes=1_200,
    boxes=4_000,
    descent_rounds=70,
    way_rounds=90,
    led_rounds=90,
    hop_rounds=90,
    pieces=12,
    ways_at_once=3,
    dull_searches=1,
    begins_with="",
    restarts=3,
    frugal=True,
    restarts_round=1,
    restarts_long=1,
    rough=True,
)


def _scaled(factor: float) -> Effort:
    """The counts of the normal effort times `factor`, with no rough descents, and not frugal."""
    counts = {name: count for name, count in asdict(_NORMAL).items() if not isinstance(count, bool | str)}
    return Effort(
        **{name: round(factor * count) for name, count in counts.items()}, begins_with="", rough=False, frugal=False
    )


EFFORTS: Mapping[EffortName, Effort] = MappingProxyType(
    {
        # inverse kinematics costs little and decides much: with a fifth of it, goals within reach count as out of reach
        "quick": replace(
            _scaled(0.2),
            motions_per_search=6_000,
            motions=12_000,
            starting_points=_NORMAL.starting_points,
            descent_rounds=6,
            way_rounds=0,
            led_rounds=0,
            hop_rounds=0,
            pieces=8,
            ways_at_once=1,
            other_ways=0,
            dull_searches=0,
            restarts=0,
            restarts_round=0,
            restarts_long=0,
        ),
        "normal": _NORMAL,
        "thorough": replace(
            _scaled(4.0),
            descent_rounds=500,
            pieces=_NORMAL.pieces,
            ways_at_once=6,
            dull_searches=3,
            begins_with="normal",
            restarts=8,
            restarts_round=1,
            restarts_long=2,
        ),
    }
)


class OutOfTime(Exception):  # noqa: N818 - an outcome inside the planner, not an error
    """The budget of computing time is used up; see `Brake`."""


def check_effort(effort: str) -> EffortName:
    """The name of an effort.

    Raises
    ------
    InputError: there is none of that name.
    """
    found = next((known for known in EFFORTS if known == effort), None)
    if found is None:
        raise InputError.unknown_name("no such effort", effort, names=EFFORTS, key="effort")
    return found


class Brake:
    """Ends a search that takes too long: a budget of computing time that starts when the brake is created.

    Only the thread that creates and checks the brake counts: other programs do not
    use up the budget.

    Attributes
    ----------
    budget: computing time [s]; by default unlimited.

    It also adds up the counted work of all searches that it may end.
    """

    def __init__(self, budget: float = math.inf) -> None:
        self.budget = budget
        self._works: list[Work] = []
        self._soonest = clock.monotonic() + budget  # a thread's computing time never exceeds the elapsed time
        self._deadline = clock.thread_time() + budget

    @property
    def message(self) -> str:
        """The message for a budget that is used up."""
        return f"time ran out after {self.budget:g} s of computing"

    def with_advice(self, note: str) -> str:
        """A note of a plan; if it says that time ran out, with what to do about it, once."""
        return f"{note}; --budget gives more, and --effort quick needs least" if self.message in note else note

    @property
    def cut_short(self) -> str:
        """The message beside a motion that was found, if no time was left to look for a cheaper one; else empty."""
        return f"{self.message}; the search for a cheaper motion was not finished" if self.is_used_up() else ""

    def add(self, work: Work) -> None:
        """Count the work of one more search."""
        self._works.append(work)

    @property
    def done(self) -> float:
        """The counted work of all searches so far, as the time that one core takes for it about [s]."""
        return sum(work.done for work in self._works)

    def is_used_up(self) -> bool:
        """Whether no time is left: for searches that can end early and keep their result."""
        # reading the thread's own time takes up to 30 us; at every call this would add up to a fiftieth of a plan
        return clock.monotonic() > self._soonest and clock.thread_time() > self._deadline

    def check(self) -> None:
        """Raise an error if no time is left.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        if self.is_used_up():
            raise OutOfTime(self.message)


class Work:
    """The remaining effort of one plan; its searches subtract what they use.

    Attributes
    ----------
    effort: at the beginning.
    brake: checked by every search.
    motions, law_steps, sweeps, descent_rounds, way_rounds, led_rounds, hop_rounds: remaining counts; see `Effort`.
    """

    def __init__(self, effort: Effort = EFFORTS["normal"], brake: Brake | None = None) -> None:
        self.effort = effort
        self.brake = brake or Brake()
        self.motions = effort.motions
        self.law_steps = effort.law_steps
        self.sweeps = effort.sweeps
        self.descent_rounds = effort.descent_rounds
        self.way_rounds = effort.way_rounds
        self.led_rounds = effort.led_rounds
        self.hop_rounds = effort.hop_rounds
        self._withheld_steps = 0  # of the law: they were subtracted, but are not to be done
        self.brake.add(self)

    def add_rounds(self, more: MoreRounds) -> None:
        """Let descents use the additional rounds `more`, which are then no longer kept apart."""
        self.descent_rounds += getattr(self, more)
        setattr(self, more, 0)

    def leave_law_steps(self, most: int) -> None:
        """Leave at most so many steps of the law; those that are taken away do not count as done."""
        withheld = max(self.law_steps - most, 0)
        self.law_steps -= withheld
        self._withheld_steps += withheld

    @property
    def done(self) -> float:
        """What was subtracted so far, as the time that one core takes for it about [s]."""
        effort = self.effort
        rounds = ("descent_rounds", *get_args(MoreRounds))
        done: dict[str, float] = {
            "motions": effort.motions - self.motions,
            "law_steps": effort.law_steps - self.law_steps - self._withheld_steps,
            "sweeps": effort.sweeps - self.sweeps,
            "rounds": sum(getattr(effort, name) - getattr(self, name) for name in rounds),
        }
        return sum(count / _A_SECOND[name] for name, count in done.items())
