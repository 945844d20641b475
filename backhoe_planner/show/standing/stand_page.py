"""One HTML page with the map of a site, without a network: costs by place, and what was compared."""

from __future__ import annotations

import html
import math
import os
from collections.abc import Iterable

from backhoe_planner.arrays import Matrix
from backhoe_planner.show.page.page import html_page, read_parts, write_page_file
from backhoe_planner.show.standing.site_sketch import (
    COSTS,
    DIG,
    GIVEN,
    HEAP,
    MACHINE,
    OBSTACLE,
    THINGS,
    WHOLE,
    WHY,
    Machine,
    Sketch,
    colour,
    name_place,
    sketch_of,
)
from backhoe_planner.standing import StandPlan

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def write_stand_page(plan: StandPlan, path: str | os.PathLike[str]) -> None:
    """Write a page with the map of a site, offline, whole or not at all.

    Raises
    ------
    OutputError: the name ends in neither .html nor .htm, the folder does not exist or cannot be written, or the
        file is one of the job's.
    """
    write_page_file(path, lambda: (stand_page(plan), ()), inputs=plan.job.files)


def stand_page(plan: StandPlan) -> str:
    """The page as text."""
    sketch = sketch_of(plan)
    (common,) = read_parts("backhoe_planner.show.page", "page.css")
    css, script = read_parts("backhoe_planner.show.standing", "standing.css", "standing.js")
    name = plan.job.name or "job"
    body = (
        f'<div id="app"><main id="stage">{_drawing(sketch)}<p id="told" role="status">{_FIRST}</p></main>\n'
        f'<aside id="panel">{_panel(plan, sketch, html.escape(name))}</aside></div>\n'
    )
    return html_page(f"{name}: where to stand", policy=_POLICY, css=common + css, body=body, scripts=[script])


_FIRST = "Point at a place, or tap it."


def _drawing(sketch: Sketch) -> str:
    (x0, y0), (x1, y1) = sketch.low.tolist(), sketch.high.tolist()
    parts = [
        f'<svg id="map" viewBox="{x0:.3f} {-y1:.3f} {x1 - x0:.3f} {y1 - y0:.3f}" role="img" '
        'aria-label="the site from above, coloured by cost">'
    ]
    if sketch.given is not None:
        parts.append(_body(sketch.given, "given", GIVEN))
    parts += [_body(machine, "machine", MACHINE) for machine in sketch.machines]
    for cell in sketch.cells:
        spot = cell.spot
        (x, y), finite = spot.base.position, math.isfinite(spot.cost)
        shade = colour(sketch, spot.cost) if finite else WHY[spot.reason][0]
        heading = f"{math.degrees(spot.base.heading):.0f}°"
        words = f"{sketch.scale * spot.cost:.1f} {sketch.unit} about, heading {heading}" if finite else spot.why
        if finite and spot.share < WHOLE:
            words += f", {100.0 * spot.share:.0f} % in reach"
        told = html.escape(f"x {x:.2f}, y {y:.2f} m: {words}")
        part = " part" if finite and spot.share < WHOLE else ""
        parts.append(
            f'<polygon class="cell{part}" points="{_points(cell.corners)}" fill="{shade}" data-told="{told}"/>'
        )
    parts += [f'<polygon points="{_points(one)}" fill="{HEAP}" fill-opacity=".6"/>' for one in sketch.heaps]
    parts += [f'<polygon class="dig" points="{_points(one)}" fill="{DIG}"/>' for one in sketch.digs]
    parts += [f'<polygon class="obstacle" points="{_points(one)}" fill="{OBSTACLE}"/>' for one in sketch.things]
    for name, outline in sketch.obstacles:
        parts.append(f'<polygon class="obstacle" points="{_points(outline)}" fill="{OBSTACLE}"/>')
        place = name_place(sketch, outline)
        if place is not None:
            parts.append(f'<text class="name" x="{place[0]:.2f}" y="{-place[1]:.2f}">{html.escape(name)}</text>')
    for machine in sketch.machines:
        parts += _arm(machine)
    parts.append(_ruler(sketch))
    parts.append("</svg>")
    return "".join(parts)


def _body(machine: Machine, kind: str, shade: str) -> str:
    """The parts that do not move; all rims are below all faces, so that only the common outline remains."""
    every = "".join(f'<polygon points="{_points(one)}"/>' for one in machine.outlines)
    return f'<g class="{kind}"><g class="rims" stroke="{shade}">{every}</g><g class="faces">{every}</g></g>'


def _arm(machine: Machine) -> list[str]:
    (x, y), (to_x, to_y) = machine.axis.tolist(), machine.digs.tolist()
    return [
        f'<line class="arm" x1="{x:.3f}" y1="{-y:.3f}" x2="{to_x:.3f}" y2="{-to_y:.3f}" stroke="{MACHINE}"/>',
        f'<circle class="axis" cx="{x:.3f}" cy="{-y:.3f}" r=".3" stroke="{MACHINE}"/>',
        f'<text class="number" x="{x:.3f}" y="{-y:.3f}">{machine.label}</text>',
    ]


