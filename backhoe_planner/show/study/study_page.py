"""One HTML page with the results of a study, without a network and without scripts."""

from __future__ import annotations

import html
import math
import os

from backhoe_planner.show.page.page import html_page, read_parts, write_page_file
from backhoe_planner.show.study.scatter import scatter
from backhoe_planner.studies import (
    Map,
    Metric,
    Share,
    StudyResult,
    Summary,
    Template,
    map_of_two,
    summarise_study,
    trade_offs,
)

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_SHADES = ((0x2F, 0xA8, 0x66), (0xF6, 0xE7, 0xA6), (0xE0, 0x7A, 0x5F))  # good, middling, bad
_ONE_LINE = 18  # characters; chosen, more do not fit next to a bar on a phone
_NONE = "#e6ebef"  # if nothing is verified


def write_study_page(result: StudyResult, path: str | os.PathLike[str]) -> None:
    """Write the page of a study, whole or not at all.

    Raises
    ------
    OutputError: the name ends in neither .html nor .htm, or the folder cannot be written.
    """
    inputs = [] if result.study.file is None else [result.study.file]
    write_page_file(path, lambda: (study_page(result), ()), inputs=inputs)


def study_page(result: StudyResult) -> str:
    """The page as text."""
    summary = summarise_study(result)
    (css,) = read_parts("backhoe_planner.show.study", "study.css")
    title = result.study.name or "study"
    body = [f"<h1>{_text(title)}</h1>", _head(result), _endings(summary), _best(result, summary)]
    body += [_successes(result, summary), _map(result, summary), _trade_offs(result, summary)]
    return html_page(title, policy=_POLICY, css=css, body="\n".join(filter(None, body)) + "\n")


def _head(result: StudyResult) -> str:
    done, rows = len(result.outcomes), len(result.rows)
    machine = result.study.machine or "several machines" if result.template.kind == "scene" else "a job"
    count = f"{rows} plans" if done == rows else f"{done} of {rows} plans are done"
    parameters = ", ".join(result.study.parameters) or "no parameter"
    return (
        f'<p class="soft">{_text(count)} of {_text(machine)}; {_text(result.study.combine)} of {_text(parameters)}</p>'
    )


def _endings(summary: Summary) -> str:
    total = sum(summary.counts.values())
    rows = [
        f"<tr><td>{_text(ending)}{_message(summary, ending)}</td><td>{_bar(count / total, 'ending')}</td>"
        f'<td class="number">{count}</td><td class="number">{100.0 * count / total:.1f} %</td></tr>'
        for ending, count in summary.counts.items()
    ]
    return f'<h2>How the plans ended</h2>\n<div class="card"><table>{"".join(rows)}</table></div>'


def _message(summary: Summary, ending: str) -> str:
    if ending not in summary.messages:
        return ""
    row, message = summary.messages[ending]
    return f'<br><small class="soft">row {row}: {_text(message)}</small>'


def _best(result: StudyResult, summary: Summary) -> str:
    best, asked = summary.best, result.template.best
    which, heading = "least" if asked.least is not None else "greatest", result.template.heading
    if best is None:
        return f"<h2>The best row</h2>\n<p>No row is verified and has the metric {_text(asked.metric)}.</p>"
    values = "".join(
        f'<tr><td>{_text(heading(name))}</td><td class="number">{_figure(value)}</td></tr>'
        for name, value in best.values.items()
    )
    measured = result.outcomes[best.number].metrics
    figures = "".join(
        f'<tr><td>{_text(metric.name)}</td><td class="number">{_with_unit(measured.get(metric.name), metric)}</td></tr>'
        for metric in result.template.metrics
    )
    regions = "".join(
        f"<tr><td>{_text(heading(one.name))}</td><td>{_text(one.best)}</td>"
        f"<td class='soft'>{_text(one.every)}</td></tr>"
        for one in summary.regions
    )
    region = (
        f'<div class="card"><h3>The best region: where the {summary.in_region} best rows lie</h3>'
        f"<table><tr><th>parameter</th><th>best rows</th><th>all rows</th></tr>{regions}</table></div>"
        if regions
        else ""
    )
    doubt = f"; {_text(summary.doubt)}" if summary.doubt else ""
    return (
        f"<h2>The best row and the best region</h2>\n<p>Row {best.number} has the {which} {_text(asked.metric)}: "
        f'<b>{_with_unit(summary.best_value, result.template.best_metric)}</b>{doubt}</p>\n<div class="cards">'
        f'<div class="card"><h3>Its parameters</h3><table>{values}</table></div>'
        f'<div class="card"><h3>Its figures</h3><table>{figures}</table></div>{region}</div>'
    )


