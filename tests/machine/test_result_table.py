"""Results that are read all at once, compared with coal's result for each pair."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Indices, Matrix
from backhoe_planner.machine import Robot, geometry_model
from backhoe_planner.machine.shape import result_table, shapes
from backhoe_planner.machine.shape.result_table import ResultTable


def world(robot: Robot, *, seed: int) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """The machine's pieces, and balls and boxes around and in them, all paired with all."""
    rng, model = np.random.default_rng(seed), geometry_model(robot, pieces=robot.pieces)
    own = model.ngeoms
    for index in range(20):
        place = pin.SE3(np.eye(3), rng.normal(size=3) * [3.0, 3.0, 1.0])
        piece = shapes.sphere(0.3, place) if index % 2 else shapes.box(np.array([0.5, 0.3, 0.4]), place)
        model.addGeometryObject(pin.GeometryObject(f"body {index}", 0, 0, piece.placement, piece.shape))
        for link in range(own):
            model.addCollisionPair(pin.CollisionPair(link, own + index))
    data = model.createData()
    for request in data.distanceRequests:
        shapes.prepare(request)
    return model, data


def said_by_coal(data: pin.GeometryData, pairs: Indices) -> Matrix:
    rows = []
    for pair in pairs.tolist():
        result = data.distanceResults[pair]
        rows.append([result.min_distance, *result.normal, *result.getNearestPoint1(), *result.getNearestPoint2()])
    return np.array(rows).reshape(-1, 10)


@pytest.mark.parametrize("at_once", [True, False])
def test_table_entries_equal_coals_result_for_each_pair(
    backhoe: Robot, at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if at_once:
        assert result_table._bytes_of_a_result() is not None, "the results of this version can be read at once"
    else:
        monkeypatch.setattr(result_table, "_bytes_of_a_result", lambda: None)
    model, data = world(backhoe, seed=1)
    table, rng, joints = ResultTable(model, data), np.random.default_rng(2), backhoe.model.createData()
    inside = 0
    for _ in range(10):
        pin.forwardKinematics(backhoe.model, joints, backhoe.random_q(rng))
        pin.updateGeometryPlacements(backhoe.model, joints, model, data)
        pairs = rng.permutation(len(model.collisionPairs))[: rng.integers(0, 100)]
        found, expected = table.measure(pairs), said_by_coal(data, pairs)
        np.testing.assert_array_equal(found, expected)
        again = [shapes.measure(model, data, pair).min_distance for pair in pairs.tolist()]
        np.testing.assert_allclose(found[:, 0], again, atol=1e-9)
        np.testing.assert_allclose(table.measure_all()[pairs], again, atol=1e-9)
        inside += int((found[:, 0] < 0.0).sum())
        table.measure(pairs[:1])
        np.testing.assert_array_equal(found, expected, err_msg="a later measurement leaves it alone")
    assert inside > 0


def test_flush_faces_are_measured_again(monkeypatch: pytest.MonkeyPatch, backhoe: Robot) -> None:
    """Two boxes with a common face have distance 0 within rounding."""
    model = pin.GeometryModel()
    for index in range(2):
        piece = shapes.box(np.array([0.2, 0.4, 0.6]), pin.SE3(np.eye(3), np.array([0.2 * index, 0.0, 0.0])))
        model.addGeometryObject(pin.GeometryObject(f"box {index}", 0, 0, piece.placement, piece.shape))
    model.addCollisionPair(pin.CollisionPair(0, 1))
    data = model.createData()
    shapes.prepare(data.distanceRequests[0])
    pin.updateGeometryPlacements(backhoe.model, backhoe.model.createData(), model, data)
    again = []

    def measured_again(model: pin.GeometryModel, data: pin.GeometryData, pair: int) -> object:
        again.append(pair)
        return shapes.measure_pair_again(model, data, pair)

    monkeypatch.setattr(result_table, "measure_pair_again", measured_again)
    found = ResultTable(model, data).measure(np.array([0]))
    assert abs(found[0, 0]) < 1e-8
    assert again == [0]
