"""The volume of designs on a grid equals that of their geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job.schema.work import Trench
from backhoe_planner.job.worksite.design import Design, SurfaceDesign, TrenchDesign


def volume(design: Design, low: Vector, cell: float, z: float = 0.0) -> float:
    """The volume between level ground at `z` and the design [m^3]."""
    x, y = (low[axis] + cell * np.arange(int(12.0 / cell)) for axis in (0, 1))
    share, height = design.columns(x, y, cell)
    assert (np.isfinite(height) == (share > 0.0)).all()
    assert share.max() <= 1.0
    return float(np.nansum(share * (z - height))) * cell**2


def trench(start: Matrix | tuple[float, float], end: Matrix | tuple[float, float], **keys: float) -> TrenchDesign:
    content = {"from": tuple(map(float, start)), "to": tuple(map(float, end)), "width": 0.6, "depth": 1.2} | keys
    return TrenchDesign(Trench.model_validate(content), 0.0)


def test_a_trench_of_three_metres_has_its_geometric_volume() -> None:
    found = volume(trench((4.9, 0.0), (1.9, 0.0)), np.array([-1.0, -6.0]), 0.05)
    assert found == pytest.approx(3.0 * 0.6 * 1.2, rel=1e-9)


@pytest.mark.long
def test_oblique_sloping_trenches_have_their_geometric_volume_on_any_columns() -> None:
    rng = np.random.default_rng(11)
    for _ in range(12):
        start, turn, length = rng.uniform(-1.5, 1.5, 2), rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.5, 4.0)
        width, depth, slope, cell = rng.uniform([0.3, 0.5, -0.1, 0.02], [1.5, 2.0, 0.2, 0.1])
        end = start + length * np.array([math.cos(turn), math.sin(turn)])
        design = trench(start, end, width=width, depth=depth, slope=slope)
        wanted = length * width * (depth + 0.5 * slope * length)
        assert volume(design, rng.uniform(-6.1, -6.0, 2), cell) == pytest.approx(wanted, rel=1e-9)


def test_a_surface_with_holes_has_its_geometric_volume_on_columns_of_other_sizes() -> None:
    z = np.array([[-0.5, -0.3, np.nan], [-0.4, -0.2, -0.1]])
    design = SurfaceDesign(np.array([0.13, 0.41]), 0.2, z)
    assert volume(design, np.array([-3.0, -3.0]), 0.05) == pytest.approx(0.2**2 * 1.5, rel=1e-9)
    assert volume(design, np.array([-3.0, -3.0]), 0.07) == pytest.approx(0.2**2 * 1.5, rel=1e-9)
