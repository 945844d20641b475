"""The bucket as a digging tool: width, capacity, cutting plate and back, measured on its collision shape.

The shape is viewed along the last joint's axis, in the plane normal to it, with the pin at the origin, x towards
the teeth and the inside of the bucket below x: when the arm is stretched out level, x points forward and the
second axis up.

The capacity follows SAE J296 and ISO 7451 in their simple form: the struck volume, up to the plane from the cutting
edge to the upper edge of the back, and a heap on it with sides of 1:1, as these standards define it for buckets of
backhoes. Curved edges are left out, and so are side plates that are recessed from that plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_number
from backhoe_planner.digits import beside_bounds
from backhoe_planner.errors import InputError
from backhoe_planner.job.ground.grids import lattice_within
from backhoe_planner.machine import Robot
from backhoe_planner.site import LIP, bucket_width

_LIP_LENGTH = 0.15  # m from the teeth: closer points are on teeth and lip, which are in the cut; chosen
_BACK_STEP = 0.1  # m between the sample points of the back; chosen, a sixth of the heel's distance
_ACROSS = 0.5  # part of the bucket's width: a wider piece is a plate from side to side; chosen
_AT_TEETH = 0.1  # part of the mouth: how far its end may be from the teeth; chosen, half a plate's thickness is 3 %
_SAME_WIDTH = 0.01  # m by which the cutting edge may be narrower than the shape: side plates protrude so far; chosen
_CELLS = 200  # of the grid on which the inside is measured, in each direction; the area is then right to 0.5 %


@dataclass(frozen=True, eq=False)
class Bucket:
    """The dimensions of a bucket that matter for digging.

    Attributes
    ----------
    width: width of the cutting edge [m].
    capacity: heaped volume of loose soil [m^3].
    length: distance from the pin to the teeth [m].
    mouth: length of the opening, from the teeth to the upper edge of the back [m].
    lip: angle from the line from pin to teeth down to the cutting plate [rad].
    back: (k, 2) points that may press into the ground behind the teeth [m], from the teeth, in the bucket's plane.
    level_pitch: pitch at which the opening is level and holds a heap [rad].
    held_at: (3,) centre of the load, in the frame of the last joint [m].
    payload_at: the same centre from the teeth, in the axes of the tip, as in a scene.
    """

    width: float
    capacity: float
    length: float
    mouth: float
    lip: float
    back: Matrix
    level_pitch: float
    held_at: Vector
    payload_at: tuple[float, float, float]

    @classmethod
    def of(cls, robot: Robot, *, width: float | None = None, capacity: float | None = None) -> Bucket:
        """The bucket of a machine.

        Parameters
        ----------
        robot: the machine; its last link is the bucket.
        width: width of the cutting edge [m]; that of the collision shape by default.
        capacity: heaped volume [m^3]; from the collision shape by default.

        Raises
        ------
        InputError: pitch is not defined for the machine; the bucket has no shape; or its capacity cannot be measured
            on the shape, and no capacity is given.
        """
        if not robot.has_pitch:
            problem = "a bucket digs in an upright plane: the axis of the last joint must stay horizontal"
            raise InputError(problem, key="bucket", found=robot.name)
        shape = bucket_width(robot)
        width = shape if width is None else as_number(width, key="bucket.width", above=0.0)
        if width < shape - _SAME_WIDTH:
            least = beside_bounds(width, shape, places=".6g", bounds_as=".3f")[1]
            raise InputError(
                "is narrower than the bucket's shape, which goes into the ground too", key="soil.width", found=width,
                allowed=f"{least} m or more",
            )  # fmt: skip
        section = _section(robot)
        struck, centre = section.inside()
        if capacity is not None:
            capacity = as_number(capacity, key="bucket.capacity", above=0.0)
        else:
            capacity = struck + heap(section.mouth, section.inner_width)
        tip = robot.model.frames[robot.tip_frame].placement
        x, y, z = (tip.rotation.T @ (centre - tip.translation)).tolist()
        return cls(
            width=width,
            capacity=capacity,
            length=section.length,
            mouth=section.mouth,
            lip=LIP,
            back=section.back(),
            level_pitch=section.level_pitch,
            held_at=centre,
            payload_at=(x, y, z),
        )


def heap(length: float, width: float) -> float:
    """Volume of a heap with sides of 1:1 on a rectangle [m^3], after SAE J296.

    It has the shape of a hipped roof, half as high as the shorter side.
    """
    long, short = max(length, width), min(length, width)
    return short**2 * long / 4.0 - short**3 / 12.0


@dataclass(frozen=True, eq=False)
class _Section:
    """The section of the bucket's shape in its plane.

    Attributes
    ----------
    plates: the corners (k, 2) of each plate from side to side [m].
    outline: (k, 2) outline of all pieces, convex, counter-clockwise.
    opening: (2, 2) ends of the mouth: at the teeth, and at the upper edge of the back.
    length, inner_width: [m].
    frame: (3, 3) the plane's two axes and the joint's axis, as rows, in the frame of the last joint.
    """

    plates: list[Matrix]
    outline: Matrix
    opening: Matrix
    length: float
    inner_width: float
    frame: Matrix

    @property
    def mouth(self) -> float:
        return float(np.linalg.norm(self.opening[1] - self.opening[0]))

    @property
    def level_pitch(self) -> float:
        """Pitch at which the mouth, from the teeth to the back, points outward and level: between -pi and 0."""
        along = self.opening[1] - self.opening[0]
        return -float(np.arctan2(along[1], along[0]))

    def back(self) -> Matrix:
        sides = np.stack((self.outline, np.roll(self.outline, -1, axis=0)), axis=1)
        parts = np.maximum(np.ceil(np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1) / _BACK_STEP), 1.0).astype(int)
        points = np.vstack(
            [np.linspace(side[0], side[1], int(part), endpoint=False) for side, part in zip(sides, parts, strict=True)]
        )
        along = self.opening[1] - self.opening[0]
        off = points - self.opening[0]
        middle = self.outline.mean(axis=0) - self.opening[0]
        side = (along[0] * off[:, 1] - along[1] * off[:, 0]) * np.sign(along[0] * middle[1] - along[1] * middle[0])
        off = points - [self.length, 0.0]
        # leave out the teeth and the opening
        return np.asarray(off[(np.linalg.norm(off, axis=1) > _LIP_LENGTH) & (side > 0.05 * self.mouth**2)])

    def inside(self) -> tuple[float, Vector]:
        """The struck volume [m^3], and its centre (3,) in the frame of the last joint [m]."""
        from scipy.ndimage import label

        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        step = (high - low) / _CELLS
        axes = [low[i] + step[i] * (np.arange(_CELLS) + 0.5) for i in range(2)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        along, off = self.opening[1] - self.opening[0], points - self.opening[0]
        side = along[0] * off[:, 1] - along[1] * off[:, 0]
        middle = self.outline.mean(axis=0) - self.opening[0]
        below = side * (along[0] * middle[1] - along[1] * middle[0]) > 0.0
        x, y = axes
        free = lattice_within(x, y, self.outline).T
        for plate in self.plates:
            free &= ~lattice_within(x, y, plate).T
        free = below & free.ravel()
        if not free.any():
            return 0.0, np.asarray(0.5 * self.opening.sum(axis=0) @ self.frame[:2])
        # the space behind a plate is not inside: only what can be reached from the mouth is
        parts = label(free.reshape(_CELLS, _CELLS))[0].ravel()
        candidates = np.flatnonzero(free)
        from_mouth = np.linalg.norm(points[candidates] - 0.5 * self.opening.sum(axis=0), axis=1)
        points = points[parts == parts[candidates[np.argmin(from_mouth)]]]
        return len(points) * float(np.prod(step)) * self.inner_width, points.mean(axis=0) @ self.frame[:2]


def _section(robot: Robot) -> _Section:
    placement = robot.model.frames[robot.tip_frame].placement
    tip = np.array(placement.translation)
    if robot.pitch_pin is not None:
        raise InputError("the bucket is held: it cannot dig", key="bucket", found=robot.name)
    axis = robot.joint_axes[-1] * robot.pitch_sense
    forward = tip - (tip @ axis) * axis
    length = float(np.linalg.norm(forward))
    if length < _LIP_LENGTH:
        raise InputError("the teeth are at the bucket's pin", key="bucket", found=f"{length:.3g} m apart")
    forward /= length
    frame = np.array([forward, np.cross(axis, forward), axis])
    pieces = [piece.piece for piece in robot.pieces if piece.joint == robot.n]
    if not pieces:
        raise InputError("the bucket has no collision shape to measure", key="bucket")
    spans = [(p.hull @ frame[:2].T, p.hull @ axis, p.radius) for p in pieces]
    full = max(np.max(y) + r for _, y, r in spans) - min(np.min(y) - r for _, y, r in spans)
    plates = [_hull(flat) for flat, y, r in spans if np.ptp(y) + 2.0 * r > _ACROSS * full]
    sides = [y for _, y, r in spans if np.ptp(y) + 2.0 * r <= _ACROSS * full]
    walls = [float(np.min(np.abs(y))) for y in sides if np.min(y) * np.max(y) > 0.0]
    inner = min(2.0 * min(walls), full) if walls else full
    outline = _hull(np.vstack([flat for flat, _, _ in spans]))
    return _Section(plates, outline, _opening(plates, length), length, float(inner), frame)


def _opening(plates: list[Matrix], length: float) -> Matrix:
    """(2, 2) the ends of the mouth: the longest side of the hull of the plates, the end at the teeth first."""
    if not plates:
        raise InputError("no piece of the bucket's shape reaches from side to side", key="bucket.capacity")
    hull = _hull(np.vstack(plates))
    ends = np.stack((hull, np.roll(hull, -1, axis=0)), axis=1)
    longest = ends[np.argmax(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))]
    off = np.linalg.norm(longest - [length, 0.0], axis=1)
    if float(np.min(off)) > _AT_TEETH * float(np.linalg.norm(longest[1] - longest[0])):
        problem = "the opening cannot be found in the bucket's shape: its longest side does not begin at the teeth"
        raise InputError(problem, key="bucket.capacity", allowed="a capacity in m^3")
    return np.asarray(longest[np.argsort(off)])


def _hull(points: Matrix) -> Matrix:
    """(k, 2) corners of the convex hull of points (m, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
    halves = []
    for run in (ordered, ordered[::-1]):
        chain: list[Vector] = []
        for point in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 1e-12:
                chain.pop()
            chain.append(point)
        halves.append(chain[:-1])
    return np.array(halves[0] + halves[1])


def _turn(a: Vector, b: Vector, c: Vector) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
