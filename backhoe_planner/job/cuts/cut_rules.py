"""Whether a motion through the ground is a cut: any motion is checked against the rules by which cuts are found."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job.cuts.attitude import ENTERING, back_heights, plate_pitch
from backhoe_planner.job.cuts.digger import Digger
from backhoe_planner.job.cuts.profile import Profile

# Bounds for planned motions: 54 cuts of five jobs kept 3 cm, 0.05 to 2.42 rad and 2.3 mm.
_OUTWARD = 0.01  # m by which the edge may move back outward in the ground
_PRESSED = 0.0  # least height of the bucket's back above the ground [m]
_RUBS, _PUSHES = 0.0, 2.6  # rad from the path to the plate: below it the underside rubs, above it the back pushes
_DEEP = 0.02  # m: a plate that is less deep cuts next to nothing, at any angle
_IN_PLANE = 1e-9  # rad: rounding
_SPACING = 0.03  # m between places at which the plate's angle is taken, as for the cuts themselves


def broken_rules(digger: Digger, profile: Profile, q: Matrix, *, swing: float) -> list[str]:
    """The rules of a cut that a motion breaks, in words; empty if the motion is a cut.

    Parameters
    ----------
    digger: the machine and the soil.
    profile: the ground before the motion, in the plane of the cut.
    q: (K, n) joints, one after the other.
    swing: angle of that plane [rad].
    """
    if digger.plane.swings and np.any(np.abs(q[:, 0] - swing) > _IN_PLANE):
        return ["the cut leaves the plane in which it digs"]
    r, z, pitch = digger.plane.place(q)
    depth = profile.depth(r, z)
    found = []
    if depth[0] > 0.0 or depth[-1] > 0.0:
        found.append("the cut does not begin and end above the ground")
    inside = depth > 0.0
    if inside.any():
        outward = np.where(inside, r - np.minimum.accumulate(np.where(inside, r, np.inf)), -np.inf)
        if float(np.max(outward)) > _OUTWARD:
            found.append(f"in the ground the teeth go outward at r {_at(r, outward)} m: the bucket is pushed backwards")
    room = _back_room(digger, profile, r, z, pitch)
    if float(np.min(room)) < _PRESSED:
        deep = -100.0 * float(np.min(room))
        found.append(f"the bucket's back presses {deep:.0f} cm into the ground with the teeth at r {_at(r, -room)} m")
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))))
    places = np.linspace(0.0, along[-1], max(int(along[-1] / _SPACING), 3))
    even = np.interp(places, along, r), np.interp(places, along, z)
    rising = np.arctan2(np.gradient(even[1]), -np.gradient(even[0]))
    plate = np.interp(places, along, pitch) - plate_pitch(digger.bucket, rising, 0.0)
    cutting = profile.depth(*even) > _DEEP
    for wrong, words in ((_RUBS - plate, "the underside of the plate rubs"), (plate - _PUSHES, "the plate pushes")):
        wrong = np.where(cutting, wrong, -np.inf)
        if float(np.max(wrong)) > 0.0:
            angle = np.degrees(plate[int(np.argmax(wrong))])
            found.append(f"{words}: it stands at {angle:.0f} degrees to its path at r {_at(even[0], wrong)} m")
    return found


def _at(r: Vector, wrong: Vector) -> str:
    return f"{r[int(np.argmax(wrong))]:.2f}"


def _back_room(digger: Digger, profile: Profile, r: Vector, z: Vector, pitch: Vector) -> Vector:
    """(K,) height of the bucket's back above the ground as the edge has left it up to then [m].

    Columns within one step of the profile from the edge's path count as cut.
    """
    ground, step = profile.mean.copy(), float(np.max(np.diff(profile.r)))
    found = np.zeros(len(r))
    before = 0
    for k in range(len(r)):
        near, far = (before, k) if r[before] < r[k] else (k, before)
        i, j = np.searchsorted(profile.r, (r[near] - step, r[far] + step))
        level = r[far] - r[near] < 1e-9
        edge = min(z[near], z[far]) if level else np.interp(profile.r[i:j], r[[near, far]], z[[near, far]])
        ground[i:j] = np.minimum(ground[i:j], edge)

        def below(at: Vector, teeth: Vector, own: Vector = ground) -> Vector:
            return np.where((at < teeth) & (at > teeth - ENTERING), -np.inf, np.interp(at, profile.r, own))

        found[k] = back_heights(digger.bucket, r[k : k + 1], z[k : k + 1], pitch[k : k + 1], below)[0]
        before = k
    return found
