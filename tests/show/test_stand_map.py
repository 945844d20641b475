"""The map of a site, on the page and as a picture: every place at its position, in the colour of its cost."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import label
from small_jobs import small_job

import backhoe_planner as bp
from backhoe_planner.job import OffGround, build_worksite
from backhoe_planner.machine import Base, load_robot
from backhoe_planner.show import plot_stand, write_stand_page
from backhoe_planner.standing import SiteMap, Spot

SHADES = ("#0b6e4f", "#5fae7b", "#d5e3a6", "#f2c879", "#c8643c")  # cheap to dear, a quarter of the range apart
COSTS = [10.0, 11.0, 12.25, 13.0, 14.5, 15.0, 16.75, 17.0, 18.0, 19.0, 25.0]
"""The dearest tenth has one colour: the range ends at the tenth cost, 19, and its quarters are 2.25 wide."""
AT = {10.0: 0, 12.25: 1, 14.5: 2, 16.75: 3, 19.0: 4, 25.0: 4}  # number of its shade
EDGE, HEAP = "#e9d3cf", "#d9cdb8"
STEP = 2.0  # m from place to place
POINT = re.compile(r"(-?[\d.]+),(-?[\d.]+)")


@pytest.fixture(scope="module")
def plan() -> bp.StandPlan:
    """A map of 2 x 7 places from x 4, y 3 m on, without a solution; the job's own machine is at 0, 0."""

    def spot(number: int, x: float, y: float) -> Spot:
        base = Base((x, y), 0.25 * math.pi)
        if number < len(COSTS):
            return Spot(base, COSTS[::-1][number], 1.0, ())
        reason = ("edge", "heap", "reach")[number - len(COSTS)]
        return Spot(base, math.nan, 0.0, (), reason, reason)

    x, y = np.meshgrid(4.0 + STEP * np.arange(7), 3.0 + STEP * np.arange(2))
    numbers = np.arange(14).reshape(2, 7)
    spots = tuple(tuple(spot(int(numbers[i, j]), x[i, j], y[i, j]) for j in range(7)) for i in range(2))
    outline = np.array([[8.0, -1.0], [12.0, -1.0], [12.0, 0.0], [8.0, 0.0]])
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    found = SiteMap(spots, x, y, (STEP, STEP), np.array([1.0, 0.0]), outline)
    return bp.StandPlan(small_job(), (), (), found, (square,), "unreachable", "no place is near")


def places(plan: bp.StandPlan) -> dict[float, np.ndarray[Any, Any]]:
    """The place x, y [m] of each cost."""
    return {
        spot.cost: np.array([x, y])
        for row, xs, ys in zip(plan.map.spots, plan.map.x, plan.map.y, strict=True)
        for spot, x, y in zip(row, xs, ys, strict=True)
        if math.isfinite(spot.cost)
    }


@pytest.fixture(scope="module")
def page(plan: bp.StandPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "stand.html"
    write_stand_page(plan, file)
    return file


def test_the_page_draws_every_place_at_its_position_in_the_colour_of_its_cost(plan: bp.StandPlan, page: Path) -> None:
    cells = re.findall(r'<polygon class="cell" points="([^"]*)" fill="([^"]*)" data-told="([^"]*)"', page.read_text())
    assert len(cells) == len(COSTS) + 2, "places out of reach are not drawn"
    drawn = {}
    for points, fill, told in cells:
        corners = np.array([[float(x), -float(y)] for x, y in POINT.findall(points)])
        assert np.ptp(corners, axis=0) == pytest.approx([STEP, STEP])
        said = re.match(r"x (-?[\d.]+), y (-?[\d.]+) m: (?:([\d.]+) s/m³ about, heading 45°)?", told)
        assert said is not None
        assert corners.mean(axis=0) == pytest.approx([float(said[1]), float(said[2])], abs=0.005)
        if said[3]:
            drawn[corners.mean(axis=0).round(3).tobytes()] = fill
    where = places(plan)
    for cost, shade in AT.items():
        assert drawn[where[cost].tobytes()] == SHADES[shade]
    fills = [fill for _, fill, told in cells if "about" not in told]
    assert sorted(fills) == sorted([EDGE, HEAP])


def test_colours_between_two_shades_are_interpolated_linearly(plan: bp.StandPlan, page: Path) -> None:
    """Each colour is a weighted mean of its two neighbours on the scale."""
    fills = re.findall(r'class="cell" points="[^"]*" fill="([^"]*)" data-told="[^"]*: ([\d.]+) s/m³', page.read_text())

    def rgb(text: str) -> np.ndarray[Any, Any]:
        return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)], dtype=float)

    assert len(fills) == len(COSTS)
    for fill, said in fills:
        cost = next(one for one in COSTS if f"{one:.1f}" == said)
        along = min((cost - 10.0) / 2.25, 4.0)
        below = min(int(along), 3)
        low, high = rgb(SHADES[below]), rgb(SHADES[below + 1])
        assert rgb(fill) == pytest.approx(low + (along - below) * (high - low), abs=0.51)