def _successes(result: StudyResult, summary: Summary) -> str:
    if not summary.shares:
        return ""
    metric = _text(result.template.best_metric.heading)
    cards = []
    for name, shares in summary.shares.items():
        rows = "".join(_share_row(share) for share in shares)
        heads = (
            f'<tr><th></th><th>verified</th><th class="number">of rows</th><th class="number">median {metric}</th></tr>'
        )
        title = _text(result.template.heading(name))
        cards.append(f'<div class="card"><h3>{title}</h3><table>{heads}{rows}</table></div>')
    return f'<h2>Success by parameter</h2>\n<div class="cards">{"".join(cards)}</div>'


def _share_row(share: Share) -> str:
    part = share.verified / share.rows if share.rows else math.nan
    shown = "-" if math.isnan(part) else f"{100.0 * part:.0f} %"
    return (
        f"<tr>{_label(share.label)}<td>{_bar(0.0 if math.isnan(part) else part)}</td>"
        f'<td class="number">{shown} of {share.rows}</td><td class="number">{_figure(share.best)}</td></tr>'
    )


def _map(result: StudyResult, summary: Summary) -> str:
    """The two parameters on which most depends, coloured by the median of the best metric."""
    found = map_of_two(summary, result.rows, result.outcomes, result.template.best)
    if found is None:
        return ""
    known = [cell.best for line in found.cells for cell in line if cell is not None and not math.isnan(cell.best)]
    if not known:
        return ""
    low, high, sign = min(known), max(known), result.template.best.sign
    lines = []
    for label, cells in zip(found.lines, found.cells, strict=True):
        shown = "".join(_cell(cell, low, high, sign) for cell in cells)
        lines.append(f'<tr><th class="line">{_text(label)}</th>{shown}</tr>')
    heads = "".join(f"<th>{_text(label)}</th>" for label in found.columns)
    corner = f'<th class="corner">{_axes(found, result.template)}</th>'
    table = f'<table class="map"><tr>{corner}{heads}</tr>{"".join(lines)}</table>'
    return (
        f"<h2>{_text(found.down)} and {_text(found.across)}</h2>\n"
        f'<p class="soft">The two on which most depends. Large: median {_text(result.template.best_metric.heading)} '
        f'of the verified rows; small: the part that is verified.</p>\n<div class="card scroll">{table}</div>'
    )


def _axes(found: Map, template: Template) -> str:
    return f"{_text(template.heading(found.down))} ↓<br>{_text(template.heading(found.across))} →"


def _cell(cell: Share | None, low: float, high: float, sign: float) -> str:
    if cell is None:
        return "<td></td>"
    part = f"<small>{100.0 * cell.verified / cell.rows:.0f} % of {cell.rows}</small>"
    if math.isnan(cell.best):
        return f'<td style="background:{_NONE}">-{part}</td>'
    at = (cell.best - low) / (high - low) if high > low else 0.0
    return f'<td style="background:{_shade(at if sign > 0.0 else 1.0 - at)}">{_figure(cell.best)}{part}</td>'


def _shade(at: float) -> str:
    """The colour at a fraction of the way from the best to the worst."""
    first, second, mix = (*_SHADES[:2], 2.0 * at) if at < 0.5 else (*_SHADES[1:], 2.0 * at - 1.0)
    mixed = (round(a + mix * (b - a)) for a, b in zip(first, second, strict=True))
    return "#" + "".join(f"{one:02x}" for one in mixed)


def _trade_offs(result: StudyResult, summary: Summary) -> str:
    best = result.template.best
    found = trade_offs(result.template.metrics, result.rows, result.outcomes, best)
    if not found:
        return ""
    cards, headings = [], {metric.name: metric.heading for metric in result.template.metrics}
    for x_name, y_name, points in found:
        number = None if summary.best is None else summary.best.number
        picture = scatter(headings[x_name], headings[y_name], points, best=number, forward=best.sign > 0.0)
        cards.append(f'<div class="card"><h3>{_text(y_name)} over {_text(x_name)}</h3>{picture}</div>')
    return (
        "<h2>What is traded for what</h2>\n"
        '<p class="soft">Each point is a verified row. Orange: no other row is better in both; a ring marks the best '
        f'row.</p>\n<div class="cards">{"".join(cards)}</div>'
    )


def _label(text: str) -> str:
    """A cell with the value of a parameter, on one line if it is short."""
    kind = ' class="label"' if len(text) <= _ONE_LINE else ""
    return f"<td{kind}>{_text(text)}</td>"


def _bar(part: float, kind: str = "") -> str:
    return f'<span class="bar {kind}"><span style="width:{100.0 * part:.1f}%"></span></span>'


def _figure(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return _text(f"{value:.4g}" if isinstance(value, float) else str(value))


def _with_unit(value: object, metric: Metric) -> str:
    """A figure of a plan with its unit."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
        return _figure(value)
    return _text(metric.describe(value))


def _text(text: str) -> str:
    return html.escape(text)
