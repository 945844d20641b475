"""A job whose place, start, cuts and dump were checked: what estimates and plans begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import SceneError
from backhoe_planner.job.cycles.dump_checks import check_dump, check_truck
from backhoe_planner.job.cycles.dumping import DumpSite, dump_of, ground_obstacles
from backhoe_planner.job.ground.obstacle import is_below_swung
from backhoe_planner.job.worksite.checks import check_job, check_place, check_start
from backhoe_planner.job.worksite.lanes import Lane, allowed_heights, lanes_of
from backhoe_planner.job.worksite.worksite import Worksite, some_posture
from backhoe_planner.site import Obstacle, Proximity


@dataclass(frozen=True, eq=False)
class CheckedJob:
    """What is dug in a job, and where it goes.

    Attributes
    ----------
    site: where it is done.
    lanes: in which the bucket digs.
    design: (rows, columns) heights of the design [m].
    allowed: (rows, columns) heights down to which the lanes reach [m], see `allowed_heights`.
    lane_of: (rows, columns) the index of the lane that reaches so far, or -1.
    dump: a heap or trucks.
    grounds: the ground before the first cycle as obstacles, see `ground_obstacles`.
    """

    site: Worksite
    lanes: tuple[Lane, ...]
    design: Matrix
    allowed: Matrix
    lane_of: NDArray[np.int64]
    dump: DumpSite
    grounds: tuple[Obstacle, ...]


def check_whole_job(site: Worksite) -> CheckedJob:
    """Check a job before anything is planned.

    Raises
    ------
    SceneError: names the key, what was found, and what is allowed.
    """
    check_start(site)
    check_place(site)
    check_truck(site)
    grounds = ground_obstacles(site, site.ground)
    _check_swung(site, grounds)
    lanes, design = lanes_of(site), site.design_heights()
    allowed, lane_of = allowed_heights(site, lanes, design)
    check_job(site, lanes, design, allowed)
    check_dump(site, allowed)
    return CheckedJob(site, lanes, design, allowed, lane_of, dump_of(site), grounds)


def _check_swung(site: Worksite, grounds: Sequence[Obstacle]) -> None:
    """Check that links that only swing are not in the ground, `grounds` or that around them, at the start.

    Without a start they are checked in some posture.
    """
    below = [one for one in (*site.problem.obstacles, *grounds) if is_below_swung(one)]
    q = some_posture(site.robot) if site.problem.start_q is None else site.problem.start_q
    contact = Proximity(site.robot, below).tightest(q) if below else None
    if contact is None or contact.margin >= 0.0:
        return
    from_file = site.job.ground.file is not None
    raise SceneError(
        f"puts the ground into {contact.link} of the machine", file=site.job.file,
        key="ground.file" if from_file else "ground.level", found=f"ground {-contact.distance:.2f} m inside it",
        allowed=f"ground below {contact.link}, which need not keep the clearance from it but must not touch it",
        hint="the machine stands at z = 0, which is the last number of ground.map_origin in the file"
        if from_file
        else "the machine stands at z = 0",
    )  # fmt: skip
