"""The bed of a truck: its load fills it up, slumps to the angle of repose, and ends at the walls.

At a wall the load is at most as high as the wall, and from there it rises inward no steeper than the angle of
repose. Soil that is poured in forms a cone as on the ground, cut off at that height: soil that would fall over a
wall moves to where there is room.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector, as_number, as_vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.ground.heaps import Refusal, level_for
from backhoe_planner.job.ground.obstacle import terrain_obstacle
from backhoe_planner.job.ground.terrain import REPOSE, Terrain
from backhoe_planner.site import Obstacle

_CELL = 0.05  # m, as for the ground
_LEAST, _MOST = 4 * _CELL, 30.0  # m: a smaller bed is not useful, and no truck has a larger one
_FULL_WITHIN = 1e-9  # m^3


@dataclass(frozen=True, eq=False)
class Bed:
    """The bed of a truck and its load.

    Attributes
    ----------
    position: (3,) middle of the floor [m], world.
    size: (3,) inner length along its own x, width along its own y, and height of the walls [m].
    yaw: rotation about z [rad].
    capacity: loose soil that the truck takes [m^3]; not more than the bed can hold heaped.
    load: the soil in it, in the axes of the bed: the floor is at z = 0, and its middle is the origin.
    """

    position: Vector
    size: Vector
    yaw: float
    capacity: float
    load: Terrain

    @classmethod
    def empty(
        cls, position: Sequence[float] | Vector, size: Sequence[float] | Vector, *, yaw: float = 0.0,
        capacity: float | None = None, repose: float = REPOSE,
    ) -> Bed:  # fmt: skip
        """A bed with nothing in it.

        Parameters
        ----------
        position, size, yaw: as in the class.
        capacity: loose soil that the truck takes [m^3]; by default all that the bed can hold.
        repose: the steepest slope of the load [rad].

        Raises
        ------
        InputError: an argument is not such a number, or the capacity is more than the bed can hold.
        """
        position, size = as_vector(position, 3, key="position"), as_vector(size, 3, key="size")
        if (size[:2] < _LEAST).any() or (size > _MOST).any() or size[2] <= 0.0:
            raise InputError(
                "is no bed", key="size", found=size.tolist(),
                allowed=f"{_LEAST:g} to {_MOST:g} m, walls higher than 0",
            )  # fmt: skip
        counts = np.floor(size[:2] / _CELL + _FULL_WITHIN).astype(int)
        low = -0.5 * _CELL * (counts - 1)
        load = Terrain.level(0.0, low, -low, _CELL, repose=repose)
        found = cls(position, size, as_number(yaw, key="yaw"), math.inf, load)
        most = float(found._highest().sum()) * _CELL**2
        if capacity is None:
            return replace(found, capacity=most)
        capacity = as_number(capacity, key="capacity", above=0.0)
        if capacity > most:
            allowed = beside_bounds(capacity, most, places=".6g", bounds_as=".2f")[1]
            raise InputError(
                "is more than the bed holds", key="capacity", found=capacity, allowed=f"up to {allowed} m^3"
            )
        return replace(found, capacity=capacity)

    @property
    def volume(self) -> float:
        """Loose soil in it [m^3]."""
        return self.load.loose_volume

    @property
    def room(self) -> float:
        """Loose soil that the truck can still take [m^3]."""
        return max(self.capacity - self.volume, 0.0)

    @property
    def placement(self) -> pin.SE3:
        """T_world_bed."""
        return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, self.yaw), np.asarray(self.position, dtype=float))

    def top_at(self, at: Sequence[float] | Vector) -> float:
        """Height z of the load or the floor at x, y (2,) [m], world.

        Raises
        ------
        InputError: the place is not in the bed.
        """
        place = np.clip(self._own(at), self.load.low, self.load.high)
        return float(self.position[2] + self.load.height_at(place))

    def loaded(self, at: Sequence[float] | Vector, volume: float) -> Bed | Refusal:
        """The bed after loose soil was poured into it, or why it cannot take the soil.

        Parameters
        ----------
        at: (2,) x, y [m], world.
        volume: loose volume [m^3].

        Raises
        ------
        InputError: an argument is not such a number, or the place is not in the bed.
        """
        place = self._own(at)
        volume = as_number(volume, key="volume", least=0.0)
        if volume > self.room + _FULL_WITHIN:
            return Refusal(
                f"the truck is full: it holds {self.volume:.2f} of {self.capacity:.2f} m^3, "
                f"and there is no room for {volume:.2f} m^3 more",
                self.room,
            )
        start = self.load.loose + math.tan(self.load.repose) * np.hypot(
            self.load.x[None, :] - place[0], self.load.y[:, None] - place[1]
        )
        most = np.maximum(self._highest() - self.load.loose, 0.0)
        apex = level_for(start, most, volume / self.load.cell**2)
        raised = np.clip(apex - start, 0.0, most)
        return replace(self, load=self.load.with_layers(self.load.bank, self.load.loose + raised))

    def load_obstacle(self, name: str, clearance: float, *, before: Obstacle | None = None) -> Obstacle:
        """The load or the bare floor as an obstacle; parameters as in `terrain_obstacle`."""
        if before is not None and check_kind(before, Obstacle, key="before").cluster is not None:
            assert before.cluster is not None
            before = replace(
                before, cluster=before.cluster.moved_to(self.placement.inverse() * before.cluster.placement)
            )
        found = terrain_obstacle(self.load, name, clearance, before=before)
        assert found.cluster is not None
        place = self.placement * found.cluster.placement
        spec = found.spec.model_copy(
            update={"position": tuple(place.translation.tolist()), "rpy": (0.0, 0.0, self.yaw)}
        )
        return replace(found, cluster=found.cluster.moved_to(place), spec=spec)

    def _highest(self) -> Matrix:
        """(rows, columns) greatest possible height of the load [m]."""
        away = np.minimum(
            0.5 * self.size[0] - np.abs(self.load.x)[None, :], 0.5 * self.size[1] - np.abs(self.load.y)[:, None]
        )
        return np.asarray(self.size[2] + math.tan(self.load.repose) * away)

    def _own(self, at: Sequence[float] | Vector) -> Vector:
        """(2,) a place in the axes of the bed [m]."""
        place = self.placement.actInv(np.array([*as_vector(at, 2, key="at"), 0.0]))[:2]
        if (np.abs(place) > 0.5 * self.size[:2]).any():
            raise InputError(
                "is not in the bed", key="at", found=np.asarray(at, dtype=float).tolist(),
                allowed=f"within {self.size[0]:g} x {self.size[1]:g} m around {self.position[:2].tolist()}",
            )  # fmt: skip
        return np.asarray(place)
