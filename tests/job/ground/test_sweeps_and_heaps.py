"""The soil taken by a blade and the shape of loose soil: by hand, and conservation of volume."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backhoe_planner.arrays import Flags
from backhoe_planner.errors import InputError
from backhoe_planner.job import BladeSweep, Refusal, Sweep, Terrain, deposited, heap_room, slumped, swept

WIDTH, LENGTH = 0.6, 1.2


def flat(z: float = 0.0, repose: float = 0.6, swell: float = 1.25) -> Terrain:
    return Terrain.level(z, (0.0, -3.0), (6.0, 3.0), 0.05, repose=repose, swell=swell)


def heap(terrain: Terrain, at: tuple[float, float], volume: float, clear_of: Flags | None = None) -> Terrain:
    found = deposited(terrain, at, volume, clear_of=clear_of)
    assert isinstance(found, Terrain)
    return found


def box_cut(terrain: Terrain, degrees: float, depth: float, *, start: tuple[float, float] = (2.5, 0.013)) -> Sweep:
    """Straight down, level over 1.2 m, straight up."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    run = np.concatenate(([0.0], np.linspace(0.0, LENGTH, 25), [LENGTH]))
    z = np.concatenate(([0.2], np.full(25, -depth), [0.2]))
    edge = np.column_stack((start[0] + c * run, start[1] + s * run, z))
    return swept(terrain, BladeSweep(edge, (-s, c, 0.0), WIDTH))  # type: ignore[arg-type]


# --- by hand -----------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0.0, 17.0, 45.0, 90.0])
def test_a_box_is_cut_in_layers(degrees: float) -> None:
    terrain, taken = flat(), 0.0
    for layer in range(1, 9):
        found = box_cut(terrain, degrees, 0.1 * layer)
        taken += float(found.bank[-1])
        assert found.loose[-1] == 0.0
        assert found.volume[-1] == pytest.approx(1.25 * found.bank[-1])
        assert taken == pytest.approx(WIDTH * LENGTH * 0.1 * layer, rel=0.01)
        assert found.terrain.bank.min() == pytest.approx(-0.1 * layer, rel=0.01)
        # the taken volume grows linearly along the cut
        middle = float(found.bank[13] / found.bank[-1])
        assert middle == pytest.approx(0.5, abs=0.03)
        assert (np.diff(found.bank) >= 0.0).all()
        terrain = found.terrain
    assert terrain.bank_volume_below(flat()) == pytest.approx(taken, rel=1e-9)
    # walls are upright: between floor and ground are only columns that the blade covers in part
    between = (terrain.bank > -0.79) & (terrain.bank < -0.01)
    assert between.sum() * terrain.cell**2 < 2.2 * (WIDTH + LENGTH) * terrain.cell * math.sqrt(2.0)


def test_passes_side_by_side_leave_no_ridge() -> None:
    terrain = flat()
    for y in (0.013, 0.613):
        terrain = box_cut(terrain, 0.0, 0.3, start=(2.5, y)).terrain
    rows, columns = terrain.columns_within(np.array([2.6, -0.2]), np.array([3.6, 0.85]))
    np.testing.assert_allclose(terrain.bank[rows, columns], -0.3, atol=1e-9)


def test_a_tilted_blade_leaves_a_tilted_floor() -> None:
    tilt = 0.1
    edge = np.array([[2.0, 0.0, -0.2], [4.0, 0.0, -0.2]])
    found = swept(flat(), BladeSweep(edge, np.array([0.0, math.cos(tilt), math.sin(tilt)]), 1.0))
    row = np.searchsorted(found.terrain.y, [-0.2001, -0.0001, 0.1999])
    np.testing.assert_allclose(
        found.terrain.bank[row, 60], -0.2 + math.tan(tilt) * np.array([-0.2, 0.0, 0.2]), atol=1e-9
    )
    assert found.bank[-1] == pytest.approx(2.0 * math.cos(tilt) * 0.2, rel=0.01)


def test_a_tilted_blade_whose_middle_is_above_the_ground_cuts_with_one_end() -> None:
    """A triangle 0.5 sin 0.5 - 0.1 m deep whose base is 0.5 cos 0.5 - 0.1 / tan 0.5 m, over 2 m."""
    tilt = 0.5
    edge = np.array([[2.0, 0.0, 0.1], [4.0, 0.0, 0.1]])
    found = swept(flat(), BladeSweep(edge, np.array([0.0, math.cos(tilt), math.sin(tilt)]), 1.0))
    base, depth = 0.5 * math.cos(tilt) - 0.1 / math.tan(tilt), 0.5 * math.sin(tilt) - 0.1
    assert found.bank[-1] == pytest.approx(2.0 * 0.5 * base * depth, rel=0.03)


