"""A motion replayed in MuJoCo: its own model of the URDF and the site, its own kinematics and contacts.

The shapes come from the files by `raw_urdf` and `raw_obstacles`; none of the planner's own
geometry is used. MuJoCo takes a mesh as its convex hull, which closes a bucket or a channel:
a contact in a hull counts only if triangles of the mesh touch too, else it is counted as skipped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import mujoco
import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.convex_gaps import Body, least_pair
from validation.dense_sweep import link_bodies, past_link
from validation.link_pairs import Pairs, find_pairs
from validation.mujoco_model import DEEP, SITE, ModelDraft, site_body
from validation.raw_obstacles import read_obstacle, solid_of
from validation.raw_urdf import RawMachine, read_raw_urdf
from validation.scenes import scene_of
from validation.servo_drives import EPISODE, Episode
from validation.surfaces import LinkDistances

Shifts = Mapping[str, Vector]
"""(3,) displacement of each present obstacle [m]."""

_AWAY = np.array([0.0, 0.0, -1e3])  # m: the place of obstacles that have not appeared
_CHECKED = 10  # steps of a servo between two that are replayed


@dataclass(frozen=True)
class Contact:
    """A contact of two bodies, with the greatest depth and its time [m, s].

    Attributes
    ----------
    adjacent: two links with one joint between them that do not touch by construction.
    """

    link: str
    other: str
    depth: float
    time: float
    adjacent: bool = False


@dataclass(frozen=True)
class Replay:
    """The contacts found on a motion.

    Attributes
    ----------
    moments: number of those checked.
    contacts: one for every two bodies.
    skipped: pairs of bodies with a contact only in the hull of a mesh, of which no triangle touches.
    """

    moments: int
    contacts: tuple[Contact, ...]
    skipped: frozenset[tuple[str, str]] = frozenset()


class MujocoSite:
    """A machine and its surroundings as a MuJoCo model.

    Parameters
    ----------
    robot: only its file, its tip and the order of its joints are used.
    """

    def __init__(self, robot: bp.Robot, scene: bp.Scene) -> None:
        self.joints = robot.joint_names
        self.machine, self.bodies, self.pairs = _as_written(robot)
        records = [spec.model_dump(by_alias=True, exclude_none=True) for spec in scene.obstacles]
        records += [
            solid_of(zone.model_dump(by_alias=True, exclude_none=True))
            for zone in scene.zones
            if zone.kind in ("cab", "ceiling", "floor")  # a wall has two forms, a sector is no solid
        ]
        self.obstacles = {
            record["name"]: read_obstacle(record, folder=scene.folder, clearance=scene.clearance) for record in records
        }
        draft = ModelDraft(self.machine, self.joints)
        draft.exclude(self.pairs)
        for record in records:
            draft.obstacle(record, scene.folder)
        self._model = draft.spec.compile()
        self._data = mujoco.MjData(self._model)
        self._hollow = {int(self._model.geom(name).id) for name in draft.hollow}
        self._standing = {link for link, joint in self.machine.bodies(self.joints).items() if not joint}
        self._address = [int(self._model.joint(name).qposadr[0]) for name in self.joints]
        self._mocap = {name: int(self._model.body(site_body(name)).mocapid[0]) for name in self.obstacles}

    def replay(self, time: Vector, q: Matrix) -> Replay:
        """Place the machine at every moment (T,), q (T, n), and collect the contacts."""
        return self.replay_among(zip(time.tolist(), q, map(self._shifts, time.tolist()), strict=True))

    def replay_among(self, moments: Iterable[tuple[float, Vector, Shifts]]) -> Replay:
        """The same, with the displacements of the present obstacles at each moment."""
        worst: dict[tuple[str, str], Contact] = {}
        skipped: set[tuple[str, str]] = set()
        count = 0
        for moment, q, shifts in moments:
            count += 1
            for contact, in_hull in self._contacts(moment, q, shifts):
                names = contact.link, contact.other
                if names in worst and worst[names].depth >= contact.depth:
                    continue
                if in_hull and self._apart(contact, q, shifts):
                    skipped.add(names)
                    continue
                worst[names] = contact
        found = sorted(worst.values(), key=lambda contact: -contact.depth)
        return Replay(count, tuple(found), frozenset(skipped - worst.keys()))

    def _shifts(self, moment: float) -> Shifts:
        """The displacement of every obstacle that has appeared."""
        obstacles = self.obstacles.values()
        return {one.name: one.shift(np.array([moment]))[0] for one in obstacles if one.appears_at <= moment}

    def _contacts(self, moment: float, q: Vector, shifts: Shifts) -> list[tuple[Contact, bool]]:
        """The contacts, and whether each may be only in a hull."""
        model, data = self._model, self._data
        data.qpos[self._address] = q
        for name, body in self._mocap.items():
            data.mocap_pos[body] = shifts.get(name, _AWAY)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found = []
        for index in np.flatnonzero(data.contact.dist < -DEEP).tolist():
            geoms = data.contact.geom[index].tolist()
            names = [str(model.body(model.geom_bodyid[geom]).name) for geom in geoms]
            contact = self._contact(names, -float(data.contact.dist[index]), moment, shifts)
            if contact is not None:
                found.append((contact, not self._hollow.isdisjoint(geoms)))
        return found

    def _contact(self, names: list[str], depth: float, moment: float, shifts: Shifts) -> Contact | None:
        """The contact of two MuJoCo bodies; None if it does not count."""
        site = [name for name in names if name.startswith(SITE)]
        if site:
            (link,) = set(names) - set(site)
            obstacle = self.obstacles[site[0].removeprefix(SITE)]
            # a contact with a part that does not move is not the motion's fault
            if obstacle.name not in shifts or link in self._standing:
                return None
            if obstacle.links is not None and link not in obstacle.links:
                return None
            return Contact(link, obstacle.name, depth, moment)
        one, other = names
        pair = (one, other) if (one, other) in self.pairs.counted else (other, one)
        if pair not in self.pairs.counted:
            return None
        return Contact(*pair, depth, moment, adjacent=pair in self.pairs.adjacent)

    def _apart(self, contact: Contact, q: Vector, shifts: Shifts) -> bool:
        """Whether no triangles of the two bodies touch."""
        placed = self.machine.placements(dict(zip(self.joints, q[:, None], strict=True)), 1)
        link = self.bodies[contact.link]
        if contact.other in self.bodies:
            rotation, translation = past_link(placed, contact.link, contact.other)
            return least_pair(link, self.bodies[contact.other], rotation[0], translation[0])[0] > 0.0
        obstacle = self.obstacles[contact.other]
        rotation, translation = placed[contact.link]
        translation = translation - shifts[contact.other]
        if obstacle.body is None:
            return bool(min(obstacle.below_plane(part, rotation, translation)[0] for part in link.parts) > 0.0)
        return least_pair(link, obstacle.body, rotation[0], translation[0])[0] > 0.0


@lru_cache(maxsize=4)
def _as_written(robot: bp.Robot) -> tuple[RawMachine, dict[str, Body], Pairs]:
    machine = read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)
    bodies = link_bodies(machine)
    return machine, bodies, find_pairs(machine, bodies, robot.tip)


def replay(robot: bp.Robot, scene: bp.Scene, trajectory: bp.Trajectory, *, refine: int = 10) -> Replay:
    """Replay a motion at `refine` moments per sample."""
    time = trajectory.time
    parts = [np.linspace(a, b, refine, endpoint=False) for a, b in pairwise(time.tolist())]
    moments = np.concatenate([*parts, time[-1:]])
    return MujocoSite(robot, scene).replay(moments, trajectory.at(moments))


def replay_drives(robot: bp.Robot, *, episodes: int, seed: int) -> Iterator[tuple[str, Replay]]:
    """Drives of a servo by random wishes among obstacles that stand, appear and move, by their names."""
    distances = LinkDistances(robot)
    for number in range(episodes):
        episode = Episode(robot, distances, np.random.default_rng([seed, number]))
        seen: list[tuple[float, Vector, Shifts]] = []
        for step in range(EPISODE):
            state = episode.step(step)
            if step % _CHECKED == 0:
                shifts = {name: one.shift.copy() for name, one in episode.standing.items()}
                seen.append((state.time, state.q.copy(), shifts))
        # later obstacles are in the model from the beginning and ignored until they appear
        records = [one.spec.model_dump(by_alias=True, exclude_none=True) for one in episode.standing.values()]
        site = MujocoSite(robot, scene_of(robot, records, start=seen[0][1]))
        yield f"drive {number}", site.replay_among(seen)
