"""Steps that keep a cone to first order."""

from __future__ import annotations

import numpy as np
import pytest
from cones import CONES, Data, keep_of, within

import backhoe_planner as bp
from backhoe_planner.planning.search.first_order import FirstOrder


@pytest.mark.parametrize("kept", CONES)
def test_a_step_along_the_edge_of_a_cone_leaves_it_unless_all_facets_are_kept(panda: bp.Robot, kept: Data) -> None:
    """Beyond the corners of the facets, the steps that keep these miss a cone by half of their square at most.

    The corners of an octagon are 1.083 radii from its middle, those of a cube 1.733.
    """
    keep = keep_of(panda, kept)
    rng, left = np.random.default_rng(1), 0
    for q in within(panda, keep, 20):
        step = 0.02 * rng.choice([-1.0, 1.0], panda.n)
        turned = FirstOrder.at(keep, q).kept_by(step)
        left += not keep.holds(q + step)
        corner = (1.083 if "tilt" in kept else 1.733) * 0.05
        bent = 0.5 * float(np.sum(np.abs(turned))) ** 2
        assert float(np.min(keep.margins(q + turned))) > 0.05 - corner - bent
    assert left > 5