def test_a_turning_blade_cuts_a_sector() -> None:
    # a quarter ring with radii of 1.2 and 1.8 m, 0.1 m deep
    angle = np.linspace(0.0, 0.5 * math.pi, 80)
    out = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(80)))
    edge = 1.5 * out + np.array([2.0, -1.0, -0.1])
    found = swept(flat(), BladeSweep(edge, out, 0.6))
    assert found.bank[-1] == pytest.approx(0.25 * math.pi * (1.8**2 - 1.2**2) * 0.1, rel=0.01)


def test_a_blade_takes_the_loose_soil_above_and_the_bank_soil_to_its_full_depth() -> None:
    terrain = flat()
    terrain = terrain.with_layers(terrain.bank, np.full(terrain.shape, 0.06))
    found = box_cut(terrain, 0.0, 0.1)
    assert found.loose[-1] == pytest.approx(WIDTH * LENGTH * 0.06, rel=0.01)
    assert found.bank[-1] == pytest.approx(WIDTH * LENGTH * 0.1, rel=0.01)
    assert found.volume[-1] == pytest.approx(WIDTH * LENGTH * (0.06 + 0.125), rel=0.01)


def test_a_blade_that_goes_there_and_back_takes_what_it_takes_once() -> None:
    terrain = flat()
    terrain = terrain.with_layers(terrain.bank, np.full(terrain.shape, 0.06))
    edge = np.array([[2.5, 0.013, -0.1], [3.7, 0.013, -0.1], [2.5, 0.013, -0.1]])
    once, twice = (swept(terrain, BladeSweep(way, np.array([0.0, 1.0, 0.0]), WIDTH)) for way in (edge[:2], edge))
    assert once.loose[-1] == pytest.approx(WIDTH * LENGTH * 0.06, rel=0.01)
    assert twice.loose[-1] == pytest.approx(once.loose[-1], rel=1e-9)
    assert twice.bank[-1] == pytest.approx(once.bank[-1], rel=1e-9)
    # back and forth again above what is cut
    again = np.array([*edge[:2], [3.7, 0.013, -0.04], [2.5, 0.013, -0.04], [2.5, 0.013, -0.07], [3.7, 0.013, -0.07]])
    thrice = swept(terrain, BladeSweep(again, np.array([0.0, 1.0, 0.0]), WIDTH))
    assert thrice.bank[-1] == pytest.approx(once.bank[-1], rel=1e-9)


def test_a_blade_above_the_ground_takes_nothing() -> None:
    found = box_cut(flat(-0.5), 0.0, 0.4)
    assert found.bank[-1] == found.loose[-1] == 0.0
    beyond = swept(flat(), BladeSweep([[20.0, 0.0, -1.0], [21.0, 0.0, -1.0]], (0.0, 1.0, 0.0), 0.6))  # type: ignore[arg-type]
    assert (beyond.terrain.bank == 0.0).all()


@pytest.mark.parametrize("repose", [0.45, 0.6, 0.75])
def test_a_heap_is_a_cone(repose: float) -> None:
    found = heap(flat(repose=repose), (3.0, 0.0), 0.8)
    # V = pi/3 h^3 / tan^2
    height = (3.0 * 0.8 * math.tan(repose) ** 2 / math.pi) ** (1.0 / 3.0)
    assert found.loose_volume == pytest.approx(0.8, rel=1e-9)
    assert found.loose.max() == pytest.approx(height, rel=0.01)
    slope = np.hypot(*np.gradient(found.loose, 0.05))
    flank = (found.loose > 0.15 * height) & (found.loose < 0.85 * height)
    np.testing.assert_allclose(np.arctan(slope[flank]), repose, atol=0.02)


def test_two_heaps_on_one_place_are_the_heap_of_both() -> None:
    height = (3.0 * 0.8 * math.tan(0.6) ** 2 / math.pi) ** (1.0 / 3.0)
    found = heap(heap(flat(), (3.0, 0.0), 0.3), (3.0, 0.0), 0.5)
    assert found.loose_volume == pytest.approx(0.8, rel=1e-9)
    assert found.loose.max() == pytest.approx(height, rel=0.02)


