"""The site from above, with the cost of every place: the content of the picture and the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job import Terrain
from backhoe_planner.machine import Base, voxel_boxes
from backhoe_planner.site import PASSES_UNDER, Obstacle, build_obstacles
from backhoe_planner.site.schema import obstacle_shapes
from backhoe_planner.standing import Place, Spot, StandPlan

COSTS = ("#0b6e4f", "#5fae7b", "#d5e3a6", "#f2c879", "#c8643c")  # cheap to expensive; the ends differ in brightness too
WHY = {  # why a machine cannot stand somewhere: a colour and words; places out of reach or off the line are not drawn
    "edge": ("#e9d3cf", "on the dig, or too near its edge"),
    "dump": ("#cfe0ee", "no place to dump in reach"),
    "heap": ("#d9cdb8", "on the heap or the truck"),
    "obstacle": ("#cfc6dd", "an obstacle in the way"),
    "ground": ("#d8d8cf", "the ground is not level"),
    "unknown": ("#eceae4", "the ground is not known"),
}
DIG, OBSTACLE, HEAP, MACHINE, GIVEN = "#8a6a4a", "#7d8894", "#b99b6b", "#1d2731", "#5d6b78"
THINGS = "stands on the ground"  # the words for what a cloud shows
WHOLE = 0.98  # part of the soil from which a place counts as reaching all of it; as in the search
_MOST_TRIANGLES = 40_000  # of a scan, from larger voxels if there are more; chosen
_UPRIGHT = 0.9  # of its edge: a side of a voxel that is as high is upright; chosen, for scans tilted up to 40 degrees
_LAID = 0.05  # m of loose soil from which it is drawn as a heap
_DEAREST = 0.9  # of the costs in order: the most expensive tenth has one colour, so that a few do not stretch the scale


@dataclass(frozen=True, eq=False)
class Cell:
    """A place of the map.

    Attributes
    ----------
    corners: (4, 2) corners of its cell [m].
    spot: what was found at the place.
    """

    corners: Matrix
    spot: Spot


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine at a place.

    Attributes
    ----------
    outlines: (k, 2) outlines of the parts that do not move [m].
    axis: (2,) position of the swing axis [m].
    digs: (2,) middle of what the machine digs [m].
    label: its number among the places; empty for the place in the job file.
    """

    outlines: tuple[Matrix, ...]
    axis: Vector
    digs: Vector
    label: str


@dataclass(frozen=True, eq=False)
class Sketch:
    """The site from above; lengths in m, world.

    Attributes
    ----------
    cells: places that get a colour.
    digs: outlines of what is dug, section by section.
    obstacles: names and outlines of the obstacles.
    things: outlines of what stands on the ground of a cloud.
    heaps: outlines of the heaps at the end, or, without a place, of the room for all soil; for trucks, of their beds.
    machines: machines at the places of the answer.
    given: machine at the place of the job file; None if that is the answer.
    low, high: (2,) corners of all that is drawn.
    range: least and greatest cost of the colour scale.
    unit, scale: unit of the costs, and the factor that converts costs to it.
    """

    cells: tuple[Cell, ...]
    digs: tuple[Matrix, ...]
    obstacles: tuple[tuple[str, Matrix], ...]
    things: tuple[Matrix, ...]
    heaps: tuple[Matrix, ...]
    machines: tuple[Machine, ...]
    given: Machine | None
    low: Vector
    high: Vector
    range: tuple[float, float]
    unit: str
    scale: float


def sketch_of(plan: StandPlan) -> Sketch:
    """The drawing of an answer."""
    found = plan.map
    cells = tuple(
        Cell(_cell(plan, np.array([x, y])), spot)
        for row, xs, ys in zip(found.spots, found.x, found.y, strict=True)
        for spot, x, y in zip(row, xs, ys, strict=True)
        if np.isfinite(spot.cost) or spot.reason in WHY
    )
    machines = tuple(_machine(plan, place, number) for number, place in enumerate(plan.places, start=1))
    here = plan.job.site_scene.base
    base = Base(here.position, here.heading)
    is_answer = len(plan.places) == 1 and plan.places[0].base == base
    own = None if is_answer else Machine(_outlines(plan, base), np.array(base.position), _middle(plan.map.outline), "")
    digs = tuple(_section(place) for place in plan.places if place.section is not None) or (found.outline,)
    heaps = _heaps(plan)
    obstacles = () if plan.robot is None else build_obstacles(plan.job.site_scene, plan.robot)
    drawn = [found.outline, *digs, *heaps, *(outline for one in (*machines, own) if one for outline in one.outlines)]
    drawn += [cell.corners for cell in cells if np.isfinite(cell.spot.cost)]
    every = np.vstack(drawn)
    low, high = every.min(axis=0) - 0.7, every.max(axis=0) + 0.7
    costs = np.sort(np.array([cell.spot.cost for cell in cells if np.isfinite(cell.spot.cost)]))
    limits = (float(costs[0]), float(costs[int(_DEAREST * (len(costs) - 1))])) if len(costs) else (0.0, 1.0)
    unit, scale = plan.job.cost_unit
    return Sketch(
        cells, digs, _outlines_of(obstacles), _things(plan, obstacles), heaps, machines, own, low, high, limits,
        unit.replace("^3", "³"), scale,
    )  # fmt: skip