def test_the_browser_shows_every_place_at_its_position(plan: bp.StandPlan, page: Path, browser: Any) -> None:
    """At a width of 1280 pixels; the ruler's metre gives the scale."""
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    complaints = browser.complaints_of(tab)
    tab.goto(page.as_uri())
    pixels = np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
    x0, y0, metre = tab.evaluate(
        "(() => { const ruler = document.querySelector('#map .ruler'), m = ruler.getScreenCTM();"
        " const at = (length) => ruler.getPointAtLength(length).matrixTransform(m);"
        " const corner = at(0), end = at(1); return [corner.x, corner.y, end.x - corner.x]; })()"
    )
    low = np.array([-1.0, -1.0]) - 0.7 + 0.35  # of all that is drawn: the given machine's corner; the ruler's own
    for cost, place in places(plan).items():
        x, y = x0 + metre * (place[0] - low[0]), y0 - metre * (place[1] - low[1])
        tab.mouse.move(x, y)
        assert tab.locator("#told").text_content().startswith(f"x {place[0]:.2f}, y {place[1]:.2f} m: {cost:.1f} s/m³")
        if cost in AT:
            assert "#" + "".join(f"{value:02x}" for value in pixels[round(y), round(x)]) == SHADES[AT[cost]]
    # line widths do not depend on the scale: 1 pixel within a metre across an edge of the given machine
    left, right = (round(x0 + metre * (x - low[0])) for x in (0.5, 1.5))
    rows = [round(y0 - metre * (y - low[1])) for y in np.linspace(-0.9, 0.9, 40)]
    dark = [int((pixels[row, left:right].sum(axis=1) < 600).sum()) for row in rows]
    assert max(dark) in (1, 2), "a stroke between two pixels covers both"
    assert min(dark) == 0, "it is dashed"
    assert complaints == []
    tab.close()


def test_the_picture_has_every_place_at_its_position(plan: bp.StandPlan, tmp_path: Path) -> None:
    """Four places with their own colours: two of them give the scale, and with it the others."""
    file = tmp_path / "stand.png"
    plot_stand(plan, file)
    pixels = np.asarray(Image.open(file).convert("RGB"))

    def middle(shade: str) -> np.ndarray[Any, Any]:
        """The middle of the largest area of that colour: x to the right, y up."""
        same = (pixels == [int(shade[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=2)
        areas, count = label(same)
        largest = max(range(1, count + 1), key=lambda number: int((areas == number).sum()))
        rows, columns = np.nonzero(areas == largest)
        return np.array([0.5 * (columns.min() + columns.max()), -0.5 * (rows.min() + rows.max())])

    where = places(plan)
    one, two, three, four = 10.0, 12.25, 14.5, 16.75
    # by the order of the costs: 16.75 and 14.5 stand in the first row, 12.25 and 10 in the second
    assert where[four].tolist() == [12.0, 3.0]
    assert where[three].tolist() == [16.0, 3.0]
    assert where[two].tolist() == [6.0, 5.0]
    assert where[one].tolist() == [10.0, 5.0]
    metre = (middle(SHADES[2]) - middle(SHADES[3]))[0] / 4.0
    assert metre > 20.0
    for cost in (one, two, three):
        moved = middle(SHADES[AT[cost]]) - middle(SHADES[AT[four]])
        assert moved == pytest.approx(metre * (where[cost] - where[four]), abs=1.5)
    assert middle(EDGE) - middle(SHADES[3]) == pytest.approx(metre * np.array([0.0, 2.0]), abs=1.5)


def test_what_stands_on_the_ground_of_a_cloud_is_on_the_map(plan: bp.StandPlan, tmp_path: Path) -> None:
    """Two walls of 2 m at a right angle, 0.1 m thick and 0.4 m high: 39 columns of 0.1 m."""
    columns = [(x, -14) for x in range(20, 40)] + [(20, y) for y in range(-13, 6)]
    stands = OffGround(0.1, np.array([(*one, z) for one in columns for z in range(4)]))
    job = small_job(site={})
    ground = replace(build_worksite(job).ground, off_ground=stands)
    write_stand_page(replace(plan, job=job, ground=ground), tmp_path / "stand.html")
    text = (tmp_path / "stand.html").read_text()
    drawn = things_in(tmp_path / "stand.html")
    assert sum(np.prod(np.ptp(one, axis=0)) for one in drawn) == pytest.approx(0.39)
    every = np.vstack(drawn)
    np.testing.assert_allclose([every.min(axis=0), every.max(axis=0)], [[2.0, -1.4], [4.0, 0.6]], atol=1e-9)
    assert "</i>stands on the ground</li>" in text


def test_what_stands_in_a_scan_of_the_site_is_on_the_map(plan: bp.StandPlan, tmp_path: Path) -> None:
    """A wall from x 2 to 4 m and y -1.2 to -1 m, 1 m high, on a street that is scanned, too: in voxels of 0.1 m."""
    wall = np.stack(np.meshgrid(np.arange(2.05, 4, 0.1), [-1.15, -1.05], np.arange(0.05, 1, 0.1)), axis=-1)
    street = np.stack(np.meshgrid(np.arange(-3, 6, 0.1), np.arange(-3, 3, 0.1), [-0.05]), axis=-1)
    np.savetxt(tmp_path / "scan.csv", np.vstack((wall.reshape(-1, 3), street.reshape(-1, 3))), delimiter=",")
    scan = {"name": "scan", "shape": "pointcloud", "file": str(tmp_path / "scan.csv"), "resolution": 0.1}
    job = small_job(site={"obstacles": [scan]})
    write_stand_page(replace(plan, job=job, robot=load_robot("example:backhoe")), tmp_path / "stand.html")
    every = np.vstack(things_in(tmp_path / "stand.html"))
    np.testing.assert_allclose([every.min(axis=0), every.max(axis=0)], [[2.0, -1.2], [4.0, -1.0]], atol=1e-9)


def things_in(file: Path) -> list[np.ndarray[Any, Any]]:
    """(4, 2) corners x, y [m] of each rectangle in which something stands, as the page draws it."""
    return [
        np.array(POINT.findall(one), dtype=float) * [1.0, -1.0]
        for one in re.findall(r'<polygon class="obstacle" points="([^"]*)"', file.read_text())
    ]
