"""Checks of a job before anything is planned; an error says what is wrong and what would be allowed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.errors import SceneError
from backhoe_planner.job.ground.obstacle import off_ground_obstacles
from backhoe_planner.job.ground.off_ground import OffGround
from backhoe_planner.job.worksite.lanes import Lane, passes_beside
from backhoe_planner.job.worksite.worksite import Worksite, fixed_corners
from backhoe_planner.motion import angles_in_degrees
from backhoe_planner.site import InTheWay, stands_in

_COLUMNS = 4  # least number of columns side by side under the blade; chosen: with fewer, half of them are edges

_ROUNDING = 1e-9  # of a column
_OTHER_HEIGHT = 2.0  # m of the ground from the machine's, beyond which this is said to be why; chosen, half its depth
_FAR = 0.25  # of the wanted depth: a bottom missed by more is far out of reach; chosen


def check_job(site: Worksite, lanes: Sequence[Lane], design: Matrix, allowed: Matrix) -> None:
    """Check a job against its machine and its ground.

    Parameters
    ----------
    design, allowed: (rows, columns) what is to be dug and what can be dug, see `allowed_heights` [m].

    Raises
    ------
    SceneError: names the key, what was found, and what is allowed.
    """
    _check_width(site)
    _check_cell(site)
    _check_design(site, design)
    _check_lanes(site, lanes)
    _check_any(site, lanes, design, allowed)
    _check_depth(site, lanes)


def check_start(site: Worksite) -> None:
    """Check the start of a job.

    Raises
    ------
    SceneError: the start is beyond a joint's limits.
    """
    q, limits = site.problem.start_q, site.problem.limits
    if q is None:
        return
    meant = angles_in_degrees(site.problem, q)
    for j in np.flatnonzero((q < limits.lower) | (q > limits.upper)).tolist():
        here, lower, upper = beside_bounds(q[j], limits.lower[j], limits.upper[j], places=".4g", bounds_as=".4g")
        raise SceneError(
            "is beyond the joint's limits", file=site.job.file, key=f"start.{site.robot.joint_names[j]}",
            found=here, allowed=f"{lower} to {upper}",
            hint=f"angles are in radians: {q[j]:.4g} degrees are {meant[j]:.4g}" if np.isfinite(meant[j]) else None,
        )  # fmt: skip


def check_place(site: Worksite) -> None:
    """Check that the machine does not stand in what the cloud of its ground contains.

    Raises
    ------
    SceneError: names the link and what stands there.
    """
    found = in_its_place(site)
    if found is not None:
        base = site.robot.base
        raise SceneError(
            f"puts {found.link} of the machine into {found.obstacle}", file=site.job.file, key="site.base",
            found=f"position {list(base.position)}, heading {base.heading:g}{_point_in_the_way(site)}",
            allowed="a place where no part of the machine that does not move overlaps what stands on the ground",
            hint="leave out the points of the machine itself; `backhoe-planner stand` finds a place",
        )  # fmt: skip


def in_its_place(site: Worksite) -> InTheWay | None:
    """The first part of the machine that does not move and overlaps what stands on the ground, or None."""
    return stands_in(site.robot, site.things)


def _point_in_the_way(site: Worksite) -> str:
    """A place where something stands in fixed parts of the machine, in words; empty if that takes several voxels."""
    stands, corners = site.ground.off_ground, fixed_corners(site.robot)
    assert stands is not None
    middle = stands.centres[:, :2]
    near = ((middle >= corners.min(axis=0)) & (middle <= corners.max(axis=0))).all(axis=1)
    for key in stands.keys[near]:
        voxel = OffGround(stands.edge, key[None])
        if stands_in(site.robot, off_ground_obstacles(voxel, 0.0)) is not None:
            x, y, z = voxel.centres[0].tolist()
            return f"; in its way at x {x:.2f}, y {y:.2f}, z {z:.2f} m"
    return ""


def _check_width(site: Worksite) -> None:
    trench, width = site.job.dig.trench, site.bucket.width
    if trench is not None and width > trench.width + 2.0 * trench.tolerance:
        bounds = (width, width - 2.0 * trench.tolerance)
        _, whole, least = beside_bounds(trench.width, *bounds, places=".6g", bounds_as=".2f")
        raise SceneError(
            "the bucket is wider than the trench", file=site.job.file, key="dig.trench.width", found=trench.width,
            allowed=f"{whole} m, the bucket's width, or more (less by up to twice the tolerance, {least} m)",
            hint="a narrower bucket, or a wider trench",
        )  # fmt: skip


def _check_cell(site: Worksite) -> None:
    trench, cell = site.job.dig.trench, site.ground.cell
    width = site.bucket.width if trench is None else min(site.bucket.width, trench.width)
    if cell > width / _COLUMNS:
        most = beside_bounds(cell, width / _COLUMNS, places=".6g", bounds_as=".2f")[1]
        raise SceneError(
            "is too coarse for what is dug", file=site.job.file, key="ground.cell", found=cell,
            allowed=f"up to {most} m: {_COLUMNS} columns side by side under the blade",
        )  # fmt: skip


def _check_design(site: Worksite, design: Matrix) -> None:
    ground, job = site.ground, site.job
    key = "dig.trench" if job.dig.trench is not None else "dig.surface"
    known = np.isfinite(design)
    if not (site.share > 1.0 - _ROUNDING).any():
        raise SceneError(
            "no column of the ground is wholly inside the area to be dug", file=job.file, key=key,
            hint="the area is outside the job's ground, or narrower than a column: see ground.cell",
        )  # fmt: skip
    above = np.where(known, design - ground.surface, -np.inf)
    if not (above < 0.0)[known].any() or float(above.max()) > job.dig.tolerance:
        row, column = np.unravel_index(int(np.argmax(above)), above.shape)
        x, y = site.nodes[row, column]
        raise SceneError(
            "the design lies above the ground", file=job.file, key=key,
            found=f"{float(above.max()):.2f} m above it at x {x:.2f}, y {y:.2f} m",
            allowed="a design at or below the ground: a job takes soil away and builds nothing up",
        )  # fmt: skip


def _check_lanes(site: Worksite, lanes: Sequence[Lane]) -> None:
    job, plane, trench = site.job, site.plane, site.job.dig.trench
    key = "dig.trench" if trench is not None else "dig.surface"
    if not lanes:
        hint = "the arm digs in the plane that it swings to: place the machine in line with what is dug"
        raise SceneError(
            "no plane of the arm has room for the bucket in what is to be dug", file=job.file, key=key,
            found=_beside(site) if trench is not None else None, hint=hint,
        )  # fmt: skip
    limits = plane.limits
    within = [lane for lane in lanes if not plane.swings or limits.lower[0] <= lane.swing <= limits.upper[0]]
    if not within:
        degrees = np.degrees([lanes[0].swing, limits.lower[0], limits.upper[0]]).tolist()
        swing, lower, upper = beside_bounds(*degrees, places=".0f", bounds_as=".0f")
        raise SceneError(
            "is out of reach: the machine does not swing so far", file=job.file, key=key,
            found=f"a swing of {swing} degrees", allowed=f"{lower} to {upper} degrees",
            hint="turn the machine",
        )  # fmt: skip
    if trench is not None:
        _check_reach(site, within)


def _check_depth(site: Worksite, lanes: Sequence[Lane]) -> None:
    """Refuse a bottom that the teeth reach nowhere, or come close to nowhere that is unprotected."""
    missing = []
    for lane in lanes:
        asked = np.isfinite(lane.design)
        is_protected = np.array([kind == "protected" for kind, _ in lane.causes])[lane.cause[asked]]
        gap = (lane.floor - lane.design)[asked]
        # next to a protected object, the soil that is left may hold up boom and stick
        depth = float(np.max(site.ground.surface)) - lane.design[asked]
        most = np.where(is_protected.any(), _FAR * depth, site.job.dig.tolerance)
        if is_protected.all() or (gap <= most)[~is_protected].any():
            return
        missing.append(float(np.min(gap[~is_protected])))
    trench, least = site.job.dig.trench, min(missing)
    found = f"its teeth stay {least:.2f} m above it everywhere"
    raise SceneError(
        "is deeper than the machine digs there", file=site.job.file,
        key="dig.trench.depth" if trench is not None else "dig.surface",
        found=f"{trench.depth:g} m below the ground at `from`" if trench is not None else found,
        allowed=f"about {trench.depth - least:.2f} m where the teeth reach deepest" if trench is not None else None,
        hint=_move_what_protects(lanes) or "stand nearer, or dig less deep",
    )  # fmt: skip


def _check_any(site: Worksite, lanes: Sequence[Lane], design: Matrix, allowed: Matrix) -> None:
    """Refuse a job that has soil to dig if none of it can be dug."""
    ground, tolerance = site.ground.surface, site.job.dig.tolerance
    known, wanted = np.isfinite(design), ground - design > tolerance
    # if a part is dug already, the rest may be what stays
    if not wanted[known].all() or (ground - allowed > tolerance)[wanted].any():
        return
    raise SceneError(
        "cannot be dug anywhere", file=site.job.file,
        key="dig.trench" if site.job.dig.trench is not None else "dig.surface", found=_causes(lanes) or "out of reach",
        hint="obstacles stay undug, with their clearance: move them or the dig; or place the machine elsewhere, as the "
        "teeth go in and come out along slopes, which needs length",
    )  # fmt: skip


def _beside(site: Worksite) -> str:
    trench = site.job.dig.trench
    assert trench is not None
    return f"a trench whose middle passes {passes_beside(site, trench):.2f} m beside the swing axis"


def _check_reach(site: Worksite, lanes: Sequence[Lane]) -> None:
    """Refuse a trench that cannot be dug at all, or not over its whole length."""
    trench, job = site.job.dig.trench, site.job
    assert trench is not None
    reached = np.concatenate(
        [lane.r[np.isfinite(lane.design) & (lane.line < lane.floor.max() - 0.05)] for lane in lanes]
    )
    lane = lanes[0]
    asked = lane.r[np.isfinite(lane.design)]
    out = asked[(lane.cause[np.isfinite(lane.design)] > 0) & _is_out(lane)[np.isfinite(lane.design)]]
    if len(reached) == 0:
        raise SceneError(
            "cannot be dug anywhere", file=job.file, key="dig.trench",
            found=_causes(lanes[:1]) or "out of reach", hint=_move_what_protects(lanes[:1]) or _from_where(site, asked),
        )  # fmt: skip
    beyond = out[(out > reached.max()) | (out < reached.min())]
    if len(beyond) and float(np.ptp(beyond)) > 0.1:
        a, b = (_place(site, lane, float(r)) for r in (beyond.min(), beyond.max()))
        raise SceneError(
            "is out of reach in part", file=job.file, key="dig.trench",
            found=f"from x {a[0]:.2f}, y {a[1]:.2f} to x {b[0]:.2f}, y {b[1]:.2f} m",
            allowed=f"{reached.min():.2f} to {reached.max():.2f} m from the swing axis at this depth",
            hint=_from_where(site, asked),
        )  # fmt: skip


def _causes(lanes: Sequence[Lane]) -> str:
    """What holds the teeth up in some lanes, in words; empty if nothing does."""
    kinds = sorted({lane.causes[int(index)] for lane in lanes for index in lane.cause if index > 0})
    return "; ".join(f"{kind.replace('_', ' ')}{': ' + name if name else ''}" for kind, name in kinds)


def _move_what_protects(lanes: Sequence[Lane]) -> str:
    """The advice to move what must not be touched and holds the teeth up in some lanes; empty if nothing does."""
    kinds = {lane.causes[int(index)] for lane in lanes for index in lane.cause if index > 0}
    names = ", ".join(sorted(name for kind, name in kinds if kind == "protected"))
    return f"the teeth must not touch {names}: move it, or reduce its clearance; or stand elsewhere" if names else ""


def _is_out(lane: Lane) -> Flags:
    kinds = np.array([kind == "out_of_reach" for kind, _ in lane.causes])
    return np.asarray(kinds[lane.cause])


def _place(site: Worksite, lane: Lane, r: float) -> Vector:
    return np.asarray(site.plane.world(lane.swing, np.array([r]), np.zeros(1))[0, :2])


def _from_where(site: Worksite, asked: Vector) -> str:
    trench, given = site.job.dig.trench, site.job.ground
    assert trench is not None
    height = float(np.mean(site.ground.height_at(np.array([trench.start, trench.end]))))
    if abs(height) > _OTHER_HEIGHT:
        key = "level" if given.file is None else "map_origin" if given.map_origin is not None else "file"
        side = "above" if height > 0.0 else "below"
        return f"the ground there is {abs(height):.2f} m {side} the machine, which stands at z = 0: see ground.{key}"
    return (
        f"the trench lies {asked.min():.2f} to {asked.max():.2f} m from the swing axis: stand nearer or farther on its "
        "line, or dig it from two places"
    )
