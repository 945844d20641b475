"""How much work a plan may take: counted, so that it does not depend on the machine or its load.

Every search ends by a count, and the same input, seed and effort give the same plan. The
clock stands here alone: the `Brake` ends what runs away, and nothing else looks at it.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Literal

EffortName = Literal["quick", "normal", "thorough"]

# s: several times what plans take on one core, so that they end by their counts
DEFAULT_BUDGETS: Mapping[EffortName, float] = MappingProxyType({"quick": 60.0, "normal": 60.0, "thorough": 600.0})


@dataclass(frozen=True)
class Effort:
    """Upper bounds of the work of one plan.

    The counts of ``normal`` are about what one idle core does in 10 s to 20 s each; the
    rates are of the random sites of `scripts/bench_planning.py` on a 2 GHz core.

    Attributes
    ----------
    motions_per_search: motions between two configurations that one sampled search looks
        at (1,000 to 4,000 a second); half of it for a free detour, an eighth for one near the path.
    motions: the same of all searches of the plan: where the first fails, another has room.
    starting_points: of the inverse kinematics for one target (1,000 a second); what
        stands in collision is looked at with eight times as many before that is said.
    law_steps: steps of the completed law in all attempts of the plan (200 to 3,000 a second).
    sweeps: of the dynamic programming that makes a path cheaper, of the plan (30 to 80 a
        second); it converges in 20 to 220.
    routes: through the layered graph of which the motions are tested, of one resolution
        of a path (20 to 100 a second where a layer has some dozens of nodes).
    node_pairs: of the graph, from node to node, that these routes may look at, of one
        resolution (300 to 400 million a second): it bounds the routes through large layers.
    detours: off the path that are looked for in vain, of one resolution.
    nodes: that are drawn for a roadmap of ways (6,000 a second).
    boxes: of configurations, from which the bound of all motions to a goal follows (30,000 a second). They are
        looked at beside the search, which does not wait for them.
    descent_rounds: of all descents of the plan (20 to 50 a second); half of the descents take less than 7.
    way_rounds: more of them, once ways through roadmaps are brought down.
    pieces: of the curve that a descent bends; 20 instead of 12 gain 1 % and take twice as long.
    ways_at_once: straight lines to postures on a goal that are tried, and sampled ways of which the cheapest
        are brought down.
    dull_searches: how often in a row that may gain nothing before the search for better motions ends.
    begins_with: the effort of a search that comes first, so that more effort never costs more; empty for none.
    restarts: further searches for another cost than the time, each begun anew with the normal effort and random choices
        of its own.
    alike: so many searches that cost alike end them, one that costs little more than is lifted, and one that was
        short; 0 for none.
    restarts_round: further ones where the best motion leads round something, each of which goes on with what is known.
    restarts_long: further searches for the time, each begun anew with the normal effort, where the best motion takes
        much longer than the joints need, until one finds a shorter one than that.
    rough: whether a descent on a coarse curve ends at larger gains, for another cost than the time: a finer curve goes
        on from there, and mostly it costs no more at the end.
    """

    motions_per_search: int
    motions: int
    starting_points: int
    law_steps: int
    sweeps: int
    routes: int
    node_pairs: int
    detours: int
    nodes: int
    boxes: int
    descent_rounds: int
    way_rounds: int
    pieces: int
    ways_at_once: int
    dull_searches: int
    begins_with: EffortName | Literal[""]
    restarts: int
    alike: int
    restarts_round: int
    restarts_long: int
    rough: bool

    @property
    def is_hurried(self) -> bool:
        """Whether a search ends where it has found a motion."""
        return self.dull_searches == 0


_NORMAL = Effort(
    motions_per_search=12_000,
    motions=24_000,
    starting_points=48,
    law_steps=12_000,
    sweeps=600,
    routes=200,
    node_pairs=2_000_000_000,
    detours=24,
    nodes=1_200,
    boxes=4_000,
    descent_rounds=70,
    way_rounds=90,
    pieces=12,
    ways_at_once=3,
    dull_searches=1,
    begins_with="",
    restarts=3,
    alike=2,
    restarts_round=2,
    restarts_long=1,
    rough=True,
)


def _scaled(factor: float) -> Effort:
    """The counts of the normal effort times `factor`, and nothing rough."""
    counts = {name: count for name, count in asdict(_NORMAL).items() if not isinstance(count, bool | str)}
    return Effort(**{name: round(factor * count) for name, count in counts.items()}, begins_with="", rough=False)


EFFORTS: Mapping[EffortName, Effort] = MappingProxyType(
    {
        # inverse kinematics costs little and decides much: with a fifth of it goals count as out of reach
        "quick": replace(
            _scaled(0.2),
            motions_per_search=6_000,
            motions=12_000,
            starting_points=_NORMAL.starting_points,
            descent_rounds=6,
            way_rounds=0,
            pieces=8,
            ways_at_once=1,
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
            alike=0,
            restarts_round=0,
            restarts_long=2,
        ),
    }
)


class OutOfTime(Exception):  # noqa: N818 - an outcome inside the planner, not an error
    """The budget of computing time is used up; see `Brake`."""


class Brake:
    """Ends a search that takes too long: a budget of computing time, which begins when the brake is made.

    Only the thread in which the brake is made and checked counts: other programs do not
    use up the budget.

    Attributes
    ----------
    budget: computing time [s]; by default unlimited.
    """

    def __init__(self, budget: float = math.inf) -> None:
        self.budget = budget
        self._soonest = clock.monotonic() + budget  # no thread computes for longer than time goes by
        self._deadline = clock.thread_time() + budget

    @property
    def message(self) -> str:
        """What to say where the budget is used up."""
        return f"time ran out after {self.budget:g} s of computing; --budget gives more, a lower --effort needs less"

    def is_used_up(self) -> bool:
        """Whether no time is left: for what can end early and keep what it has."""
        # asking for the thread's own time takes up to 30 us, as often as it is asked here a fiftieth of a plan
        return clock.monotonic() > self._soonest and clock.thread_time() > self._deadline

    def check(self) -> None:
        """Go on only while there is time.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        if self.is_used_up():
            raise OutOfTime(self.message)


class Work:
    """What is left of the effort of one plan; its searches take from it.

    Attributes
    ----------
    effort: what there was at the beginning.
    brake: checked by every search.
    motions, law_steps, sweeps, descent_rounds, way_rounds: counts that are left; see `Effort`.
    """

    def __init__(self, effort: Effort = EFFORTS["normal"], brake: Brake | None = None) -> None:
        self.effort = effort
        self.brake = brake or Brake()
        self.motions = effort.motions
        self.law_steps = effort.law_steps
        self.sweeps = effort.sweeps
        self.descent_rounds = effort.descent_rounds
        self.way_rounds = effort.way_rounds
