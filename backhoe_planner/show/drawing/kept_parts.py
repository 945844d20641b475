"""What is to be kept in each part of a motion."""

from __future__ import annotations

import numpy as np

from backhoe_planner.motion import Condition
from backhoe_planner.planning import Plan


def kept_parts(plan: Plan) -> list[tuple[float, float, tuple[Condition, ...]]]:
    """When each part of the motion begins and ends [s], and what is to be kept in it; a part is a leg of a sequence."""
    if not plan.legs:
        keep = plan.problem.keep
        return [(0.0, np.inf, () if keep is None else keep.conditions)]
    ends = [*(leg.begins for leg in plan.legs[1:]), np.inf]
    return [
        (leg.begins, end, () if leg.problem.keep is None else leg.problem.keep.conditions)
        for leg, end in zip(plan.legs, ends, strict=True)
    ]