def _ruler(sketch: Sketch) -> str:
    """A line of one metre with the directions of x and y, in the lower left corner."""
    x, y = float(sketch.low[0]) + 0.35, -float(sketch.low[1]) - 0.35
    return (
        f'<path class="ruler" d="M{x:.3f} {y:.3f}h1M{x:.3f} {y:.3f}v-1"/>'
        f'<text class="small" x="{x + 1.1:.3f}" y="{y + 0.08:.3f}">x, 1 m</text>'
        f'<text class="small" x="{x - 0.08:.3f}" y="{y - 1.1:.3f}">y</text>'
    )


def _points(outline: Matrix) -> str:
    return " ".join(f"{x:.3f},{-y:.3f}" for x, y in outline.tolist())


def _panel(plan: StandPlan, sketch: Sketch, title: str) -> str:
    badge = "verified" if plan.verified else f"failed: {plan.reason}"
    failed = "" if plan.verified else ' class="failed"'
    cost = f"{sketch.scale * plan.cost:.1f} {html.escape(sketch.unit)}" if math.isfinite(plan.cost) else "-"
    facts = [("cost", cost), ("soil", f"{plan.bank:.2f} m³ bank"), ("places", str(len(plan.places)))]
    if plan.stays:
        facts.append(("less than the given place", "none, this is it"))
    elif math.isfinite(plan.gain):
        facts.append(("less than the given place", f"{100.0 * plan.gain:.1f} %"))
    if plan.travel:
        facts.append(("travel between places", f"{plan.travel:.1f} m, not timed"))
    return "".join(
        (
            f'<header><h1>{title}</h1><p id="subtitle">where to stand, for the least {plan.job.objective} per m³</p>',
            f'<div id="verdict"{failed}><span id="badge">{badge}</span>',
            f'<p id="message">{html.escape(plan.note)}</p></div>',
            "</header><section><dl>",
            *(f"<dt>{html.escape(name)}</dt><dd>{value}</dd>" for name, value in facts),
            "</dl></section>", _legend(sketch), _places(plan, sketch), _ranking(plan, sketch),
        )
    )  # fmt: skip


def _legend(sketch: Sketch) -> str:
    least, most = (f"{sketch.scale * cost:.0f}" for cost in sketch.range)
    seen = {cell.spot.reason for cell in sketch.cells if cell.spot.reason}
    keys = [(shade, words) for reason, (shade, words) in WHY.items() if reason in seen]
    keys += [(DIG, "dug"), (HEAP, "heap or truck"), *([(OBSTACLE, THINGS)] if sketch.things else [])]
    if any(cell.spot.share < WHOLE for cell in sketch.cells if math.isfinite(cell.spot.cost)):
        keys.append(("rgba(95,174,123,.35)", "pale: reaches a part only"))
    given = '<li><i class="dashed"></i>the given place</li>' if sketch.given is not None else ""
    return (
        f"<section><h2>Cost from there, about [{html.escape(sketch.unit)}]</h2>"
        f'<div id="scale" style="background:linear-gradient(90deg,{",".join(COSTS)})"></div>'
        f'<div id="ends"><span>{least}</span><span>{most} and more</span></div><ul id="keys">'
        + "".join(f'<li><i style="background:{shade}"></i>{html.escape(words)}</li>' for shade, words in keys)
        + given + "</ul></section>"
    )  # fmt: skip


def _places(plan: StandPlan, sketch: Sketch) -> str:
    rows = []
    for number, place in enumerate(plan.places, start=1):
        x, y = place.base.position
        own = place.plan
        rows.append(
            (f"{number}", f"{x:.2f}", f"{y:.2f}", f"{math.degrees(place.base.heading):.0f}°", str(len(own.cycles)),
             f"{own.bank:.2f}", f"{sketch.scale * own.cost:.1f}")
        )  # fmt: skip
    return (
        _table("Places, in order", ("", "x [m]", "y [m]", "heading", "cycles", "m³", sketch.unit), rows) if rows else ""
    )


def _ranking(plan: StandPlan, sketch: Sketch) -> str:
    rows = []
    for one in plan.ranking:
        x, y = one.base.position
        costs = [
            f"{sketch.scale * cost:.1f}" if math.isfinite(cost) else "–"
            for cost in (one.rough, one.estimated, one.planned)
        ]
        rows.append((f"{x:.2f}{' given' if one.given else ''}", f"{y:.2f}", *costs))
    heads = ("x [m]", "y [m]", "map", "estimate", "plan")
    return _table(f"Compared [{sketch.unit}]", heads, rows) if rows else ""


def _table(title: str, heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{html.escape(one)}</th>" for one in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(one)}</td>" for one in row) + "</tr>" for row in rows)
    return (
        f'<section><h2>{html.escape(title)}</h2><table class="figures"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></section>"
    )
