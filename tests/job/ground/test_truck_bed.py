"""The capacity of a truck's bed by hand, and the place of its load in the world."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.errors import InputError
from backhoe_planner.job import Bed, Refusal
from backhoe_planner.machine.shape import shapes

TAN = math.tan(0.6)


def bed(**keys: float) -> Bed:
    return Bed.empty((3.0, 2.0, 1.0), (4.0, 2.0, 0.8), yaw=0.5, repose=0.6, **keys)


def place(x: float, y: float) -> np.ndarray:
    """World x, y of a place given in the axes of the bed."""
    return np.asarray(bed().placement.act(np.array([x, y, 0.0]))[:2])


def loaded(one: Bed, at: np.ndarray, volume: float) -> Bed:
    found = one.loaded(at, volume)
    assert isinstance(found, Bed)
    return found


def test_a_bed_turned_by_its_yaw_lies_where_a_hand_calculation_puts_it() -> None:
    """1.9 m along its own x is at 3 + 1.9 cos 0.5, 2 + 1.9 sin 0.5: counter-clockwise seen from above."""
    ahead = np.array([3.0 + 1.9 * math.cos(0.5), 2.0 + 1.9 * math.sin(0.5)])
    found = loaded(bed(), ahead - 0.2 * np.array([math.cos(0.5), math.sin(0.5)]), 0.1)
    row, column = np.unravel_index(int(np.argmax(found.load.loose)), found.load.shape)
    assert found.load.x[column] == pytest.approx(1.7, abs=0.03)
    assert found.load.y[row] == pytest.approx(0.0, abs=0.03)
    obstacle = found.load_obstacle("load", 0.1)
    assert obstacle.spec.model_dump()["rpy"] == (0.0, 0.0, 0.5)
    with pytest.raises(InputError, match="is not in the bed"):
        bed().top_at((ahead[0], 2.0 - 1.9 * math.sin(0.5)))


def test_a_beds_capacity_includes_a_hipped_roof_above_its_walls() -> None:
    # struck 6.4 m^3, and a roof of half the width, hipped on all sides: w^2 (3 L - w) / 12 tan
    roof = 2.0**2 * (3.0 * 4.0 - 2.0) / 12.0 * TAN
    assert bed().capacity == pytest.approx(6.4 + roof, rel=0.01)
    assert bed(capacity=5.0).room == 5.0
    with pytest.raises(InputError, match=r"more than the bed holds; found 20\.0; allowed: up to 8\.6"):
        bed(capacity=20.0)


def test_a_first_bucketful_is_a_cone_on_the_floor() -> None:
    found = loaded(bed(), place(0.5, 0.0), 0.2)
    height = (0.6 * TAN**2 / math.pi) ** (1.0 / 3.0)
    assert found.volume == pytest.approx(0.2, rel=1e-9)
    assert found.top_at(place(0.5, 0.0)) == pytest.approx(1.0 + height, abs=0.05 * TAN)  # halfway between two columns
    assert found.top_at(place(-0.5, 0.0)) == pytest.approx(1.0)


def test_a_bed_fills_to_the_brim_and_no_further() -> None:
    one, rng, total = bed(), np.random.default_rng(2), 0.0
    most = one.load.shape
    while True:
        at = place(*(rng.uniform([-1.8, -0.8], [1.8, 0.8])))
        after = one.loaded(at, 0.4)
        if isinstance(after, Refusal):
            break
        assert (after.load.loose >= one.load.loose).all()
        one, total = after, total + 0.4
        assert one.volume == pytest.approx(total, rel=1e-9)
        z = one.load.loose
        for axis in (0, 1):
            assert np.abs(np.diff(z, axis=axis)).max() <= 0.05 * TAN * 1.001
        assert max(z[0].max(), z[-1].max(), z[:, 0].max(), z[:, -1].max()) <= 0.8 + 0.025 * TAN + 1e-9
    assert total > 8.0
    assert after.room == pytest.approx(one.capacity - total)
    assert f"holds {total:.2f} of {one.capacity:.2f} m^3" in after.reason
    full = loaded(one, place(0.0, 0.0), one.room)
    assert full.room == pytest.approx(0.0, abs=1e-9)
    assert full.load.loose.max() == pytest.approx(0.8 + TAN, rel=0.05)
    assert full.load.shape == most


def test_the_load_of_a_bed_is_an_obstacle() -> None:
    ball = shapes.sphere(0.1, pin.SE3.Identity())
    first = bed().load_obstacle("load", 0.1)
    full = loaded(bed(), place(0.0, 0.0), 8.0)
    load = full.load_obstacle("load", 0.1, before=first)
    for one, top in ((first, 1.0), (load, full.top_at(place(0.8, 0.3)))):
        assert one.cluster is not None
        found = one.cluster.measure(ball, pin.SE3(np.eye(3), np.array([*place(0.8, 0.3), 4.0])))
        assert found is not None
        assert found.distance <= 3.9 - top + 1e-9
        assert found.distance >= (3.9 - top) * math.cos(0.6) - 0.06
    flat = first.cluster.measure(ball, pin.SE3(np.eye(3), np.array([*place(0.8, 0.3), 4.0])))  # type: ignore[union-attr]
    assert flat is not None
    assert flat.distance == pytest.approx(2.9, abs=1e-9)


def test_impossible_beds_and_places_outside_a_bed_are_refused() -> None:
    with pytest.raises(InputError, match="is no bed"):
        Bed.empty((0.0, 0.0, 0.0), (0.1, 2.0, 0.5))
    with pytest.raises(InputError, match="is no bed"):
        Bed.empty((0.0, 0.0, 0.0), (1e3, 1e3, 0.5))
    with pytest.raises(InputError, match="is not in the bed"):
        bed().loaded((0.0, 0.0), 0.2)
