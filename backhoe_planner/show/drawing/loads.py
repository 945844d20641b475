"""The loads that the machine carries in some legs of a sequence, as triangles that move with its tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from backhoe_planner.arrays import Flags, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.show.drawing.solids import Facets, facets, solid


@dataclass(frozen=True, eq=False)
class LoadMesh:
    """The drawing of a load.

    Attributes
    ----------
    name: name of the load.
    legs: names of the legs in which it is carried.
    joint: index of the Pinocchio joint that moves it.
    facets: triangles in the frame of that joint [m].
    anchor: (3,) position of its label, in the same frame [m].
    """

    name: str
    legs: tuple[str, ...]
    joint: int
    facets: Facets
    anchor: Vector

    def carried_in(self, legs: tuple[str, ...]) -> Flags:
        """(F,) whether the load is carried in each of these legs."""
        return np.array([leg in self.legs for leg in legs], dtype=bool)


def load_meshes(problem: Problem) -> tuple[LoadMesh, ...]:
    """The drawings of the loads of a sequence; legs that carry the same load share one."""
    specs = [leg.carries for leg in problem.scene.task.sequence or ()]
    found = []
    for index, (spec, leg) in enumerate(zip(specs, problem.legs, strict=False)):
        if leg.robot.carried is None or spec in specs[:index]:
            continue
        name, shapes = leg.robot.carried
        pieces = leg.robot.pieces[-len(shapes) :]
        drawn = facets(trimesh.util.concatenate([solid(piece.piece) for piece in pieces]))
        legs = tuple(other.name for other, same in zip(problem.legs, specs, strict=False) if same == spec)
        middle = 0.5 * (drawn.vertices.min(axis=0) + drawn.vertices.max(axis=0))
        found.append(LoadMesh(name, legs, pieces[0].joint, drawn, middle))
    return tuple(found)
