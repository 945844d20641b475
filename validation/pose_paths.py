"""Paths of full poses on redundant arms, of the kinds by which path planners are usually measured.

The kinds follow the sets of TORM (Kang et al. 2020) and CppFlow (Morgan et al. 2024): written
words, circles, squares and an S, turns on the spot, paths around one and two cubes and between
poles; 200 to 1,000 waypoints, each with position and orientation. Every problem is drawn from its
own seed. On ``beyond``, ``corner`` and ``inside`` one waypoint is impossible on purpose: far out of
reach, a corner a few millimetres out of reach, or within a block.
"""

from __future__ import annotations

import resource
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import backhoe_planner as bp
from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import TURN_LEVER
from validation.dense_layers import DenseLayers
from validation.obstacles import Record
from validation.pose_arms import ARMS, write_arm
from validation.scenes import scene_of
from validation.tables import Row

MACHINES = ARMS
TOLERANCE = 0.001  # m
_ROTATION_TOLERANCE = np.radians(0.1)
_LONGEST_STEP = np.radians(7.0)  # of a joint from waypoint to waypoint
_OUT_OF_REACH = 0.003  # m by which a corner is out of reach
_BESIDE = 40  # waypoints before that corner that may be out of reach too: 7 cm and more
_CLEARANCE = 0.01  # m of every obstacle
_PLACES = 400  # draws of a path's place until its poses can be reached clear of everything
_LOOKED_AT = 40  # poses of a path checked for each draw
_GUESSES = 24  # for each of these poses
_AHEAD = 2.0  # times the way from waypoint to waypoint, within which the next is searched; and 1 cm


@dataclass(frozen=True)
class Shape:
    """A path drawn in its own frame: x and y across the tool, z along it.

    Attributes
    ----------
    points: (K, 3) corners [m].
    turns: (K,) orientations at the corners, relative to the tool's.
    waypoints: their number on the path.
    blocks: obstacles in this frame.
    """

    points: Matrix
    turns: Rotation
    waypoints: int
    blocks: tuple[Record, ...] = ()


@dataclass(frozen=True)
class Problem:
    """One problem.

    Attributes
    ----------
    impossible: the number of the first waypoint that cannot be reached, from 1; None if none is known.
    """

    kind: str
    machine: str
    robot: bp.Robot
    scene: bp.Scene
    impossible: int | None = None


@dataclass(frozen=True)
class Result:
    """The result of planning one problem.

    Attributes
    ----------
    seconds: processor time [s]; memory: peak of the process [MB].
    step: the largest change of a joint between successive waypoints [rad or m].
    off: greatest distance of a waypoint from the motion [m], a radian as 0.25 m.
    duration: of the motion [s].
    together: whether the configurations are connected, for a plan not verified without an impossible waypoint.
    """

    kind: str
    machine: str
    waypoints: int
    verdict: str
    reason: str
    message: str
    seconds: float
    memory: float
    step: float
    off: float
    duration: float
    together: bool | None = None

    @property
    def row(self) -> Row:
        """As a row of a table."""
        return {
            "problem": self.kind, "machine": self.machine, "waypoints": self.waypoints,
            "verdict": self.verdict, "reason": self.reason or "-", "time [s]": self.seconds,
            "memory [MB]": self.memory, "step [rad]": self.step, "off [mm]": 1e3 * self.off,
            "duration [s]": self.duration,
        }  # fmt: skip


# --- shapes ---------------------------------------------------------------------------


def _still(points: Sequence[Sequence[float]] | Matrix, waypoints: int, blocks: Sequence[Record] = ()) -> Shape:
    points = np.asarray(points, dtype=float)
    if points.shape[1] == 2:
        points = np.column_stack((points, np.zeros(len(points))))
    return Shape(points, Rotation.identity(len(points)), waypoints, tuple(blocks))


def _circle(rng: np.random.Generator) -> Shape:
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    return _still(rng.uniform(0.1, 0.18) * np.column_stack((np.cos(angle), np.sin(angle))), 400)