def name_place(sketch: Sketch, outline: Matrix) -> tuple[float, float] | None:
    """Position of an obstacle's label, x, y [m]; None if the obstacle is beyond what is drawn."""
    low, high = np.maximum(outline.min(axis=0), sketch.low), np.minimum(outline.max(axis=0), sketch.high)
    if (low >= high).any():
        return None
    x, y = (0.5 * (low + high)).tolist()
    return x, y


def colour(sketch: Sketch, cost: float) -> str:
    """The colour of a cost, as ``#rrggbb``."""
    least, most = sketch.range
    part = float(np.clip((cost - least) / max(most - least, 1e-9), 0.0, 1.0)) * (len(COSTS) - 1)
    below = min(int(part), len(COSTS) - 2)
    one, other = (np.array([int(COSTS[i][k : k + 2], 16) for k in (1, 3, 5)]) for i in (below, below + 1))
    mixed = np.round(one + (part - below) * (other - one)).astype(int)
    return "#" + "".join(f"{value:02x}" for value in mixed.tolist())


def _cell(plan: StandPlan, middle: Vector) -> Matrix:
    along = plan.map.along
    left = np.array([-along[1], along[0]])
    u, v = (0.5 * size for size in plan.map.cell)
    return np.array([middle + a * u * along + b * v * left for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def _outlines(plan: StandPlan, base: Base) -> tuple[Matrix, ...]:
    cosine, sine = np.cos(base.heading), np.sin(base.heading)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    return tuple(outline @ turn + base.position for outline in plan.footprints)


def _machine(plan: StandPlan, place: Place, number: int) -> Machine:
    digs = _middle(plan.map.outline if place.section is None else place.section)
    return Machine(_outlines(plan, place.base), np.array(place.base.position), digs, str(number))


def _middle(points: Matrix) -> Vector:
    return np.asarray(points.mean(axis=0))


def _section(place: Place) -> Matrix:
    trench = place.job.dig.trench
    assert trench is not None
    a, b = np.array(trench.start), np.array(trench.end)
    ahead = (b - a) / np.linalg.norm(b - a)
    left = 0.5 * trench.width * np.array([-ahead[1], ahead[0]])
    return np.array([a - left, b - left, b + left, a + left])


def _heaps(plan: StandPlan) -> tuple[Matrix, ...]:
    truck = plan.job.dump.truck
    if truck is not None:
        cosine, sine = np.cos(truck.bed.yaw), np.sin(truck.bed.yaw)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        half = 0.5 * np.array(truck.bed.size[:2])
        corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return (corners @ turn + np.array(truck.bed.position[:2]),)
    return _laid(plan.places[-1].plan.end) if plan.places else plan.dumps


def _laid(ground: Terrain) -> tuple[Matrix, ...]:
    """Convex outlines of the loose soil on the ground."""
    from scipy.ndimage import label
    from scipy.spatial import ConvexHull

    numbers, count = label(ground.loose > _LAID)
    nodes = np.stack(np.meshgrid(ground.x, ground.y), axis=-1)
    found = []
    for number in range(1, count + 1):
        points = nodes[numbers == number]
        if np.ptp(points, axis=0).min() > 2.0 * ground.cell:
            found.append(points[ConvexHull(points).vertices])
    return tuple(found)


def _outlines_of(obstacles: Sequence[Obstacle]) -> tuple[tuple[str, Matrix], ...]:
    """Names and outlines of the obstacles that have an outline from above."""
    found = []
    for obstacle in obstacles:
        outline = None if obstacle.zone is not None else _outline(obstacle)
        if outline is not None:
            found.append((obstacle.name, outline))
    return tuple(found)


def _things(plan: StandPlan, obstacles: Sequence[Obstacle]) -> tuple[Matrix, ...]:
    """(4, 2) corners of rectangles [m] that together are the columns in which something stands on the ground.

    Of a scan among the obstacles everything counts under which a machine cannot pass.
    """
    stands = None if plan.ground is None else plan.ground.off_ground
    found = [] if stands is None else _rectangles(stands.centres[:, :2] / stands.edge, stands.edge)
    for obstacle in obstacles:
        if isinstance(obstacle.spec, obstacle_shapes.PointCloud) and obstacle.cluster is not None:
            sides = obstacle.cluster.drawing(_MOST_TRIANGLES)[0].reshape(-1, 4, 3)  # of voxels, four corners each
            edge = float(np.linalg.norm(sides[0, 1] - sides[0, 0]))
            middle = sides.mean(axis=1)
            is_top = (np.ptp(sides[..., 2], axis=1) < _UPRIGHT * edge) & (middle[:, 2] > PASSES_UNDER)
            found += _rectangles(middle[is_top, :2] / edge, edge)
    return tuple(found)


def _rectangles(places: Matrix, edge: float) -> list[Matrix]:
    """(4, 2) corners of rectangles that together are the squares with an `edge` [m] around places (k, 2) [edges]."""
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    flat = np.column_stack((places, np.full(len(places), 0.5)))
    return [edge * (centre[:2] + size[:2] * corners) for centre, size in voxel_boxes(flat, 1.0)]


def _outline(obstacle: Obstacle) -> Matrix | None:
    from scipy.spatial import ConvexHull

    if obstacle.cluster is not None:
        return None
    points = []
    for piece in obstacle.pieces:
        if len(piece.hull):
            angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
            ball = max(piece.radius, 1e-3) * np.column_stack((np.cos(angle), np.sin(angle)))
            points.append((piece.hull[:, None, :2] + ball).reshape(-1, 2))
    if not points:
        return None
    every = np.vstack(points)
    return np.asarray(every[ConvexHull(every).vertices])
