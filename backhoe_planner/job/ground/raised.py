"""Ground around the modelled one that a survey in the course of a job finds higher than before, such as a new heap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.job.ground.grids import HeightGrid, from_nearest
from backhoe_planner.job.ground.off_ground import OffGround, filling, voxels_of

_MANY = 500_000  # voxels, above which they are made larger; chosen: some seconds of planning
_COARSEST = 0.4  # m, edge from which on they are not; chosen


@dataclass(frozen=True, eq=False)
class Raised:
    """What was heaped beyond the modelled ground.

    Attributes
    ----------
    voxels: that fill all of it; None if nothing was.
    remark: how high and where, in words; empty if nothing was.
    """

    voxels: OffGround | None
    remark: str


NOT_RAISED = Raised(None, "")


def raised_beyond(
    found: HeightGrid, part: Sequence[slice], known: Matrix, around: HeightGrid | None, roughness: float
) -> Raised:  # fmt: skip
    """What a survey finds higher than before around the modelled ground.

    Parameters
    ----------
    found: heights by the survey, of the modelled ground and around it; NaN where it did not look.
    part: the rows and columns of the modelled ground in that.
    known: (rows, columns) the modelled ground before [m].
    around: the ground beyond it before; where that is unknown it goes on level.
    roughness: height up to which it counts as unchanged [m].
    """
    before = np.full(found.z.shape, np.nan) if around is None else around.at(found.nodes())
    before[tuple(part)] = known
    before = from_nearest(before, np.isnan(before))
    more = np.nan_to_num(found.z - before)
    more[tuple(part)] = 0.0
    raised = more > roughness
    if not raised.any():
        return NOT_RAISED
    highest = np.unravel_index(int(np.argmax(more)), more.shape)
    x, y = found.nodes()[highest].tolist()
    remark = (
        f"beyond the modelled ground it is up to {more[highest]:.2f} m higher than before, at x {x:.2f}, y {y:.2f}: "
        "an obstacle of voxels"
    )
    volume, edge = float(more[raised].sum()) * found.cell**2, found.cell
    while volume > _MANY * edge**3 and edge < _COARSEST:
        edge *= 2
    return Raised(voxels_of(filling(replace(found, z=before), found.z, raised, edge), edge), remark)
