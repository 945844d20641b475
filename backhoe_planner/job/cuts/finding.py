"""The search for a cut: as deep as wanted, floor and cylinders allow, and long enough to fill the bucket.

A cut of a given depth is as long as it takes to fill the bucket, and then rises out of the ground. Its joints follow
from the arm's plane. The torques that hold machine and soil follow from gravity, from the contents of the bucket so
far, and from the earthmoving equation at the local depth and slope. If they exceed what the cylinders hold, less a
margin, the cut is made shallower.

An operator's manual of a backhoe loader of this class specifies first cuts of 75 to 100 mm over about 1.2 m, and
later ones of 100 to 150 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_number
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.cuts.attitude import ENTERING, Attitude, Stuck, attitude, wanted_pitch
from backhoe_planner.job.cuts.cut import Cut, CutGround, NoCut
from backhoe_planner.job.cuts.digger import RESERVE, Digger
from backhoe_planner.job.cuts.edge_path import Descent, Underground, spaced
from backhoe_planner.job.cuts.profile import Profile

_THINNEST = 0.03  # m; chosen: a shallower cut only scrapes
_NOTHING = 0.01  # m of depth that is not worth a cut; chosen, a fifth of the usual tolerance
_IDLE = 2e-3  # m of depth at which the edge only touches the ground; chosen: such ends of a path are left out
_ABOVE = 0.1  # m above the ground at which a cut begins; chosen
_NEARLY_LEVEL = 0.1  # rad beyond the level opening at which it still holds the heap; chosen
_MOST_INWARD = 2.0  # m; chosen: the pin of a level bucket is 1 m further out than its teeth
_LIFT = 0.7  # m from the ground up to the end of a cut: the level bucket reaches 0.5 m below its teeth
_ENTRIES = (1.53, 0.95, 0.6)  # rad, the steepest descents, tried in turn: 88, 54, 34 degrees; chosen
_LEAVES = (0.8, 1.53)  # rad: 46 degrees, faster by a tenth; and 88 along a wall, 4 cm off it in a trench of 1.2 m
_AT_END = 0.02  # m: a cut that comes this close to its end may be bounded by it; two steps of its line
_HALVINGS = 7  # of the depth: to 1 % of it
_FILLINGS = 9  # greatest number of evaluations of the length that fills the bucket
_FILLED = 2e-3  # part of the wanted volume: tolerance of the filling
_AIM = 0.993  # of the wanted volume: the places of a path are right to 0.3 % of it, on rough ground to 0.9 %
_SHORTENINGS = 5  # greatest number, for a cut that leaves the reach at its inner end; chosen
_INWARD = 0.05  # m by which each shortening keeps the end further out than the place that was out of reach


@dataclass(frozen=True, eq=False)
class _Asked:
    """The checked arguments of a search for a cut."""

    digger: Digger
    profile: Profile
    swing: float
    under: Underground
    end: float
    wanted: float
    entries: tuple[float, ...]
    leaves: tuple[float, ...]
    clears: Callable[[Matrix], Flags] | None


def find_cut(
    digger: Digger,
    profile: Profile,
    *,
    swing: float,
    start: float,
    end: float,
    depth: float,
    floor: tuple[Vector, Vector] | None = None,
    volume: float | None = None,
    entry: float | None = None,
    leave: float | None = None,
    clears: Callable[[Matrix], Flags] | None = None,
) -> Cut | NoCut:
    """A cut that begins at radius `start` and just fills the bucket.

    Parameters
    ----------
    digger: the machine and the soil.
    profile: the ground in the plane.
    swing: angle of the arm's plane [rad].
    start, end: the edge enters the ground at `start` and leaves it at `end` at the latest, radii [m]; `end` is
        the nearer one.
    depth: the greatest depth below the present ground, smoothed over 0.3 m of radius [m]: the cut is deeper where it
        passes a step of the ground itself.
    floor: (F,) increasing radii and (F,) heights [m], world, below which nothing is dug; none by default.
    volume: loose soil to be taken [m^3]; the bucket's capacity by default.
    entry: the greatest angle at which the edge goes down into the ground [rad]; by default 88 degrees if the
        machine can, otherwise 54 or 34.
    leave: the greatest angle at which it rises out of the ground [rad]; by default 46 degrees, or 88 if the cut
        continues to `end`.
    clears: returns (M,) whether joints (M, n) keep boom and stick off the ground around the cut; not checked by
        default, as that takes ten times as long.

    Returns
    -------
    The cut. Its bucket is not full if `end` comes first. It is shorter where the edge would only touch the ground.
    `NoCut` says why there is none.

    Raises
    ------
    InputError: a number is out of its range, or `start` and `end` are not on the profile with `end` below `start`.
    """
    asked = _checked(digger, profile, swing, (start, end), depth, floor, volume, (entry, leave))
    asked = replace(asked, clears=clears)
    under = asked.under
    between = (under.r >= asked.end - 1e-9) & (under.r <= under.start + 1e-9)
    room = float(np.max(under.followed[between] - under.floor[between]))
    if room < _NOTHING:
        reason = (
            f"there is nothing to dig between r {asked.end:.2f} and {under.start:.2f} m: the ground is at the floor"
        )
        return NoCut("nothing", reason)
    found: Cut | NoCut | None = None
    for leave in asked.leaves:
        tried = _by_entries(asked, min(depth, room), leave)
        found = tried if found is None or isinstance(tried, Cut) else found
        if isinstance(tried, Cut) and float(tried.r[-1]) > asked.end + _AT_END:
            break
    assert found is not None
    return found


def _by_entries(asked: _Asked, depth: float, leave: float) -> Cut | NoCut:
    """The cut with the steepest entry that is possible; if none is, why the steepest is not."""
    found: Cut | NoCut | None = None
    for entry in asked.entries:
        tried = _deepest(asked, depth, Descent(entry, leave))
        found = tried if found is None or isinstance(tried, Cut) else found
        if isinstance(tried, Cut) or tried.kind == "cylinder":
            break
    assert found is not None
    return found


def _checked(
    digger: Digger,
    profile: Profile,
    swing: float,
    between: tuple[float, float],
    depth: float,
    floor: tuple[Vector, Vector] | None,
    volume: float | None,
    angles: tuple[float | None, float | None],
) -> _Asked:
    check_kind(digger, Digger, key="digger")
    check_kind(profile, Profile, key="profile")
    swing = as_number(swing, key="swing")
    start, end = as_number(between[0], key="start"), as_number(between[1], key="end")
    low, high = float(profile.r[0]), float(profile.r[-1])
    if not low <= end < start <= high:
        raise InputError(
            "does not lie on the profile, nearer than the start",
            key="end", found=f"start {start}, end {end}", allowed=f"{low:.3g} to {high:.3g}, end below start",
        )  # fmt: skip
    as_number(depth, key="depth", above=0.0)
    for key, angle in zip(("entry", "leave"), angles, strict=True):
        if angle is not None and as_number(angle, key=key, above=0.0) >= 0.5 * np.pi:
            raise InputError("is not below a right angle", key=key, found=angle, allowed="0 to 1.57")
    entry, leave = angles
    wanted = digger.bucket.capacity if volume is None else as_number(volume, key="volume", above=0.0)
    own = (np.array([low, high]), np.full(2, -1e6)) if floor is None else floor
    under = Underground(profile, own, end=end, start=start)
    entries = _ENTRIES if entry is None else (entry,)
    return _Asked(digger, profile, swing, under, end, wanted, entries, _LEAVES if leave is None else (leave,), None)


def _deepest(asked: _Asked, depth: float, descent: Descent) -> Cut | NoCut:
    """The deepest cut that the cylinders can hold, at most `depth`."""
    allowed = 1.0 - RESERVE
    found = _cut(asked, depth, descent)
    if isinstance(found, NoCut) or found.holding.ratio <= allowed:
        return found
    least = _cut(asked, min(_THINNEST, depth), descent)
    if isinstance(least, NoCut):
        return least
    if least.holding.ratio > allowed:
        reason = f"this soil cannot be cut at any depth: even at {100.0 * _THINNEST:.0f} cm it takes {{}}; "
        reason += f"a plan uses at most {100.0 * allowed:.0f} %"
        holding = least.holding
        return NoCut("cylinder", reason.format(holding.describe()), holding.r, holding.z, holding)
    low, high, best = min(_THINNEST, depth), depth, least
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        tried = _cut(asked, middle, descent)
        if isinstance(tried, Cut) and tried.holding.ratio <= allowed:
            low, best = middle, tried
        else:
            high = middle
    return best


def _cut(asked: _Asked, depth: float, descent: Descent) -> Cut | NoCut:
    """The cut of a given depth, whatever forces it needs."""
    end = asked.end
    for attempt in range(_SHORTENINGS + 1):
        found = _cut_to(asked, depth, descent, end)
        if not isinstance(found, tuple):
            return found
        where, problem = found
        nearest = where + _INWARD
        if attempt == _SHORTENINGS or nearest > asked.under.start - 2.0 * _INWARD:
            return problem
        end = max(nearest, end + _INWARD)
    raise AssertionError


def _cut_to(asked: _Asked, depth: float, descent: Descent, end: float) -> Cut | NoCut | tuple[float, NoCut]:
    """The cut of a given depth that ends at `end` at the latest; or the radius at which it is impossible, and why."""
    digger, under = asked.digger, asked.under
    end = _filling_end(asked, depth, descent, end)
    line_r, line_z = under.path(depth, end, descent)
    deep = np.flatnonzero(asked.profile.depth(line_r, line_z) > _IDLE)
    if not len(deep) or float(np.max(asked.profile.depth(line_r, line_z))) < _NOTHING:
        angles = np.degrees([descent.entry, descent.leave])
        reason = "there is nothing to dig that the edge could reach at {:.0f} degrees down and {:.0f} up".format(
            *angles
        )
        return NoCut("nothing", reason)
    used = slice(max(int(deep[0]) - 1, 0), int(deep[-1]) + 2)
    r, z = spaced(line_r[used], line_z[used])
    rise_r, rise_z = _lifted(asked, float(r[-1]), float(z[-1]), float(np.max(z)))
    down = np.linspace(z[0] + _ABOVE, z[0], 4)[:-1]
    lift = len(down) + len(r) - 1
    r = np.concatenate((np.full(len(down), r[0]), r, rise_r))
    z = np.concatenate((down, z, rise_z))
    line = under.line(depth, end, descent)

    def below(at: Array, edge: Array) -> Array:
        ahead = np.where(at > edge - ENTERING, -np.inf, asked.profile.height(at))
        return np.where(at >= edge, np.interp(at, under.r, line), ahead)

    wanted = wanted_pitch(r, z, lift, digger.bucket)
    held = attitude(
        digger.plane, digger.bucket, swing=asked.swing, path=(r, z, *wanted), below=below, clears=asked.clears
    )
    if isinstance(held, Stuck):
        at = (float(r[held.index]), float(z[held.index]))
        place = f"with the teeth at r {at[0]:.2f}, z {at[1]:.2f} m"
        if held.in_reach:
            problem = NoCut("back", f"the bucket's back presses into the ground {place}, at any pitch", *at)
        else:
            problem = NoCut("reach", f"out of reach {place}", *at)
        return at[0], problem
    return _finished(asked, r, z, held, lift)


def _lifted(asked: _Asked, r: float, z: float, highest: float) -> tuple[Vector, Vector]:
    """The edge's path out of the ground, from r, z [m] up, and inward if the bucket cannot be level further out."""
    plane, profile = asked.digger.plane, asked.profile
    level = asked.digger.bucket.level_pitch + _NEARLY_LEVEL
    inward: Vector = np.arange(r, max(r - _MOST_INWARD, float(profile.r[0]) - 0.1), -0.1, dtype=float)
    ground = np.max(profile.height(np.linspace(inward, r, 20)), axis=0)
    top = np.maximum(ground, highest) + _LIFT
    reached = plane.reaches(asked.swing, inward, top, np.full(len(inward), level))
    to = int(np.argmax(reached))
    clear = max(z, float(ground[to]) + 0.05)
    line = np.array([[r, z], [r, clear], [inward[to], top[to]]])
    at_r, at_z = spaced(*(line if clear > z else line[1:]).T)
    return at_r[1:], at_z[1:]