def _square(rng: np.random.Generator) -> Shape:
    a = rng.uniform(0.1, 0.15)
    return _still([(a, a), (-a, a), (-a, -a), (a, -a), (a, a)], 500)


def _ess(rng: np.random.Generator) -> Shape:
    angle = np.linspace(0.0, 1.5 * np.pi, 60)
    upper = np.column_stack((np.cos(angle), 1.0 + np.sin(angle)))
    return _still(rng.uniform(0.07, 0.1) * np.vstack((upper, -upper[-2::-1])), 300)


def _word(rng: np.random.Generator) -> Shape:
    """``hel``, stroke by stroke; the pen is lifted between letters."""
    letters = [
        [[(0, 0), (0, 2)], [(0, 1), (1, 1)], [(1, 2), (1, 0)]],
        [[(1, 0), (0, 0), (0, 2), (1, 2)], [(0, 1), (1, 1)]],
        [[(0, 2), (0, 0), (1, 0)]],
    ]
    points: list[tuple[float, float, float]] = []
    size, lift = rng.uniform(0.06, 0.09), 0.02
    for place, strokes in enumerate(letters):
        for stroke in strokes:
            flat = [(size * (x + 1.5 * place - 2.0), size * (y - 1.0)) for x, y in stroke]
            points += [(*flat[0], -lift), *((x, y, 0.0) for x, y in flat), (*flat[-1], -lift)]
    return _still(points, 1000)


def _turn(rng: np.random.Generator) -> Shape:
    """Turns on the spot about two axes of the tool, there and back."""
    far = rng.uniform(0.5, 0.8)
    angles = [(0, 0, 0), (0, far, 0), (0, -far, 0), (0, 0, 0), (0, 0, far), (0, 0, -far), (0, 0, 0)]
    return Shape(np.zeros((len(angles), 3)), Rotation.from_rotvec(np.array(angles)), 200)


def _tilting(rng: np.random.Generator) -> Shape:
    """A circle on which the tool tilts outward."""
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    radius, tilt = rng.uniform(0.08, 0.12), rng.uniform(0.3, 0.5)
    flat = np.column_stack((np.cos(angle), np.sin(angle), 0.0 * angle))
    across = np.column_stack((-np.sin(angle), np.cos(angle), 0.0 * angle))
    return Shape(radius * flat, Rotation.from_rotvec(tilt * across), 500)


def _cube(name: str, size: float, x: float, y: float, z: float) -> Record:
    return {"name": name, "shape": "box", "size": [size] * 3, "position": [x, y, z]}


def _one_cube(rng: np.random.Generator) -> Shape:
    """A curve around a cube beside the tool."""
    size = rng.uniform(0.06, 0.1)
    off = 0.5 * size + 0.1
    points = [(-0.2, 0.0), (-off, 0.0), (-off, off), (off, off), (off, 0.0), (0.2, 0.0)]
    return _still(points, 300, [_cube("cube", size, 0.0, 0.0, rng.uniform(-0.03, 0.03))])


def _two_cubes(rng: np.random.Generator) -> Shape:
    size, apart = rng.uniform(0.04, 0.05), rng.uniform(0.15, 0.17)
    points = [(-0.3, 0), (-apart, 0.15), (0, 0), (apart, -0.15), (0.3, 0), (0.3, 0.11), (0, 0.11)]
    cubes = [_cube("left cube", size, -apart, 0, 0.0), _cube("right cube", size, apart, 0, 0.0)]
    return _still(points, 600, cubes)


def _poles(rng: np.random.Generator) -> Shape:
    """A winding path between poles in a row along y."""
    spacing, high = rng.uniform(0.13, 0.16), 0.12
    points, poles = [], []
    for number in range(4):
        x, side = spacing * (number - 1.5), 1.0 if number % 2 else -1.0
        points += [(x, side * high)]
        y = -side * (high + rng.uniform(0.06, 0.1))
        poles.append({"name": f"pole {number + 1}", "shape": "box", "size": [0.03, 0.2, 0.03], "position": [x, y, 0.0]})
    return _still(points, 400, poles)


