"""A cut as a motion: down from above the surrounding ground, through the soil, and up again with the bucket level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job.cuts.attitude import back_heights
from backhoe_planner.job.cuts.cut import Cut, CutGround
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.job.ground.sweep import BladeSweep, Sweep, swept
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Digging, Load
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.motion import Problem, Trajectory, time_along

_STEP = 0.05  # m between places of the edge above the ground; chosen
_PITCHES = 200  # tried for a place above the ground, 0.9 degrees apart; chosen
_BEHIND = 0.6  # m, the most by which the level bucket reaches below its teeth; 0.46 was measured on models/backhoe.urdf
_SPARE = 0.06  # m beyond the clearance at both ends of a cut; chosen
# part of a profile's depth by which its columns may differ from it even if the whole blade is in the same ground, and
# the least depth [m] that counts: a cut is up to a tenth deeper by its columns; chosen
_SEEN, _SHALLOW = 0.15, 0.05
_AROUND = 0.5  # m to each side and beyond the bucket in which the ground counts at both ends; chosen


@dataclass(frozen=True, eq=False)
class CutPath:
    """The joints of a whole cut.

    Attributes
    ----------
    q: (M, n) joints, from above the ground to above the ground.
    first, last: indices between which it is the cut's own path.
    """

    q: Matrix
    first: int
    last: int


def cut_path(site: Worksite, cut: Cut, ground: Terrain, *, higher: float = 0.0) -> CutPath | str:
    """The joints of a cut with the paths down to it and up from it; or the reason why there are none.

    Parameters
    ----------
    ground: the ground before the cut.
    higher: additional height to which the bucket is lifted at both ends [m].
    """
    spare = site.problem.scene.clearance + _SPARE + higher
    lift = cut.begin[3]
    down = _down(site, cut, _top(site, cut, ground, float(cut.r[0])) + spare)
    if down is None:
        return f"the teeth cannot come down at r {cut.r[0]:.2f} m"
    up = _up(site, cut, lift, _top(site, cut, ground, float(cut.r[lift])) + _BEHIND + spare)
    if up is None:
        return f"the bucket cannot be lifted level at r {cut.r[lift]:.2f} m"
    q = np.vstack((down, cut.q[: lift + 1], up))
    return CutPath(q, len(down), len(down) + lift)


def cut_motion(site: Worksite, cut: Cut, path: CutPath, *, pace: float) -> Trajectory:
    """The fastest motion along a cut.

    Parameters
    ----------
    pace: greatest part of the joint rates that the motion uses.
    """
    limits = site.problem.limits
    if pace < 1.0:
        limits = replace(limits, velocity=pace * limits.velocity, acceleration=pace**2 * limits.acceleration)
    tips = site.plane.kinematics.at(path.q).tip_position
    stations = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))))
    return time_along(stations, path.q, limits, drive=site.digger.drive(cut))


def blade_of(site: Worksite, edge: Matrix, swing: float) -> BladeSweep:
    """The bucket's edge along a path (K, 3) [m] of its middle, world, in the arm's plane at a swing angle [rad]."""
    return BladeSweep(edge, np.append(site.plane.directions(swing)[1], 0.0), site.bucket.width)


def dig(
    site: Worksite, motion: Trajectory, swing: float, ground: Terrain, *, slump: bool = False
) -> tuple[Digging, Sweep]:  # fmt: skip
    """The soil that a motion in the arm's plane at a swing angle [rad] takes out of the present ground; see `swept`."""
    blade = blade_of(site, site.plane.kinematics.at(motion.q).tip_position, swing)
    sweep = swept(ground, blade, slump=slump)
    return Digging(motion.time, blade.edge, blade.across[0], blade.width, sweep.bank, sweep.loose), sweep


def load_of(site: Worksite, swing: float, digging: Digging) -> Load:
    """The load of the bucket along a cut in the arm's plane at a swing angle [rad]."""
    volume = np.minimum(site.job.soil.swell * digging.bank + digging.loose, site.bucket.capacity)
    inward = np.minimum.accumulate(_radii(site, swing, digging))
    return Load(swing, inward, site.digger.soil.density / site.job.soil.swell * volume)


