"""A job combined with its machine: what is dug with what, on which ground, within which limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.errors import InputError, SceneError, check_kind
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.bucket import Bucket
from backhoe_planner.job.cuts.digger import Digger
from backhoe_planner.job.ground.grids import HeightGrid, nearest_columns
from backhoe_planner.job.ground.obstacle import ground_around, ground_beyond, kept_by_arm, off_ground_obstacles
from backhoe_planner.job.ground.off_ground import columns_below
from backhoe_planner.job.ground.scanned import Scanned, scanned_around
from backhoe_planner.job.ground.surveys import Survey, read_survey
from backhoe_planner.job.ground.terrain import Terrain, terrain_of
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.worksite.arm_clearance import ArmOutline
from backhoe_planner.job.worksite.design import Design, SurfaceDesign, TrenchDesign
from backhoe_planner.machine import Base, Robot, load_robot, reach_ball
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.site import Obstacle, Soil, read_height_grid, scene_from_dict

UNEVEN = 0.15  # m by which the ground may be higher or lower than the machine stands; chosen, jacks level that
_AROUND = 1.0  # m of ground around all that is dug and heaped
_ARM_SPARE = 0.015  # m beyond the clearance, for positions between the sampled ones; a few mm were seen
_HEADROOM = 2.5  # m above the ground that a heap and the open bucket over it take up; chosen
_HEADINGS = 91  # at which the machine's reach is sampled; chosen


@dataclass(frozen=True, eq=False)
class Worksite:
    """A job, checked against its machine.

    Attributes
    ----------
    job: the job as it was given.
    robot: the machine on its site.
    problem: the problem of the site without the ground; its task is to stay at its start.
    digger: the machine as a digger in the soil.
    ground: the ground before the first cycle.
    own_ground: the job's own ground, whatever a survey says.
    beyond: the ground in the file of the job beyond that; None if it goes no further.
    design: the design to be dug.
    arm: boom and stick, which must stay above the ground.
    things: what stands on the ground of a cloud where the machine or its arm may be, as obstacles.
    """

    job: Job
    robot: Robot
    problem: Problem
    digger: Digger
    ground: Terrain
    own_ground: Terrain
    beyond: HeightGrid | None
    design: Design
    arm: ArmOutline
    things: tuple[Obstacle, ...]

    @property
    def bucket(self) -> Bucket:
        """The bucket of the machine, with the job's capacity."""
        return self.digger.bucket

    @property
    def plane(self) -> ArmPlane:
        """The plane in which the arm digs."""
        return self.digger.plane

    @property
    def nodes(self) -> Array:
        """(rows, columns, 2) x, y of the columns of the ground [m]."""
        return np.stack(np.meshgrid(self.ground.x, self.ground.y), axis=-1)

    @cached_property
    def _columns(self) -> tuple[Matrix, Matrix]:
        ground = self.ground
        return self.design.columns(ground.x, ground.y, ground.cell)

    @property
    def share(self) -> Matrix:
        """(rows, columns) the part of each column of the ground that is within the design, 0 to 1."""
        return self._columns[0]

    def design_heights(self) -> Matrix:
        """(rows, columns) the design in the columns that are wholly or partly within it [m]; nan elsewhere."""
        return self._columns[1]

    def within_design(self, ground: Terrain) -> Matrix:
        """(rows, columns) height of the ground in the part of each column that is within the design [m].

        For a column that is partly within it only the mean height is known; the rest is at the job's own ground.
        """
        share = self.share
        # a survey may be on other columns
        before = self.own_ground if self.own_ground.shape == ground.shape else self.ground
        beside = (1.0 - share) * before.surface
        return np.where(share > 0.0, (ground.surface - beside) / np.where(share > 0.0, share, 1.0), ground.surface)

    @cached_property
    def taken(self) -> Flags:
        """(rows, columns) on which something stands, so that no heap can lie there."""
        ground = self.ground
        heights = HeightGrid(ground.low, ground.cell, ground.surface)
        return columns_below(ground.off_ground, heights, _HEADROOM)

    @property
    def volume(self) -> float:
        """Loose soil that fills the bucket [m^3]."""
        return self.bucket.capacity * self.job.bucket.fill