def _filling_end(asked: _Asked, depth: float, descent: Descent, end: float) -> float:
    """The radius at which the edge leaves the ground with a full bucket; `end` if the bucket does not fill."""

    def excess(at: float) -> float:
        r, z = asked.under.path(depth, at, descent)
        bank, loose = asked.profile.taken(r, z, width=asked.digger.bucket.width)
        return (float(bank[-1]) * asked.digger.swell + float(loose[-1])) / (_AIM * asked.wanted) - 1.0

    low, high = end, asked.under.start
    at_low, at_high = excess(low), -1.0
    if at_low <= 0.0:
        return low
    side = 0
    for _ in range(_FILLINGS):  # regula falsi, with the older end halved (Illinois)
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = excess(middle)
        if -_FILLED < value <= 0.0:
            return middle
        if value > 0.0:
            low, at_low = middle, value
            at_high = 0.5 * at_high if side == 1 else at_high
            side = 1
        else:
            high, at_high = middle, value
            at_low = 0.5 * at_low if side == -1 else at_low
            side = -1
    return high


def _finished(asked: _Asked, r: Vector, z: Vector, held: Attitude, lift: int) -> Cut:
    digger, plane, bucket = asked.digger, asked.digger.plane, asked.digger.bucket
    bank, loose = asked.profile.taken(r, z, width=bucket.width)
    mass = digger.soil.density * (bank + loose / digger.swell)
    outward, left = plane.directions(asked.swing)
    ground = CutGround(asked.profile, plane.axis, outward, r, mass, bucket)
    torque, holding = digger.loads(held.q, ground)
    depth = np.maximum(asked.profile.depth(r, z), 0.0)
    rising = np.gradient(z) > 0.3 * np.hypot(np.gradient(r), np.gradient(z))
    below = np.flatnonzero(depth > 0.0)
    first = int(below[0]) if len(below) else lift
    lowest = first + int(np.argmax(z[first : lift + 1] <= np.min(z) + 0.1 * float(np.max(depth))))
    out = np.flatnonzero(~rising[: lift + 1])
    time, work = digger.estimated_run(held.q, torque)
    return Cut(
        swing=asked.swing, r=r, z=z, pitch=held.pitch, q=held.q,
        position=plane.world(asked.swing, r, z), across=np.append(left, 0.0),
        bank=bank, loose=loose, depth=depth,
        begin=(first, lowest, max(int(out[-1]) + 1, lowest) if len(out) else lowest, lift),
        held=mass, torque=torque, holding=holding,
        back=float(np.min(held.back)), wanted=asked.wanted, swell=digger.swell, ground=ground, bucket=bucket,
        time=time, work=work,
    )  # fmt: skip
