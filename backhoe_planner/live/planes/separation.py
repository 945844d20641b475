"""The pairs of the machine's links with what they must not touch, and a plane between the bodies of each.

The signed distance of two convex bodies is the largest gap that any plane leaves
between them: with unit normal n from the link to the obstacle,

    d = max_n  (min over the obstacle of n . z) - (max over the link of n . x)

The maximum is reached by coal's normal, also in penetration. So the plane of one measurement
bounds the distance at all other configurations as well, without calling coal: as long as the
obstacle stands still, it stays on its side of the plane, and the gap between the plane and
the corners of the link, wherever they are, is a lower bound of the distance. The same holds
for a plane that moves with the link, and the corners of the obstacle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.live.boxes.box_places import BoxPlaces
from backhoe_planner.live.boxes.cluster_pairs import SLOTS, ClusterPairs
from backhoe_planner.live.boxes.placed_piece import PlacedPiece
from backhoe_planner.live.planes.own_geometry import OwnGeometry
from backhoe_planner.live.planes.own_pieces import NO_LOAD, own_pieces, rows_on
from backhoe_planner.live.planes.plane_sets import PlaneSets
from backhoe_planner.machine import Cluster, Robot, covering_balls, reach_ball, tracking_room
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle

MACHINE = -1  # owner of the pairs of the machine with itself
FAR = 1e3  # m: beyond any site; the bound -FAR is no information
_NOT_COUNTING = -1e9  # m: clearance of the pairs of loads that are not carried now; far below any bound of a distance
_NO_FACES = np.full(15, np.nan)


class Separation:
    """All P pairs of a machine's links with each other and with a changing set of obstacles, with a plane each.

    It owns the working memory of measurements: do not share one between threads.

    Parameters
    ----------
    robot: the machine.
    q: (n,) its initial configuration. It may be outside the joint limits; from there the machine only comes back.
    self_collision: whether the machine is also kept clear of itself.
    laden: the same machine with each load that it may carry. None of them counts until `carry`.

    Attributes
    ----------
    own: the geometry of the robot's `self_pieces`, or of `Robot.pieces` if it is not kept clear of itself, and of the
        pieces of its loads.
    travel: (C, n) how far a point of the link can travel per joint, see `travel_bounds`.
    furthest: (n,) the largest of `travel` for each joint.
    turning: (n,) 1 for revolute joints, 0 for prismatic ones.
    owner: (P,) number that the obstacle was added with; `MACHINE` for pairs of the machine with itself.
    clearance: (P,) distance to be kept, including the machine's tracking error [m]; for a load that is not carried
        now it is so small that the pair never counts.
    full_clearance: (P,) the same, but with every load as if it were carried [m].
    load: (P,) number of the load that the pair belongs to, `NO_LOAD` for the machine's own pairs.
    piece, other_piece: (P,) rows of `own`: the one that comes near, and, for a pair of the
        machine with itself, the one that must not be touched, otherwise -1.
    body: P pieces of obstacles, or boxes around their cells; None for a pair of the machine with itself, and for one
        that waits for a box.
    joint, other: (P,) the joints in whose frames the two bodies are fixed; 0 for the world.
    relative_to: `other`, or None if all of it is the world.
    classes: (P,) row of `travel` that applies to the pair.
    mask: (P, n) 1 for joints that move the link against the other body, -1 for those that move only that one.
    velocity: (P, 3) of the obstacle [m/s], world.
    drift: (P,) rate at which the obstacle's own motion moves its plane along the normal [m/s].
    planes: (P, 4) minus the normal, and how far along the normal a link without radius may come, in the
        frame of the other body: the product with a corner and a 1 is the gap between them [m].
    points: (P, 6) the points between which the plane was measured, of the link and of the other body, each in the
        frame of its body [m]; nan if unknown.
    faces: (P, 15) of boxes and half-spaces, see `faces_of`; otherwise nan.
    clusters: the links' pairs with obstacles of thousands of cells; `counting_clusters` without those of loads that
        are not carried now, and `places` for where their boxes were found.
    shifts: by the number of an obstacle (3,) from where it was built [m].
    plane_sets: the planes of close looks.
    gauge: coal's working memory.
    measured: how many distances were measured so far.
    """

    def __init__(
        self, robot: Robot, q: Vector | None = None, *, self_collision: bool = True, laden: Sequence[Robot] = ()
    ) -> None:
        self.robot, self._laden, self._carried = robot, tuple(laden), NO_LOAD
        self._own_pieces = own_pieces(robot, self._laden, q, self_collision=self_collision)
        self.own = OwnGeometry.of(robot, self._laden, self._own_pieces, q)
        self._ball = max((reach_ball(one, q) for one in (robot, *self._laden)), key=lambda ball: ball[1])
        self.travel: Matrix = self.own.travel
        self.furthest: Vector = self.travel.max(axis=0, initial=0.0)
        self.turning = np.where(robot.prismatic, 0.0, 1.0)
        pairs = self._own_pieces.pairs
        self.owner = np.full(len(pairs), MACHINE, dtype=np.intp)
        self.piece = np.array([outer for outer, _ in pairs], dtype=np.intp)
        self.other_piece = np.array([inner for _, inner in pairs], dtype=np.intp)
        self.body: list[PlacedPiece | None] = [None] * len(pairs)
        self.classes: Indices = self.own.class_of_pair
        outer_pieces = [self.own.pieces[row] for row in self.piece.tolist()]
        self.full_clearance = tracking_room(robot, outer_pieces, self.travel[self.classes])
        self.load = np.array(self._own_pieces.load_of_pair, dtype=np.intp)
        self.planes = _no_planes(len(pairs))
        self.velocity = np.zeros((len(pairs), 3))
        self.drift = np.zeros(len(pairs))
        self.faces = np.full((len(pairs), 15), np.nan)
        self.points = np.full((len(pairs), 6), np.nan)
        self.clusters: list[ClusterPairs] = []
        self.shifts: dict[int, Vector] = {}
        self._bodies_of: dict[int, list[PlacedPiece]] = {}
        self.plane_sets, self.gauge, self.measured = PlaneSets(), shapes.Gauge(), 0
        self._refresh()

    def __len__(self) -> int:
        return len(self.owner)

    # --- which pairs there are -------------------------------------------------------

    def add(self, obstacles: Mapping[int, Obstacle]) -> Indices:
        """Add obstacles by their numbers, and return the indices of their pairs, which have no plane yet.

        The work of several at once does not grow with the square of their count.
        """
        owner, clearance, piece, velocity = [self.owner], [self.full_clearance], [self.piece], [self.velocity]
        first, faces = len(self), list(self.faces)
        for number, obstacle in obstacles.items():
            links = rows_on(self.robot, self._laden, self._own_pieces, obstacle.links)
            places = len(obstacle.pieces) if obstacle.cluster is None else SLOTS
            count = len(links) * places
            pieces = np.array(links * places, dtype=np.intp)
            owner.append(np.full(count, number, dtype=np.intp))
            clearance.append(obstacle.clearance + self.own.room[pieces])
            piece.append(pieces)
            velocity.append(np.repeat(obstacle.velocity[None], count, axis=0))
            self._bodies_of[number] = [PlacedPiece(piece) for piece in obstacle.pieces]
            for body in self._bodies_of[number]:
                self.body.extend([body] * len(links))
                faces.extend([shapes.faces_of(body.piece)] * len(links))
            if obstacle.cluster is not None:
                self.body.extend([None] * count)
                faces.extend([_NO_FACES] * count)
                self._add_cluster(number, obstacle, obstacle.cluster, links)
        self.owner, self.full_clearance = np.concatenate(owner), np.concatenate(clearance)
        self.piece, self.velocity = np.concatenate(piece), np.concatenate(velocity)
        added = len(self) - first
        self.classes = np.append(self.classes, self.own.class_of_piece[self.piece[first:]])
        self.load = np.append(self.load, self.own.load[self.piece[first:]])
        self.other_piece = np.append(self.other_piece, np.full(added, -1, dtype=np.intp))
        self.planes = np.concatenate((self.planes, _no_planes(added)))
        self.drift = np.append(self.drift, np.zeros(added))
        self.points = np.concatenate((self.points, np.full((added, 6), np.nan)))
        self.faces = np.array(faces).reshape(-1, 15)
        self._refresh()
        return np.arange(first, first + added, dtype=np.intp)

    def _add_cluster(self, number: int, obstacle: Obstacle, cluster: Cluster, links: Sequence[int]) -> None:
        speed = float(np.linalg.norm(obstacle.velocity))
        cluster.prepare_boxes(self._ball)  # this takes longer than a step may
        for link in links:
            own = self.own.pieces[link].piece
            classes = int(self.own.class_of_piece[link])
            kept = float(obstacle.clearance + self.own.room[link])
            one = ClusterPairs(number, cluster, link, own, classes, kept, self._ball, covering_balls(own), speed)
            self.clusters.append(one)

    def remove(self, number: int) -> Flags:
        """Remove an obstacle by its number, and return which pairs are left, (P,)."""
        kept = self.owner != number
        for name in (
            "owner", "full_clearance", "load", "classes", "piece", "other_piece", "planes", "velocity", "drift",
            "points", "faces",
        ):  # fmt: skip
            setattr(self, name, getattr(self, name)[kept])
        del self._bodies_of[number]
        self.shifts.pop(number, None)
        self.body = [body for body, keep in zip(self.body, kept.tolist(), strict=True) if keep]
        self.clusters = [one for one in self.clusters if one.number != number]
        self._refresh()
        return np.asarray(kept)

    def _refresh(self) -> None:
        """Update what follows from which pairs there are."""
        for one in self.clusters:
            one.pairs = ((self.owner == one.number) & (self.piece == one.piece)).nonzero()[0]
        self.joint = self.own.joint[self.piece]
        self.other = np.where(self.other_piece >= 0, self.own.joint[self.other_piece], 0)
        self.relative_to: Indices | None = self.other if self.other.any() else None
        self.mask = self.robot.support[self.joint] - self.robot.support[self.other]
        self._radius = self.own.radius[self.piece]
        self._count()

    # --- which pairs count -----------------------------------------------------------

    def carry(self, load: int) -> None:
        """Let the pairs of the load with this number count, and those of no other load; `NO_LOAD` for none."""
        self._carried = load
        self._count()

    def _count(self) -> None:
        """Update which pairs count."""
        counts = (self.load == NO_LOAD) | (self.load == self._carried)
        self.clearance = np.where(counts, self.full_clearance, _NOT_COUNTING)
        self.counting_clusters = [one for one in self.clusters if self.own.load[one.piece] in (NO_LOAD, self._carried)]
        self.places = BoxPlaces(
            self.clusters, self.own.joint, self.own.radius, self.own.columns, counting=self.counting_clusters
        )

    def pairs_of_load(self, load: int) -> tuple[Indices, Indices]:
        """The indices of a load's pairs, none for `NO_LOAD`: pairs with one plane each, and pairs of clusters."""
        if load == NO_LOAD:
            return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
        of_load, of_cluster = self.load == load, np.isin(self.owner, [one.number for one in self.clusters])
        return (of_load & ~of_cluster).nonzero()[0], (of_load & of_cluster).nonzero()[0]

    # --- bodies and planes -----------------------------------------------------------

    def place_at(self, number: int, shift: Vector) -> None:
        """Place an obstacle for coal at `shift` (3,) from where it was built [m]; planes stay where they are.

        The array is kept and not copied: a measurement uses its content at that time.
        """
        for body in self._bodies_of[number]:
            body.shift = shift
        self.shifts[number] = shift

    def put_bodies(self, one: ClusterPairs, bodies: Sequence[PlacedPiece | None]) -> None:
        """Let these bodies belong to the first pairs of a link with a cluster, and none to its other pairs."""
        known = self._bodies_of[one.number]
        for pair, body in zip_longest(one.pairs.tolist(), bodies):
            if (before := self.body[pair]) is not None:
                known.remove(before)
            self.body[pair] = body
            if body is not None:
                known.append(body)
        self.places.note(one)

    def keep_plane(self, pair: int, n: Vector, offset: float) -> None:
        """Let the plane of a pair be { x: n . x = offset }, n (3,) and offset [m] in the frame of the other body."""
        self.planes[pair, :3] = -n
        self.planes[pair, 3] = offset - self._radius[pair]
        self.drift[pair] = n.dot(self.velocity[pair])

    @property
    def plane_columns(self) -> tuple[Matrix, Vector, Matrix, Matrix]:
        """The arrays that change with the planes: `planes`, `drift`, `points` and `faces`."""
        return self.planes, self.drift, self.points, self.faces


def _no_planes(count: int) -> Matrix:
    """(count, 4) unknown planes, with the bound -FAR, which is no information."""
    planes = np.zeros((count, 4))
    planes[:, 3] = -FAR
    return planes