def build_worksite(job: Job, *, terrain: Terrain | None = None) -> Worksite:
    """Combine a job with its machine.

    Parameters
    ----------
    terrain: the ground as it is now; by default that of the job.

    Raises
    ------
    InputError: the machine, the site or the ground cannot be used, or they do not fit each other.
    """
    robot = load_robot(job.machine_source, tip=job.site_scene.tip, hold=job.site_scene.hold)
    if not robot.has_pitch:
        raise SceneError("a bucket digs in an upright plane: the axis of the last joint must stay horizontal",
                         file=job.file, key="machine", found=robot.name)  # fmt: skip
    problem = _problem(job, robot)
    digger = _digger(job, problem)
    # a survey of what was dug does not say how deep it was to be dug
    own, beyond = _ground(job, digger.plane)
    ground = own if terrain is None else terrain
    design = _design(job, own)
    reach, clearance = reach_area(digger.plane), problem.scene.clearance
    within = _where_it_may_be(problem.robot, clearance + problem.scene.influence)
    around = (
        ground_around(ground, job.ground.level or 0.0, reach.min(axis=0), reach.max(axis=0), clearance)
        if job.ground.file is None
        else ground_beyond(ground, beyond, *within, clearance)
    )
    stands = off_ground_obstacles(ground.off_ground, clearance, within=within)
    around = tuple(own for one in around for own in kept_by_arm(one, digger.plane.arm, digger.plane.swung))
    for one in (*around, *stands):
        if one.cluster is not None:
            one.cluster.prepare(*reach_ball(problem.robot))
    problem = replace(problem, obstacles=(*problem.obstacles, *around, *stands))
    arm = ArmOutline(digger.plane, problem.scene.clearance + _ARM_SPARE)
    return Worksite(job, problem.robot, problem, digger, ground, own, beyond, design, arm, stands)


def plain_soil(job: Job) -> Soil:
    """The soil in the form of a scene, without swell and angle of repose."""
    given = job.soil.model_dump(exclude={"swell", "repose"}, exclude_unset=True)
    return Soil(**given)


def _problem(job: Job, robot: Robot) -> Problem:
    """The site without the ground; its task is to stay at the machine's start."""
    joints = job.start
    if joints is None:
        joints = dict(zip(robot.joint_names, some_posture(robot).tolist(), strict=True))
    content = job.scene_dict() | {
        "start": {"joints": joints}, "task": {"goal": {"joints": joints}}, "objective": job.objective,
    }  # fmt: skip
    scene = scene_from_dict(content, folder=job.site_scene.folder, file=job.file)
    try:
        problem = build_problem(robot, scene)
    except SceneError as error:
        if error.key is None or not error.key.startswith("start.joints"):
            raise
        key = "start" + error.key.removeprefix("start.joints")  # a job gives the joints right there
        raise SceneError.of(error, file=error.file, key=key) from None
    if job.start is None:
        problem = replace(problem, start_q=None)
    return problem


def some_posture(robot: Robot) -> Vector:
    """(n,) a posture within the limits, for a job without a start [rad or m]."""
    return np.clip(robot.middle, robot.limits.lower, robot.limits.upper)


def _digger(job: Job, problem: Problem) -> Digger:
    soil = plain_soil(job)
    try:
        bucket = Bucket.of(problem.robot, width=soil.width, capacity=job.bucket.capacity)
        return Digger(problem.robot, soil, bucket=bucket, limits=problem.limits, swell=job.soil.swell)
    except InputError as error:
        raise SceneError.of(error, file=job.file, key=error.key) from None


def reach_area(plane: ArmPlane) -> Matrix:
    """(k, 2) points around the area that the teeth can reach [m], and the machine's own place."""
    robot, limits = plane.robot, plane.limits
    farthest = float(np.max(plane.place(_stretched(robot))[0]))
    swings = np.linspace(limits.lower[0], limits.upper[0], _HEADINGS) if plane.swings else np.zeros(1)
    ends = np.concatenate([plane.world(float(s), np.array([farthest]), np.zeros(1))[:, :2] for s in swings])
    return np.vstack((ends, plane.axis))


def _where_it_may_be(robot: Robot, around: float) -> tuple[Vector, Vector]:
    """Least and greatest x, y (2,) of a machine and its arm in any posture, and `around` it [m]."""
    centre, radius = reach_ball(robot)
    every = np.vstack((centre[:2] - radius, centre[:2] + radius, fixed_corners(robot)))
    return every.min(axis=0) - around, every.max(axis=0) + around


def fixed_corners(robot: Robot) -> Matrix:
    """(k, 2) x, y of points around the parts of a machine that do not move [m]; none if it has no such parts."""
    sides = [corners + side * radius for corners, radius in robot.fixed_outlines for side in (-1.0, 1.0)]
    return np.vstack(sides) if sides else np.zeros((0, 2))


def _stretched(robot: Robot) -> Matrix:
    """(k, n) random postures, among which the arm reaches farthest."""
    rng = np.random.default_rng(0)
    return rng.uniform(robot.limits.lower, robot.limits.upper, (4000, robot.n))


def _ground(job: Job, plane: ArmPlane) -> tuple[Terrain, HeightGrid | None]:
    """The ground before the first cycle, and that of its file beyond it; None if the file goes no further."""
    given, soil = job.ground, plain_soil(job)
    points = [reach_area(plane)]
    if job.dig.trench is not None:
        points.append(np.array([job.dig.trench.start, job.dig.trench.end]))
    if job.dump.heap is not None:
        points.append(np.array(job.dump.heap.places))
    every = np.vstack(points)
    step = given.cell
    low = np.floor(every.min(axis=0) / step) * step - _AROUND if given.low is None else np.array(given.low)
    high = np.ceil(every.max(axis=0) / step) * step + _AROUND if given.high is None else np.array(given.high)
    loose = {"swell": job.soil.swell, "repose": job.soil.repose}
    if given.file is None:
        try:
            return Terrain.level(given.level or 0.0, low, high, given.cell, soil=soil, **loose), None
        except InputError as error:
            raise SceneError(
                error.problem, file=job.file, key="ground.cell", found=f"{given.cell:g} m from {low.tolist()} to "
                f"{high.tolist()}, {error.found} columns", allowed=f"{error.allowed} columns",
                hint="a larger ground.cell, or less ground from ground.low to ground.high",
            ) from None  # fmt: skip
    try:
        found = _survey(job, given.file)
        return terrain_of(found, soil=soil, fill=given.fill, file=job.folder / given.file, **loose), found.beyond
    except InputError as error:
        raise SceneError(str(error), file=job.file, key="ground.file") from None