KINDS: dict[str, Callable[[np.random.Generator], Shape]] = {
    "word": _word, "circle": _circle, "square": _square, "ess": _ess, "turn": _turn, "tilting": _tilting,
    "one cube": _one_cube, "two cubes": _two_cubes, "poles": _poles,
}  # fmt: skip
IMPOSSIBLE = ("beyond", "corner", "inside")


# --- problems -------------------------------------------------------------------------


def load_arm(machine: str, folder: Path) -> bp.Robot:
    """One of `MACHINES`; its URDF is written into `folder`."""
    return bp.load_robot(write_arm(machine, folder))


def draw(kind: str, robot: bp.Robot, machine: str, seed: int) -> Problem:
    """The problem of a kind (of `KINDS` or `IMPOSSIBLE`) for a machine and a seed."""
    rng = np.random.default_rng((seed, zlib.crc32(f"{kind}/{machine}".encode())))
    shape = KINDS[kind if kind in KINDS else "square"](rng)
    points, turns = densely(shape)
    for _ in range(_PLACES):
        tool = Rotation.from_euler("ZY", [rng.uniform(-0.6, 0.6), rng.uniform(0.5 * np.pi, 0.95 * np.pi)])
        tool = tool * Rotation.from_euler("Z", rng.uniform(-np.pi, np.pi))
        turn = rng.uniform(-1.2, 1.2)
        out = rng.uniform(0.4, 0.62)
        middle = np.array([out * np.cos(turn), out * np.sin(turn), rng.uniform(0.25, 0.75)])
        tool = Rotation.from_euler("Z", turn) * tool
        positions, rotations = middle + tool.apply(points), tool * turns
        blocks = [_placed(block, middle, tool) for block in shape.blocks]
        corners = np.linalg.norm(points[:, None] - shape.points[None], axis=2).min(axis=1) < 1e-9
        if _can_be_reached(robot, blocks, positions, rotations, corners):
            break
    else:
        raise RuntimeError(f"no place for {kind} on {machine}, seed {seed}")
    impossible = None
    if kind == "beyond":
        # a side of the square is moved out of reach; its corner is the first waypoint there
        first, last = int(0.4 * len(positions)), int(0.6 * len(positions))
        positions[first:last] += 1.6 * positions[first] / np.linalg.norm(positions[first])
        impossible = first + 1
    if kind == "corner":
        positions, impossible = _with_a_corner_out_of_reach(robot, positions, rotations, corners)
    if kind == "inside":
        first = int(0.5 * len(positions))
        blocks.append({"name": "block", "shape": "box", "size": [0.08] * 3, "position": positions[first].tolist()})
        near = np.max(np.abs(positions - positions[first]), axis=1) <= 0.04 + _CLEARANCE
        impossible = int(np.argmax(near)) + 1
    return Problem(kind, machine, robot, _scene(robot, f"{kind}, {machine}", blocks, positions, rotations), impossible)


def _scene(robot: bp.Robot, name: str, blocks: Sequence[Record], positions: Matrix, rotations: Rotation) -> bp.Scene:
    quaternions = rotations.as_quat()[:, [3, 0, 1, 2]]
    waypoints = [
        {"position": p, "quaternion": q} for p, q in zip(positions.tolist(), quaternions.tolist(), strict=True)
    ]
    path: Record = {
        "waypoints": waypoints, "tolerance": TOLERANCE, "rotation_tolerance": _ROTATION_TOLERANCE,
        "max_joint_step": _LONGEST_STEP, "detour": False,
    }  # fmt: skip
    rest: Record = {"clearance": _CLEARANCE, "influence": 0.2, "tip": robot.tip, "name": name}
    return scene_of(robot, blocks, start=None, task={"path": path}, **rest)