def cut_problem(site: Worksite, load: Load, digging: Digging, problem: Problem, ground: Terrain) -> Problem:
    """The problem of a motion through the soil.

    Parameters
    ----------
    load: the load of the bucket along the cut.
    digging: the soil that the motion takes out of the ground.
    problem: the problem of the same motion through the air.
    ground: the ground before the cut.
    """
    profile = Profile.of_terrain(ground, site.plane, load.swing, width=site.bucket.width)
    in_plane = CutGround(
        profile, site.plane.axis, site.plane.directions(load.swing)[0], load.r, load.mass, site.bucket,
        _beside(profile, _radii(site, load.swing, digging), digging, cell=ground.cell),
    )  # fmt: skip
    return replace(problem, scene=problem.scene.model_copy(update={"soil": site.digger.soil}), ground=in_plane)


def _radii(site: Worksite, swing: float, digging: Digging) -> Vector:
    """(K,) distances of the edge from the swing axis [m]."""
    return np.asarray((digging.edge[:, :2] - site.plane.axis) @ site.plane.directions(swing)[0])


def _beside(profile: Profile, r: Vector, digging: Digging, *, cell: float) -> Vector:
    """(K,) mean depth that the blade sweeps in addition to that of the profile, at the profile's radii [m].

    The profile leaves out the columns at the ends of the blade, which it covers in part. Along a standing wall most of
    the soil is in these columns.

    Parameters
    ----------
    r: (M,) radii of the edge [m].
    cell: cell of the ground [m].
    """
    inward = np.minimum.accumulate(r)
    area = (digging.bank + digging.loose) / digging.width
    own = np.add(*profile.taken(inward, digging.edge[:, 2], width=1.0))
    # columns are taken all at once when the edge passes their middle: use the mean over two of them

    def over(total: Vector) -> Vector:
        ends = [np.interp(profile.r + off, inward[::-1], total[::-1]) for off in (-cell, cell)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * cell))

    said = over(own)
    more = over(area) - said
    return np.where(more > _SEEN * np.maximum(said, _SHALLOW), more, 0.0)


def _top(site: Worksite, cut: Cut, ground: Terrain, r: float) -> float:
    """The highest ground around the bucket while its teeth are at radius `r` [m]."""
    radii = np.arange(r - site.bucket.length - _AROUND, r + site.bucket.length + _AROUND, ground.cell)
    middle = site.plane.world(cut.swing, radii, np.zeros(len(radii)))[:, :2]
    sides = np.arange(-0.5 * cut.bucket.width - _AROUND, 0.5 * cut.bucket.width + _AROUND, ground.cell)
    place = (middle[:, None, :] + sides[:, None] * cut.across[:2] - ground.low) / ground.cell
    last = np.array(ground.bank.shape[::-1]) - 1
    column, row = np.moveaxis(np.clip(np.round(place).astype(int), 0, last), -1, 0)
    return float(ground.surface[row, column].max())


def _down(site: Worksite, cut: Cut, top: float) -> Matrix | None:
    """(M, n) from `top` [m] down to the beginning of the cut, without that; empty if the cut begins there."""
    r, z, pitch = float(cut.r[0]), float(cut.z[0]), float(cut.pitch[0])
    if top <= z + 1e-3:
        return np.zeros((0, site.robot.n))
    heights = np.linspace(top, z, int(np.ceil((top - z) / _STEP)) + 1)
    found = site.plane.joints(cut.swing, np.full(len(heights), r), heights, np.full(len(heights), pitch))
    if np.isnan(found).any():
        found = site.plane.joints(cut.swing, np.full(len(heights), r), heights, _nearest_pitches(site, cut, r, heights))
    return None if np.isnan(found).any() else np.asarray(found[:-1])


