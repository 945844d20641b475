"""A second opinion on a job: every motion against the ground at its time, and the volumes.

The ground at each time follows from the motions alone. It is written as a height map, and the
motion is then checked by `independent_check` like any plan in a scene with that map.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from validation.independent_check import refutations

_SAME = 1e-9  # m^3


def job_refutations(plan: bp.JobPlan, *, refine: int = 4, cycles: slice = slice(None)) -> list[str]:
    """Describe what contradicts a job's plan; empty if nothing does.

    Parameters
    ----------
    refine: moments checked per sample.
    cycles: those that are checked.
    """
    found = volume_errors(plan)
    for cycle in plan.cycles[cycles]:
        for leg in cycle.legs:
            found += [f"cycle {cycle.number}, {leg.name}: {what}" for what in leg_refutations(plan, leg, refine=refine)]
    return found


def leg_refutations(plan: bp.JobPlan, leg: bp.CycleLeg, *, refine: int = 4) -> list[str]:
    """What contradicts the certificate of one motion."""
    with tempfile.TemporaryDirectory() as folder:
        scene = _scene_with_maps(plan, leg, Path(folder))
        asked: Any = SimpleNamespace(
            robot=leg.problem.robot, scene=scene, problem=leg.problem, trajectory=leg.trajectory,
            certificate=leg.certificate, verified=leg.certificate.verified,
        )  # fmt: skip
        return refutations(asked, refine=refine)


def volume_errors(plan: bp.JobPlan) -> list[str]:
    """Describe volumes that do not add up to within 1e-9 m^3."""
    found = []
    for cycle in plan.cycles:
        area = cycle.before.cell**2
        swell = cycle.before.swell
        gone = float((cycle.before.bank - cycle.dug.bank).sum()) * area
        loose = float((cycle.before.loose - cycle.dug.loose).sum()) * area
        if abs(gone - cycle.bank) > _SAME:
            found.append(f"cycle {cycle.number}: {cycle.bank} m^3 bank, the grid has {gone}")
        if abs(loose + swell * gone - cycle.held) > _SAME:
            found.append(f"cycle {cycle.number}: {cycle.held} m^3 held, the grid has lost {loose + swell * gone}")
        heaped = float((cycle.after.loose - cycle.dug.loose).sum()) * area
        if cycle.truck == 0 and abs(heaped - cycle.held) > _SAME:
            found.append(f"cycle {cycle.number}: {cycle.held} m^3 held, {heaped} heaped")
        if float(np.abs(cycle.after.bank - cycle.dug.bank).max()) > 0.0:
            found.append(f"cycle {cycle.number}: dumping changes the bank")
    return found


def _scene_with_maps(plan: bp.JobPlan, leg: bp.CycleLeg, folder: Path) -> bp.Scene:
    """The site with all its changing parts as height maps in `folder`."""
    content = plan.job.scene_dict()
    known = {one["name"] for one in content.get("obstacles", [])} | {zone["name"] for zone in content.get("zones", [])}
    maps: list[dict[str, Any]] = []
    for obstacle in leg.problem.obstacles:
        if obstacle.name in known:
            continue
        own: dict[str, Any] = {"name": obstacle.name, "clearance": obstacle.clearance}
        own |= {} if obstacle.links is None else {"links": list(obstacle.links)}
        if obstacle.cluster is None:  # added to the site by the job
            maps.append(obstacle.spec.model_dump(mode="json", exclude_unset=True) | own)
            continue
        solid: Any = obstacle.cluster.solid
        heights: Matrix = solid._heights
        file = folder / f"map{len(maps)}.csv"
        np.savetxt(file, heights, delimiter=",", fmt="%.12g")
        placement = obstacle.cluster.placement
        size = (solid.bounds[1] - solid.bounds[0])[:2].tolist()
        yaw = float(np.arctan2(placement.rotation[1, 0], placement.rotation[0, 0]))
        maps.append(
            {"shape": "heightmap", "file": file.name, "size": size, "position": placement.translation.tolist(),
             "rpy": [0.0, 0.0, yaw]} | own
        )  # fmt: skip
    joints = dict(zip(plan.robot.joint_names, leg.trajectory.q[0].tolist(), strict=True))
    obstacles = [*content.get("obstacles", []), *maps]
    return bp.scene_from_dict(
        content | {"obstacles": obstacles, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}},
        folder=folder,
    )