def densely(shape: Shape) -> tuple[Matrix, Rotation]:
    """(W, 3) positions and as many orientations, evenly along a shape."""
    moved = np.linalg.norm(np.diff(shape.points, axis=0), axis=1)
    turned = TURN_LEVER * (shape.turns[:-1].inv() * shape.turns[1:]).magnitude()
    measure = np.concatenate(([0.0], np.cumsum(np.maximum(moved, turned))))
    # the corners are waypoints too
    at = np.unique(np.concatenate((np.linspace(0.0, measure[-1], shape.waypoints - len(measure) + 2), measure)))
    at = at[np.concatenate(([True], np.diff(at) > 1e-9))]  # rounding may duplicate a waypoint
    points = np.column_stack([np.interp(at, measure, column) for column in shape.points.T])
    return points, Slerp(measure, shape.turns)(at)


def _placed(block: Record, middle: Vector, tool: Rotation) -> Record:
    position = middle + tool.apply(np.array(block["position"]))
    return {**block, "position": position.tolist(), "rpy": tool.as_euler("xyz").tolist()}


def _with_a_corner_out_of_reach(
    robot: bp.Robot, positions: Matrix, rotations: Rotation, corners: Flags
) -> tuple[Matrix, int]:
    """A path moved away until a corner is out of reach, and the number of the first waypoint that is, from 1."""
    outward = np.mean(positions, axis=0) * (1.0, 1.0, 0.0)
    outward /= np.linalg.norm(outward)

    def beyond(far: float, rows: Indices) -> Flags:
        return np.asarray(~_solve(robot, positions[rows] + far * outward, rotations[rows])[1].any(axis=1))

    at = np.flatnonzero(corners)
    low, high = 0.0, 1.5
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if beyond(middle, at).any() else (middle, high)
    out = high + _OUT_OF_REACH
    corner = int(at[np.argmax(beyond(out, at))])
    before = np.arange(max(corner - _BESIDE, 0), corner + 1)
    return positions + out * outward, int(before[np.argmax(beyond(out, before))]) + 1


def _solve(robot: bp.Robot, positions: Matrix, rotations: Rotation) -> tuple[Array, Flags]:
    """(W, G, n) the ends of the search for each pose from each of G guesses; (W, G) whether it arrived."""
    turns = rotations.as_matrix()
    targets = [TipTarget(position, None, turn) for position, turn in zip(positions, turns, strict=True)]
    rng = np.random.default_rng(0)
    guesses = np.array([robot.random_q(rng) for _ in range(_GUESSES)])
    batch = TargetBatch.of(targets).take(np.repeat(np.arange(len(targets)), len(guesses)))
    q, reached = solve_batch(BatchKinematics(robot), batch, np.tile(guesses, (len(targets), 1)))
    return q.reshape(len(targets), len(guesses), -1), reached.reshape(len(targets), len(guesses))


def _can_be_reached(
    robot: bp.Robot, blocks: Sequence[Record], positions: Matrix, rotations: Rotation, corners: Flags
) -> bool:
    """Whether some poses of a path, with its corners, can each be reached clear of everything."""
    some = np.unique(np.append(np.linspace(0, len(positions) - 1, _LOOKED_AT).astype(int), np.flatnonzero(corners)))
    q, arrived = _solve(robot, positions[some], rotations[some])
    if not arrived.any(axis=1).all():
        return False
    scene = scene_of(robot, blocks, start=robot.middle, clearance=_CLEARANCE)
    proximity = bp.Proximity(robot, bp.build_obstacles(scene, robot))
    least = proximity.clearance + 0.005
    for own, good in zip(q, arrived, strict=True):
        if not any(bool((proximity.distances(one) > least).all()) for one in own[good]):
            return False
    return True


# --- results ---------------------------------------------------------------------------