def _up(site: Worksite, cut: Cut, lift: int, top: float) -> Matrix | None:
    """(M, n) from where the teeth leave the ground up to `top` [m] or higher, inward as the level bucket requires."""
    r, z = float(cut.r[lift]), float(cut.z[lift])
    level, plane, begin = cut.bucket.level_pitch, site.plane, cut.q[lift]
    top = max(top, z + _STEP)
    inward = np.arange(r, r - 3.0, -_STEP)
    ends = plane.joints(cut.swing, inward, np.full(len(inward), top), np.full(len(inward), level))
    reached = np.flatnonzero(~np.isnan(ends[:, 0]))
    if not len(reached):
        return None
    goal = ends[reached[0]]
    count = max(int(np.ceil(np.max(np.abs(goal - begin)) / 0.1)), 4)
    straight = begin + np.linspace(0.0, 1.0, count + 1)[1:, None] * (goal - begin)
    if _clears(site, cut, straight):
        return np.asarray(straight)
    # straight up first, then inward
    heights = np.linspace(z, top, int(np.ceil((top - z) / _STEP)) + 1)[1:]
    rising = plane.joints(cut.swing, np.full(len(heights), r), heights, np.full(len(heights), float(cut.pitch[lift])))
    if np.isnan(rising).any():
        return None
    over = rising[-1] + np.linspace(0.0, 1.0, count + 1)[1:, None] * (goal - rising[-1])
    return np.asarray(np.vstack((rising, over)))


def _clears(site: Worksite, cut: Cut, q: Matrix) -> bool:
    """Whether teeth and back stay above the ground at q (M, n); where the cut has passed, above what it left."""
    r, z, pitch = site.plane.place(q)
    profile = cut.ground.profile

    def below(at: Array, teeth: Array) -> Array:
        # where the cut has just passed there is no ground any more
        dug = at > cut.r[cut.begin[3]] + 1e-9
        return np.where(dug, np.minimum(cut_bottom(cut, at), profile.height(at)), profile.height(at))

    back = back_heights(cut.bucket, r, z, pitch, below)
    return bool(np.all(np.minimum(back, z - below(r, r)) >= -1e-2))


def cut_bottom(cut: Cut, r: Array) -> Array:
    """(...) height of the ground after the cut at radii (...) that it has passed [m]."""
    inside = slice(0, cut.begin[3] + 1)
    order = np.argsort(cut.r[inside], kind="stable")
    return np.asarray(np.interp(r, cut.r[inside][order], cut.z[inside][order]))


def _nearest_pitches(site: Worksite, cut: Cut, r: float, heights: Vector) -> Vector:
    """(M,) pitches with which the teeth come down at radius r [m] through `heights` (M,) [m] to where a cut begins.

    From there up, each is the pitch within the limits that is nearest to the one below it; nan if there is none.
    """
    tried: Vector = np.linspace(-np.pi, 0.0, _PITCHES)
    at_z, at_pitch = (a.ravel() for a in np.meshgrid(heights, tried, indexing="ij"))
    q = site.plane.joints(cut.swing, np.full(len(at_z), r), at_z, at_pitch)
    reached = ~np.isnan(q[:, 0]).reshape(len(heights), -1)
    found = np.full(len(heights), np.nan)
    found[-1] = pitch = float(cut.pitch[0])
    for index in range(len(heights) - 2, -1, -1):
        own = tried[reached[index]]
        if not len(own):
            break
        # between two reachable pitches of the grid nothing changes
        pitch = float(np.clip(pitch, own[0], own[-1])) if _is_run(reached[index]) else _nearest(own, pitch)
        found[index] = pitch
    return found


def _is_run(reached: Flags) -> bool:
    """Whether all reachable pitches are adjacent."""
    return bool(np.count_nonzero(np.diff(reached.astype(int), prepend=0, append=0)) == 2)


def _nearest(values: Vector, to: float) -> float:
    return float(values[np.argmin(np.abs(values - to))])