def test_a_tower_slumps_to_the_angle_of_repose() -> None:
    terrain = flat(repose=0.6)
    loose = np.zeros(terrain.shape)
    loose[60, 60] = 0.3 / 0.05**2
    found = slumped(terrain.with_layers(terrain.bank, loose))
    assert found.loose_volume == pytest.approx(0.3, rel=1e-9)
    for axis in (0, 1):
        drop = np.abs(np.diff(found.surface, axis=axis))
        assert math.atan(drop.max() / 0.05) < 0.6 + math.radians(1.0)
    assert found.loose.max() == pytest.approx((0.9 * math.tan(0.6) ** 2 / math.pi) ** (1.0 / 3.0), rel=0.1)


def test_a_heap_runs_into_a_trench_only_if_it_reaches_the_edge() -> None:
    trench = box_cut(flat(), 0.0, 1.0).terrain  # y from -0.287 to 0.313
    floor = trench.bank < -0.9
    away = heap(trench, (3.1, 1.4), 0.3)  # its foot is 0.75 m from its centre
    assert (away.loose[floor] == 0.0).all()
    near = heap(trench, (3.1, 0.8), 0.3)
    assert near.loose[floor].sum() > 0.0
    assert near.loose_volume == pytest.approx(0.3, rel=1e-9)
    # nowhere is loose soil steeper than the angle of repose
    drop = np.diff(near.surface, axis=0)
    lies = near.loose > 1e-9
    steep = ((drop > 0.05 * math.tan(0.6) * 1.05) & lies[1:]) | ((drop < -0.05 * math.tan(0.6) * 1.05) & lies[:-1])
    assert not steep.any()


def test_a_heap_runs_into_a_trench_wherever_it_is_on_the_grid() -> None:
    """Far along x and in the middle of y: rows and columns have other numbers."""
    ground = Terrain.level(0.0, (0.0, -2.0), (9.0, 2.0), 0.05, repose=0.6)
    trench = box_cut(ground, 0.0, 1.0, start=(6.5, 0.013)).terrain
    near = heap(trench, (7.1, 0.8), 0.3)
    assert near.loose[trench.bank < -0.9].sum() > 0.0
    drop, lies = np.diff(near.surface, axis=0), near.loose > 1e-9
    most = 0.05 * math.tan(0.6) * 1.05
    assert not (((drop > most) & lies[1:]) | ((drop < -most) & lies[:-1])).any()


# --- refusals -------------------------------------------------------------------------------


def test_the_room_for_a_heap_ends_at_ground_that_must_stay_clear() -> None:
    terrain = flat(repose=0.6)
    clear_of = np.broadcast_to(np.abs(terrain.y)[:, None] < 1.0, terrain.shape)
    # a cone whose foot is 0.8 m from its centre
    room = heap_room(terrain, (3.0, 1.8), clear_of=clear_of)
    assert room == pytest.approx(math.pi / 3.0 * 0.85**3 * math.tan(0.6), rel=0.05)
    assert heap(terrain, (3.0, 1.8), 0.99 * room, clear_of=clear_of).loose[clear_of].sum() < 1e-6
    found = deposited(terrain, (3.0, 1.8), 1.02 * room, clear_of=clear_of)
    assert isinstance(found, Refusal)
    assert found.room == pytest.approx(room)
    assert "an area that must stay clear" in found.reason
    border = deposited(terrain, (0.3, 0.0), 1.0)
    assert isinstance(border, Refusal)
    assert "beyond the known ground" in border.reason
    with pytest.raises(InputError, match="is not on the grid"):
        deposited(terrain, (9.0, 0.0), 1.0)


# --- conservation ---------------------------------------------------------------------------

places = st.tuples(st.floats(1.5, 4.5), st.floats(-1.5, 1.5))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.booleans(), places, st.floats(0.0, 180.0), st.floats(0.05, 0.5)), max_size=6))
def test_digging_and_heaping_conserve_volume(steps: list[tuple[bool, tuple[float, float], float, float]]) -> None:
    first = terrain = flat(swell=1.2)
    carried = 0.0
    for digs, place, degrees, amount in steps:
        if digs:
            found = box_cut(terrain, degrees, amount, start=(3.0, 0.0))
            assert found.terrain.bank_volume_below(terrain) == pytest.approx(found.bank[-1], rel=1e-9, abs=1e-12)
            carried += float(found.volume[-1])
            terrain = found.terrain
        else:
            after = deposited(terrain, place, 0.3 * amount)
            if isinstance(after, Terrain):
                terrain, carried = after, carried - 0.3 * amount
        assert (terrain.loose >= 0.0).all()
    dug = terrain.bank_volume_below(first)
    assert terrain.loose_volume + carried == pytest.approx(1.2 * dug, rel=1e-9, abs=1e-12)
