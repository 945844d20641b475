"""Which pairs of the machine's own collision pieces must keep apart, and why the others need not.

Links overlap at the joints that hold them together, so collisions of such pairs mean nothing. They are
found by geometry, piece by piece and not body by body: a part that is fixed to a link (a cab, a
tool) is judged by itself. A pair is left out if its pieces

    are on one body         they never move against each other
    cannot meet             they are one joint apart, and this is proven over the joint's whole range; or it is
                            proven for the shapes as written, while their convex pieces overlap nearly throughout
    touch at the pin        they belong to the joint's own two links, and no overlap reaches far from its axis; or to
                            other links one joint apart that touch over its whole range, and the same holds or they
                            only graze; or they touch by themselves over nearly all of the range
    touch at the stop       they belong to the joint's own two links, and graze at the ends of its range
    always overlap          they belong to the joint's own two links, and overlap as written, away from the pin: at
                            every position of the joint at least one such pair does
    belong to links         two or more joints apart that touch in nearly every configuration, and the pieces
                            themselves often touch

"As written" means the shape as the URDF and its meshes give it. A convex piece may be larger than that, such as
around a hollow mesh. How often two links touch is therefore judged on shapes that are nowhere larger than the shape
as written (`Piece.inner`). If only the convex pieces of a pair overlap, and nothing is proven, the pair is kept.

Every other pair that may touch somewhere is kept. If the pieces of a kept pair often overlap while the shapes as
written do not, smaller pieces replace them (`finer_pairs`). Links may touch in all configurations only because a
joint is held, or moves in a narrower range than in the URDF: such a pair is left out only if it also touches by
construction in the machine as described.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import lru_cache

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine.collision_model import geometry_model, travel_bounds
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.finer_pairs import finer_pairs, pieces_with
from backhoe_planner.machine.keyed_robot import KeyedRobot
from backhoe_planner.machine.pairs_cache import LeftOut, SelfPairs, keep_pairs, key_of, read_pairs
from backhoe_planner.machine.proven_apart import proven_apart
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.overlap import faces_of, overlap_corners

# part of random configurations in which convex pieces touch; the links as written must then touch in `_THROUGHOUT`
_BY_CONSTRUCTION = 0.85
_POSTURES = (20, 100, 1000, 10_000)  # configurations tried in turn until decided; the last give the share to 0.004
_POSTURES_AS_WRITTEN = _POSTURES[:-1]  # 4 standard deviations of their share are 0.04, less than 0.9 minus 0.85
_SURE = 4.0  # standard deviations from the limit at which fewer configurations decide
_THROUGHOUT = 0.9  # part of the joint's range, or of configurations: 0.85 plus the possible error of 41 places
_PLACES = 41  # over a joint's range: every 9 deg of a full turn; between them the pair is proven to be apart
_IN_TURN = tuple(16 * index % _PLACES for index in range(_PLACES))  # these places, in an order that spreads them
_HALVINGS = 8  # of the interval between two places, to prove that a pair does not meet there
_PIN_OF_CONTACT = 1.5  # times the distance from the joint at which its links touch or overlap anyway: the pin ends here
_PIN_OF_LINK = 0.25  # or this part of the smaller link; the pin is where an overlap may be deepest
_REACH_OF_LINK = 1.0 / 3.0  # part of the smaller link; chosen: an overlap at the pin may reach this far
_BUT_OVERLAP = ", though their convex pieces overlap"  # these are larger than the shapes as written
_STOP = 2  # places at each end of the range: 5 % of it
_TOUCH = 1e-3  # m: nearer than this is touching; links of machines in use run past each other at 0.2 mm
_PLAY = 5e-3  # m: links that are nowhere further apart run past each other, such as a wheel in its housing at 4.5 mm
_SOMETIMES = 0.25  # part of the configurations in which two pieces of links that touch throughout do; less is no pin
_GRAZE = 5e-3  # m of overlap between convex pieces that approximate two links; a link that folds in goes deeper
_GRAZE_OF_LINK = 0.02  # or this part of the smaller link, if that is less
_MANY_PIECES = 20  # from this number on pairs go into the cache folder: the shipped backhoe's 26 take 30 ms without it

_Shaped = KeyedRobot[tuple[int, bytes, bytes, bytes]]


def _shaped(robot: Robot) -> _Shaped:
    """The machine, equal to its copies with the same pieces, ranges and, if it has a slide, tracking error."""
    tube = robot.tube.joints.tobytes() if robot.tube is not None and robot.prismatic.any() else b""
    # a machine with another tip or other held joints has other pieces
    return KeyedRobot(robot, (id(robot.pieces), robot.limits.lower.tobytes(), robot.limits.upper.tobytes(), tube))


def _described(robot: Robot) -> KeyedRobot[bytes]:
    """The machine, equal to every other one with the same inputs for its pairs, such as one that was loaded twice."""
    return KeyedRobot(robot, key_of(robot))


def self_pairs(robot: Robot, posture: tuple[float, ...] | None = None) -> SelfPairs:
    """The pairs of a machine's pieces that must not touch, and the pairs that are left out.

    Deterministic: the random configurations are seeded.

    Parameters
    ----------
    posture: n joint positions [rad or m], which may be outside of the joints' ranges: the ranges are
        extended to include them.
    """
    return _pairs_of(_shaped(robot), posture)


@lru_cache(maxsize=8)
def _pairs_of(shaped: _Shaped, posture: tuple[float, ...] | None) -> SelfPairs:
    return _pairs_as_described(_described(shaped.robot.at_origin), posture)  # the pairs do not depend on the base


@lru_cache(maxsize=8)
def _pairs_as_described(machine: KeyedRobot[bytes], posture: tuple[float, ...] | None) -> SelfPairs:
    """The pairs, from the cache folder if finding them is slow; not with a `posture`, of which there are too many."""
    robot = machine.robot
    has_meshes = any(solid.cached is not None for solid in robot.solids)
    if posture is not None or not (has_meshes or len(robot.pieces) >= _MANY_PIECES):
        return _worked_out(machine.robot, posture)
    pairs = read_pairs(machine.key)
    if pairs is None:
        pairs = _worked_out(machine.robot, posture)
        keep_pairs(machine.key, pairs)
    return pairs


def _worked_out(robot: Robot, posture: tuple[float, ...] | None) -> SelfPairs:
    kept, left_out = _of_pieces(robot, posture)
    if posture is not None:  # finer pieces rely on proofs over the ranges of the joints
        return SelfPairs(tuple(kept), left_out)
    found = finer_pairs(robot, kept)
    return SelfPairs((*sorted(set(kept).difference(found.divided)), *found.pairs), left_out, found.divided, found.finer)


def self_pieces(robot: Robot) -> tuple[LinkPiece, ...]:
    """The pieces to which the indices of `self_pairs` refer: `Robot.pieces`, then the finer ones."""
    return _pieces_of(_shaped(robot))


@lru_cache(maxsize=8)
def _pieces_of(shaped: _Shaped) -> tuple[LinkPiece, ...]:
    return pieces_with(shaped.robot, self_pairs(shaped.robot).finer)


def _of_pieces(robot: Robot, posture: tuple[float, ...] | None) -> tuple[list[tuple[int, int]], tuple[LeftOut, ...]]:
    """The pairs of `Robot.pieces` that must not touch, and why the others need not be checked."""
    kept, reasons = _judged(robot, posture)
    if robot.as_described is not robot:
        _, whole = _judged(robot.as_described, None)
        wrong = [pair for pair, (touch, _) in reasons.items() if touch and not whole.get(pair, (False, ""))[0]]
        kept = sorted([*kept, *wrong])
        reasons = {pair: reason for pair, reason in reasons.items() if pair not in wrong}
    left_out = dict.fromkeys(LeftOut(*_links(robot, pair), *reason) for pair, reason in sorted(reasons.items()))
    return kept, tuple(left_out)


def held_overlaps(robot: Robot) -> tuple[tuple[str, str, float], ...]:
    """Links that overlap because of held joints between the root and the tip, and how deep [m].

    They are on one body while the joints are held, and must not touch when the joints move.
    """
    whole = robot.as_described
    if whole is robot:
        return ()
    described = self_pairs(whole)
    pieces = pieces_with(robot, described.finer)
    model = geometry_model(robot, pieces=pieces)
    pairs = [(a, b) for a, b in described.kept if pieces[a].joint == pieces[b].joint]
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry = robot.model.createData(), model.createData()
    pin.updateGeometryPlacements(robot.model, data, model, geometry, robot.nearest_zero)
    deepest: defaultdict[tuple[str, str], float] = defaultdict(float)
    for row, pair in enumerate(pairs):
        depth = -float(shapes.measure(model, geometry, row).min_distance)
        links = pieces[pair[0]].link, pieces[pair[1]].link
        if depth > 0.0:
            deepest[links] = max(deepest[links], depth)
    return tuple((link, other, depth) for (link, other), depth in deepest.items())


def _judged(
    robot: Robot, posture: tuple[float, ...] | None
) -> tuple[list[tuple[int, int]], dict[tuple[int, int], tuple[bool, str]]]:
    """The pairs of pieces that must keep apart, and why the others need not, judged from this machine alone."""
    beside: list[list[tuple[int, int]]] = [[] for _ in range(robot.n)]  # pairs on the two bodies of each joint
    beyond: list[tuple[int, int]] = []
    for a, first in enumerate(robot.pieces):
        for b, second in enumerate(robot.pieces[a + 1 :], start=a + 1):
            # the piece further out comes first
            pair = (a, b) if first.joint > second.joint else (b, a)
            apart = abs(first.joint - second.joint)
            if apart == 1:
                beside[robot.pieces[pair[0]].joint - 1].append(pair)
            elif apart > 1:
                beyond.append(pair)
    reasons = _reasons_beyond(robot, beyond, posture)
    for joint, pairs in enumerate(beside):
        reasons.update(_reasons_beside(robot, joint, pairs, None if posture is None else posture[joint]))
    kept = sorted(pair for pair in (*beyond, *(p for pairs in beside for p in pairs)) if pair not in reasons)
    return kept, reasons


def _links(robot: Robot, pair: tuple[int, int]) -> tuple[str, str]:
    return robot.pieces[pair[0]].link, robot.pieces[pair[1]].link


def _reasons_beyond(
    robot: Robot, pairs: list[tuple[int, int]], posture: tuple[float, ...] | None
) -> dict[tuple[int, int], tuple[bool, str]]:
    """The pairs two or more joints apart that are left out, and why.

    A few configurations are enough if the links touch in nearly all of them, or in far fewer than by construction.
    """
    by_pieces, _ = _touch_in_postures(robot, pairs, _BY_CONSTRUCTION, inner=False)
    reasons, touching = _touch_in_postures(robot, list(by_pieces), _THROUGHOUT, inner=True)
    lower, upper = _range(robot, posture)
    for pair in by_pieces:
        outer, inner = (robot.pieces[index] for index in pair)
        larger = outer.piece.make_inner or inner.piece.make_inner
        if larger and pair not in touching and proven_apart(robot, (outer, inner), lower, upper):
            reasons[pair] = False, f"cannot meet{_BUT_OVERLAP}"
    return reasons


def _range(robot: Robot, posture: tuple[float, ...] | None) -> tuple[Vector, Vector]:
    """(n,), (n,) finite ranges of the joints, extended to include a posture [rad or m]."""
    lower, upper = robot.finite_range
    return (lower, upper) if posture is None else (np.minimum(lower, posture), np.maximum(upper, posture))


def _touch_in_postures(
    robot: Robot, pairs: list[tuple[int, int]], by_construction: float, *, inner: bool
) -> tuple[dict[tuple[int, int], tuple[bool, str]], set[tuple[int, int]]]:
    """The pairs whose links touch in at least the share `by_construction` of random configurations; all that touch.

    inner: whether to use shapes that are nowhere larger than the shapes as written.
    """
    rng = np.random.default_rng(0)
    reasons: dict[tuple[int, int], tuple[bool, str]] = {}
    touching: set[tuple[int, int]] = set()
    looks = _POSTURES_AS_WRITTEN if inner else _POSTURES
    for count in looks:
        if not pairs:
            break
        links, pieces = _touches(robot, pairs, [robot.random_q(rng) for _ in range(count)], inner=inner)
        touching.update(pieces)
        doubt = _SURE * np.sqrt(by_construction * (1.0 - by_construction) / count) if count < looks[-1] else 0.0
        undecided = []
        for pair in pairs:
            share = links[_links(robot, pair)] / count
            if share >= by_construction + doubt:
                if pieces[pair] >= _SOMETIMES * count:
                    how_many = "all" if links[_links(robot, pair)] == count else f"{100.0 * share:.0f} % of"
                    reasons[pair] = True, f"touch in {how_many} random postures"
            elif share > by_construction - doubt:
                undecided.append(pair)
        pairs = undecided
    return reasons, touching


def _touches(
    robot: Robot, pairs: list[tuple[int, int]], postures: list[Vector], *, inner: bool
) -> tuple[Counter[tuple[str, str]], Counter[tuple[int, int]]]:
    """In how many of the `postures` (n,) any of the pairs of two links touches, and in how many each pair does."""
    links: Counter[tuple[str, str]] = Counter()
    pieces: Counter[tuple[int, int]] = Counter()
    if inner:
        pairs = [pair for pair in pairs if all(robot.pieces[index].piece.inner is not None for index in pair)]
    model = geometry_model(robot, inner={index for pair in pairs for index in pair} if inner else ())
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry = robot.model.createData(), model.createData()
    for q in postures:
        if not pin.computeCollisions(robot.model, data, model, geometry, q, False):
            continue
        hit = [pair for pair, result in zip(pairs, geometry.collisionResults, strict=True) if result.isCollision()]
        pieces.update(hit)
        links.update({_links(robot, pair) for pair in hit})
    return links, pieces


def _reasons_beside(
    robot: Robot, joint: int, pairs: list[tuple[int, int]], stands_at: float | None
) -> dict[tuple[int, int], tuple[bool, str]]:
    """The pairs on the two bodies of `joint` (index) that are left out, and why; `stands_at`: see `self_pairs`."""
    if not pairs:
        return {}
    sweep = _Sweep(robot, joint, pairs, stands_at)
    name, its_own = robot.joint_names[joint], _own_links(robot, joint)
    by_links: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    for row, pair in enumerate(pairs):
        by_links[_links(robot, pair)].append(row)
    reasons: dict[tuple[int, int], tuple[bool, str]] = {}
    for links, rows in by_links.items():
        own = set(links) == its_own
        throughout = sweep.touch_throughout(rows)
        size = sweep.size(rows)
        pin_radius = sweep.pin_radius(rows, size) if throughout else _PIN_OF_LINK * size
        graze = min(_GRAZE, _GRAZE_OF_LINK * size)
        for row in rows:
            if sweep.never_meets(row):
                reasons[pairs[row]] = False, f"cannot meet over the range of {name}"
            elif (throughout or own) and sweep.touches_within(
                row,
                pin_radius,
                max(pin_radius, _REACH_OF_LINK * size),
                graze=graze if throughout else 0.0,
                anyway=rows if throughout else [],
            ):
                reasons[pairs[row]] = True, f"touch at {name}"
            elif sweep.never_meets_as_written(row):
                reasons[pairs[row]] = False, f"cannot meet over the range of {name}{_BUT_OVERLAP}"
            elif own and sweep.grazes_at_the_ends(row, graze):
                reasons[pairs[row]] = True, f"touch at the stop of {name}"
        if own and throughout:
            always = sweep.overlap_always([row for row in rows if pairs[row] not in reasons])
            reasons.update({pairs[row]: (True, f"overlap over the whole range of {name}") for row in always})
    return reasons


def _own_links(robot: Robot, joint: int) -> set[str]:
    """The two links that a joint (index) joins in the URDF."""
    described = robot.urdf.joints[robot.joint_names[joint]]
    return {str(described.parent), str(described.child)}


class _Sweep:
    """Pairs of pieces on the two bodies that one joint joins, over the joint's range.

    Attributes
    ----------
    distance: (S, P) signed distances at S places of the joint [m]; lower bounds for pairs that stay far apart.
    from_pin: (S, P) distance of the deepest contact from a hinge's axis, or from the origin of a slide [m];
        infinite where the pieces do not touch.
    """

    def __init__(self, robot: Robot, joint: int, pairs: list[tuple[int, int]], stands_at: float | None) -> None:
        self._robot, self._joint, self._pairs = robot, joint, pairs
        self._model = geometry_model(robot)
        for a, b in pairs:
            self._model.addCollisionPair(pin.CollisionPair(a, b))
        self._data, self._geometry = robot.model.createData(), self._model.createData()
        for request in self._geometry.distanceRequests:
            shapes.prepare(request)
        self._travel = travel_bounds(robot)[[outer for outer, _ in pairs], joint]
        lower, upper = robot.limits.lower[joint], robot.limits.upper[joint]
        if not (np.isfinite(lower) and np.isfinite(upper)):
            lower, upper = -np.pi, np.pi
        if stands_at is not None:
            lower, upper = min(lower, stands_at), max(upper, stands_at)
        if not robot.prismatic[joint]:
            upper = min(upper, lower + 2.0 * np.pi)  # beyond a full turn everything repeats
        self._places = np.linspace(lower, upper, _PLACES)
        self._placed: list[pin.SE3] = []  # placement of the joint's outer body in its inner one, at each place
        self._reaches: dict[int, Vector] = {}
        self._sizes = {index: self._reach(index) for index in {index for pair in pairs for index in pair}}
        self._written: dict[tuple[int, int, float], bool] = {}
        for place in self._places:
            self._move_to(place)
            self._placed.append(self._data.oMi[joint].actInv(self._data.oMi[joint + 1]))
        self.distance: Matrix = self._between_balls()
        self.from_pin: Matrix = np.full((_PLACES, len(pairs)), np.inf)
        far = self._plainly_apart() & np.all(self.distance > _PLAY, axis=0)
        for index, place in enumerate(self._places):
            self._move_to(place)
            for row in np.flatnonzero(~far).tolist():
                result = shapes.measure(self._model, self._geometry, row)
                distance = self.distance[index, row] = result.min_distance
                if distance <= _TOUCH:
                    nearest = 0.5 * (result.getNearestPoint1() + result.getNearestPoint2())
                    self.from_pin[index, row] = self._from_pin(self._data.oMi[joint + 1].actInv(nearest)[None, :])
        self._apart_throughout = self._plainly_apart()

    def _between_balls(self) -> Matrix:
        """(S, P) the distance between balls around the two pieces of each pair at each place [m]."""
        pieces = [piece.piece for piece in self._robot.pieces]
        centres = np.array([piece.hull.mean(axis=0) for piece in pieces])
        radii = np.array([
            np.linalg.norm(piece.hull - centre, axis=1).max() + piece.radius
            for piece, centre in zip(pieces, centres, strict=True)
        ])  # fmt: skip
        outer, inner = np.array(self._pairs).T
        found = [
            np.linalg.norm(centres[outer] @ T.rotation.T + T.translation - centres[inner], axis=1)
            for T in self._placed
        ]  # fmt: skip
        return np.asarray(np.array(found) - radii[outer] - radii[inner])

    def _plainly_apart(self) -> Flags:
        """(P,) which pairs cannot meet between any two neighbouring places, judged by the distances there alone."""
        reach = np.diff(self._places)[:, None] * self._travel
        near = self.distance[:-1] + self.distance[1:] <= reach
        return np.asarray(~(near.any(axis=0) | (self.distance <= _TOUCH).any(axis=0)))

    def _move_to(self, place: float) -> None:
        """Put the joint at `place`, and all others in the middle of their ranges."""
        q = self._robot.middle.copy()
        q[self._joint] = place
        pin.updateGeometryPlacements(self._robot.model, self._data, self._model, self._geometry, q)

    def _from_pin(self, points: Matrix) -> float:
        """The distance of the furthest of points (k, 3), in the joint's frame, from the joint; 0 without points [m]."""
        if not self._robot.prismatic[self._joint]:
            axis = self._robot.joint_axes[self._joint]
            points = points - np.outer(points @ axis, axis)
        return float(np.linalg.norm(points, axis=1).max(initial=0.0))

    def touch_throughout(self, rows: list[int]) -> bool:
        """Whether, as written, any of some pairs touches over nearly all of the range, or runs past with little play.

        This is judged on shapes that are nowhere larger than the shapes as written: the convex piece around a
        hollow mesh may overlap everywhere with something that the mesh meets only in a part of the range.
        """
        seen = np.any(self.distance[:, rows] <= _TOUCH, axis=1)
        if np.mean(seen) < _THROUGHOUT:
            return False
        overlap, apart = 0, []
        for place in _IN_TURN:
            if self._any_within(rows, place, 0.0):
                overlap += 1
            else:
                apart.append(place)
            if overlap >= _THROUGHOUT * _PLACES:
                return True
            if _PLACES - len(apart) < _THROUGHOUT * _PLACES:
                break
        unseen = _IN_TURN[overlap + len(apart) :]
        return all(self._any_within(rows, place, _PLAY) for place in (*apart, *unseen))

    def overlap_always(self, rows: list[int]) -> list[int]:
        """As few of some pairs as possible, so that at each place one of them touches as written; [] if impossible."""
        at = {row: {place for place in range(_PLACES) if self._any_within([row], place, 0.0)} for row in rows}
        without, found = set(range(_PLACES)), []
        while without:
            most = max(at, key=lambda row: len(at[row] & without), default=None)
            if most is None or not at[most] & without:
                return []
            found.append(most)
            without -= at.pop(most)
        return found

    def _any_within(self, rows: list[int], place: int, margin: float) -> bool:
        """Whether any of some pairs is, as written, within `margin` [m] at a place."""
        return any(self._within(row, place, margin) for row in rows if self.distance[place, row] <= margin)

    def _within(self, row: int, place: int, margin: float) -> bool:
        first, second = (self._robot.pieces[index].piece for index in self._pairs[row])
        if not (first.make_inner or second.make_inner):
            return bool(self.distance[place, row] <= margin)
        key = row, place, margin
        if key not in self._written:
            T = self._placed[place] * first.placement
            self._written[key] = shapes.within(first, T, second, second.placement, margin)
        return self._written[key]

    def size(self, rows: list[int]) -> float:
        """How far the smaller of the two links of these pairs reaches from the joint's origin [m]."""
        sizes: defaultdict[str, float] = defaultdict(float)
        for row in rows:
            for index in self._pairs[row]:
                link = self._robot.pieces[index].link
                sizes[link] = max(sizes[link], self._sizes[index])
        return min(sizes.values())

    def pin_radius(self, rows: list[int], size: float) -> float:
        """How far from the joint's axis links of `size` [m] that touch throughout may do so by construction [m]."""
        touching = self.distance[:, rows] <= _TOUCH
        nearest = np.where(touching, self.from_pin[:, rows], np.inf).min(axis=1)
        return max(_PIN_OF_CONTACT * float(nearest[np.isfinite(nearest)].max()), _PIN_OF_LINK * size)

    def _reach(self, index: int) -> float:
        """How far a piece reaches from the joint's origin, with the joint at 0 [m]."""
        piece, joint = self._robot.pieces[index], self._joint + 1
        origin = 0.0 if piece.joint == joint else self._robot.model.jointPlacements[joint].translation
        return float(np.linalg.norm(piece.piece.hull - origin, axis=1).max()) + piece.piece.radius

    def touches_within(self, row: int, radius: float, reach: float, *, graze: float, anyway: list[int]) -> bool:
        """Whether a pair was seen to touch only near the joint, or over nearly all of its range, or only by grazing.

        Parameters
        ----------
        radius, reach: how far from the joint's axis an overlap may be deepest, and how far it may reach [m].
        graze: overlap that does not count [m].
        anyway: the pairs of two links that touch throughout, as at a turntable; the reach of their overlaps
            at half of the places counts as construction.
        """
        touching = self.distance[:, row] <= _TOUCH
        if not np.any(touching):
            return False  # if the pieces meet at all, it is between two places
        if self.touch_throughout([row]):
            return True
        if not np.all(self.distance[:, row] > -graze):
            if np.any(self.from_pin[touching, row] > radius):
                return False
            if self._overlaps_beyond(row, reach) and self._overlaps_beyond(row, self._usual_reach(anyway)):
                return False
        return self._keeps_apart_elsewhere(row)

    def _overlaps_beyond(self, row: int, radius: float) -> bool:
        """Whether the overlap of a pair reaches further than `radius` [m] from the joint at some place."""
        outer, inner = (self._robot.pieces[index].piece for index in self._pairs[row])
        own = self._robot.model.jointPlacements[self._joint + 1]
        if (
            min(
                self._from_pin(outer.hull) + outer.radius,
                self._from_pin((inner.hull - own.translation) @ own.rotation) + inner.radius,
            )
            <= radius
        ):
            return False  # the smaller piece reaches no further
        return bool(np.any(self._overlap_reach(row) > radius))

    def _usual_reach(self, rows: list[int]) -> float:
        """How far from the joint the overlaps of some pairs still count as at the joint; 0 without pairs [m]."""
        if not rows:
            return 0.0
        furthest = np.max([self._overlap_reach(row) for row in rows], axis=0)
        return _PIN_OF_CONTACT * float(np.median(furthest))

    def _overlap_reach(self, row: int) -> Vector:
        """(S,) how far from the joint the overlap of a pair reaches at each place; 0 where they do not overlap [m]."""
        if row not in self._reaches:
            outer, inner = (faces_of(self._robot.pieces[index].piece) for index in self._pairs[row])
            reach = np.zeros(_PLACES)
            for place in np.flatnonzero(self.distance[:, row] < 0.0):
                back = self._placed[place].inverse()
                reach[place] = self._from_pin(overlap_corners(outer, inner, back.rotation, back.translation))
            self._reaches[row] = reach
        return self._reaches[row]

    def grazes_at_the_ends(self, row: int, graze: float) -> bool:
        """Whether a pair touches only at the ends of the joint's range, and overlaps there by less than `graze` [m]."""
        distance = self.distance[:, row]
        at_ends = np.any(distance <= _TOUCH) and np.all(distance[_STOP:-_STOP] > _TOUCH)
        return bool(at_ends and np.all(distance > -graze)) and self._keeps_apart_elsewhere(row)

    def never_meets(self, row: int) -> bool:
        """Whether a pair is proven to keep apart over the joint's whole range."""
        if self._apart_throughout[row]:
            return True
        return bool(np.all(self.distance[:, row] > _TOUCH)) and self._keeps_apart_elsewhere(row)

    def never_meets_as_written(self, row: int) -> bool:
        """Whether two pieces overlap nearly throughout, but are proven never to meet as written."""
        larger = any(self._robot.pieces[index].piece.make_inner for index in self._pairs[row])
        if not larger or np.mean(self.distance[:, row] <= _TOUCH) < _THROUGHOUT:
            return False
        if any(self._any_within([row], place, 0.0) for place in _IN_TURN):
            return False
        ends = np.tile(self._robot.middle, (2, 1))
        ends[:, self._joint] = self._places[[0, -1]]
        outer, inner = (self._robot.pieces[index] for index in self._pairs[row])
        return proven_apart(self._robot, (outer, inner), ends[0], ends[1])

    def _keeps_apart_elsewhere(self, row: int) -> bool:
        """Whether a pair is proven to keep apart between all neighbouring places, except where it touches at one."""
        places, distance = self._places, self.distance[:, row]
        ends = zip(places, places[1:], distance, distance[1:], strict=False)
        return all(self._apart(row, *end) for end in ends if min(end[2:]) > _TOUCH)

    def _apart(self, row: int, a: float, b: float, d_a: float, d_b: float, halvings: int = _HALVINGS) -> bool:
        """Whether a pair keeps apart between the places `a` and `b`, at which its distances are `d_a` and `d_b` [m]."""
        if d_a + d_b > (b - a) * self._travel[row]:
            return True
        if halvings == 0:
            return False
        middle = 0.5 * (a + b)
        self._move_to(middle)
        d_m = shapes.measure(self._model, self._geometry, row).min_distance
        return (
            d_m > _TOUCH
            and self._apart(row, a, middle, d_a, d_m, halvings - 1)
            and self._apart(row, middle, b, d_m, d_b, halvings - 1)
        )