def _survey(job: Job, file: str) -> Survey:
    given = job.ground
    return read_survey(
        job.folder / file, low=given.low, high=given.high, cell=given.cell, map_origin=given.map_origin,
        roughness=given.roughness,
    )  # fmt: skip


def ground_warnings(job: Job) -> tuple[str, ...]:
    """Doubts about the ground of a job, in words: what stands on a ground of points, and ground that is not level.

    A file that cannot be read gives none: `build_worksite` tells what is wrong with it.
    """
    file = check_kind(job, Job, key="job").ground.file
    if file is None:
        return ()
    try:
        survey = _survey(job, file)
        words = (survey.remark, _not_level(job, survey))
    except InputError:
        return ()
    return tuple(f"ground.file: {one}" for one in words if one)


def _not_level(job: Job, survey: Survey) -> str:
    """How high the ground under the machine is, in words; empty if it is level with the machine, or unknown."""
    robot = load_robot(job.machine_source, tip=job.site_scene.tip, hold=job.site_scene.hold)
    base = job.site_scene.base
    here = robot.with_base(Base(base.position, base.heading))
    heights = survey.heights.at(fixed_corners(here))
    heights = heights[np.isfinite(heights)]
    if not len(heights) or np.abs(heights).max() <= UNEVEN:
        return ""
    return (
        f"the ground under the machine is from {heights.min():.2f} to {heights.max():.2f} m high, and the machine "
        f"stands level at 0: `stand` takes places within {UNEVEN:g} m. The last number of ground.map_origin is the "
        "height in the file that is 0 on the site"
    )


def read_ground(job: Job, file: Path) -> Scanned:
    """The ground of a job according to a survey in the course of the work: what was dug and heaped since the beginning.

    Parameters
    ----------
    file: heights or points, as in `Terrain.from_file`. The first height of a table is at the job's own first column.

    Returns
    -------
    The ground on the job's own grid; where the survey does not reach, the job's own ground.

    Raises
    ------
    InputError: the file is missing or malformed, or does not cover what is dug.
    """
    site = build_worksite(job)
    own = site.ground
    if file.suffix.lower() == ".csv" and (shape := read_height_grid(file).heights.shape) != own.shape:
        raise InputError(
            "is not as large as the ground of the job", file=file, found=f"{shape[0]} x {shape[1]} heights",
            allowed=f"{own.shape[0]} x {own.shape[1]} heights, {own.cell:g} m apart from x {own.low[0]:g}, "
            f"y {own.low[1]:g} m", hint="ground.low, high and cell of the job say how large it is",
        )  # fmt: skip
    found = scanned_around(
        own, site.beyond, file, low=own.low, cell=own.cell, fill=job.ground.fill, map_origin=job.ground.map_origin,
        roughness=job.ground.roughness,
    )  # fmt: skip
    holes = found.unknown & np.isfinite(site.design_heights())
    if holes.any():
        x, y = site.nodes[holes][0].tolist()
        raise InputError(
            "does not cover what is dug", file=file, key=f"x {x:.2f} m, y {y:.2f} m",
            found=f"{int(holes.sum())} of its columns without a height",
            hint="ground.fill of the job says how far holes are filled from known columns [m]; or a larger ground.cell",
        )  # fmt: skip
    return found


def _design(job: Job, ground: Terrain) -> Design:
    trench, surface = job.dig.trench, job.dig.surface
    if trench is not None:
        return TrenchDesign(trench, _height_at(ground, np.array(trench.start), job))
    assert surface is not None
    file = job.folder / surface.file
    try:
        z = read_height_grid(file, fewest=1).heights
    except InputError as error:
        raise SceneError(str(error), file=job.file, key="dig.surface.file") from None
    if not np.isfinite(z).any():
        raise SceneError("does not say how deep to dig", file=file, found="no height in any cell")
    return SurfaceDesign(np.array(surface.low), surface.cell, z)


def _height_at(ground: Terrain, point: Vector, job: Job) -> float:
    if (point < ground.low).any() or (point > ground.high).any():
        raise SceneError(
            "lies beyond the ground that the job has", file=job.file, key="dig.trench.from", found=point.tolist(),
            allowed=f"{ground.low.tolist()} to {ground.high.tolist()}",
            hint="ground.low and ground.high say how far it goes",
        )  # fmt: skip
    row, column, _ = nearest_columns(point, ground.low, ground.cell, ground.shape)
    return float(ground.surface[row, column])