def solve(problem: Problem, *, seed: int = 0) -> Result:
    """Plan a problem; measure processor time and the memory of the whole process."""
    begun = time.process_time()
    plan = bp.plan(problem.robot, problem.scene, seed=seed)
    seconds = time.process_time() - begun
    path = problem.scene.task.path
    assert path is not None
    assert path.waypoints is not None
    step, off, duration, together = float("nan"), float("nan"), float("nan"), None
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    if plan.verified:
        step, off = waypoint_steps(problem, plan.trajectory.q)
        duration = plan.metrics.duration
    elif problem.kind not in IMPOSSIBLE:
        together = DenseLayers(problem.robot, problem.scene).hang_together
    return Result(
        problem.kind, problem.machine, len(path.waypoints), plan.verdict, plan.reason, plan.message, seconds,
        memory, step, off, duration, together,
    )  # fmt: skip


def waypoint_steps(problem: Problem, q: Matrix) -> tuple[float, float]:
    """The largest change of a joint between waypoints, and the largest distance of a waypoint from the motion.

    Parameters
    ----------
    q: (T, n) the motion's samples, with straight joint motions between them [rad or m].

    Returns
    -------
    [rad or m]; [m], a radian as 0.25 m.
    """
    path = problem.scene.task.path
    assert path is not None
    assert path.waypoints is not None
    targets = [waypoint.target for waypoint in path.waypoints]
    wanted = np.array([_vector(target.position, target.rotation) for target in targets])
    at = BatchKinematics(problem.robot).at(q)
    poses = np.array([_vector(p, R) for p, R in zip(at.tip_position, at.tip_rotation, strict=True)])
    span = np.diff(poses, axis=0)
    square = np.maximum(np.einsum("ti,ti->t", span, span), 1e-18)
    gone = np.concatenate(([0.0], np.cumsum(np.sqrt(square))))
    ways = np.linalg.norm(np.diff(wanted, axis=0, prepend=wanted[:1]), axis=1)
    joints, off, here = [], 0.0, 0.0
    for pose, way in zip(wanted, ways.tolist(), strict=True):
        first = min(int(here), len(span) - 1)
        behind = int(np.searchsorted(gone, gone[first] + _AHEAD * way + 10.0 * TOLERANCE))
        rows = np.arange(first, min(behind + 1, len(span)))
        part = np.einsum("ti,ti->t", pose - poses[rows], span[rows]) / square[rows]
        part = np.clip(part, np.where(rows == first, min(here - first, 1.0), 0.0), 1.0)
        away = np.linalg.norm(poses[rows] + part[:, None] * span[rows] - pose, axis=1)
        best = int(np.argmax(away <= np.min(away) + 0.1 * TOLERANCE))
        off = max(off, float(away[best]))
        here = float(rows[best] + part[best])
        joints.append(q[rows[best]] + part[best] * (q[rows[best] + 1] - q[rows[best]]))
    return float(np.max(np.abs(np.diff(joints, axis=0)))), off


def _vector(position: Vector, rotation: Matrix | None) -> Vector:
    """(12,) position and orientation, with the usual distance: a radian counts as 0.25 m."""
    assert rotation is not None
    return np.concatenate((position, TURN_LEVER / np.sqrt(2.0) * rotation.ravel()))


def summarise(results: Sequence[Result]) -> list[Row]:
    """The figures of every machine, of the possible and of the impossible problems."""
    rows: list[Row] = []
    for machine in dict.fromkeys(result.machine for result in results):
        for impossible in (False, True):
            own = [r for r in results if r.machine == machine and (r.kind in IMPOSSIBLE) == impossible]
            if own:
                seconds = [r.seconds for r in own]
                rows.append({
                    "machine": machine, "problems": "impossible" if impossible else "possible", "number": len(own),
                    "verified": sum(r.verdict == "verified" for r in own),
                    "no way": sum(r.together is False for r in own), "median [s]": float(np.median(seconds)),
                    "most [s]": max(seconds), "memory [MB]": max(r.memory for r in own),
                })  # fmt: skip
    return rows
