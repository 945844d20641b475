"""The check that a reference system, in well-known text (WKT 1 of OGC or ESRI, or WKT 2), is in metres."""

from __future__ import annotations

import re
from pathlib import Path

from backhoe_planner.errors import InputError
from backhoe_planner.site.surveys.epsg_units import is_projected_in_metres

_TOKENS = re.compile(r'"(?:[^"]|"")*"|[\[\](),]|[^\s\[\](),"]+')
_CODE = re.compile(r"EPSG:+(\d+)", re.IGNORECASE)
_DEGREES = ("GEOGCS", "GEOGCRS", "GEODCRS", "GEOGRAPHICCRS", "GEODETICCRS")
_CENTRE = ("GEOCCS",)
_PLANES = ("PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")
_HEIGHTS = ("VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS")
_UNITS = ("UNIT", "LENGTHUNIT")
_METRE_WITHIN = 1e-9  # of the factor to metres; rounding
_REMEDY = "gdalwarp -t_srs makes metres along x and y of it, gdal_calc.py of its heights"

_Node = list["str | _Node"]
"""A word and what follows it in brackets: words, texts in quotes, numbers, and other nodes."""


def check_system_in_metres(text: str, path: Path, *, key: str) -> None:
    """Check a reference system beside a raster.

    Parameters
    ----------
    text: well-known text, or ``EPSG:`` and a code.
    path, key: where it is, for messages.

    Raises
    ------
    InputError: it is in degrees, feet or another unit, or points downwards; or it is none of these texts.
    """
    if (code := _CODE.fullmatch(text.strip())) is not None:
        if not is_projected_in_metres(int(code[1])):
            raise InputError(
                "is not known to be in metres", file=path, key=key, found=text.strip(), allowed="metres", hint=_REMEDY
            )
        return
    nodes = [node for tree in _trees(text) for node in _all_nodes(tree)]
    planes = [node for node in nodes if _is(node, _PLANES)]
    if not planes and any(_is(node, _DEGREES) for node in nodes):
        raise InputError("is in degrees", file=path, key=key, allowed="metres", hint="project it, such as to UTM")
    if not planes and any(_is(node, _CENTRE) for node in nodes):
        raise InputError("is in coordinates from the centre of the earth", file=path, key=key, hint="project it")
    if not planes:
        found = text.strip()[:60]
        raise InputError("is no reference system that can be read", file=path, key=key, found=found, allowed="WKT")
    for node in (*planes, *(node for node in nodes if _is(node, _HEIGHTS))):
        what = "its heights are" if _is(node, _HEIGHTS) else "is"
        units = [part for part in node if isinstance(part, list) and _is(part, _UNITS)]
        units += [part for part in _all_nodes(node) if _is(part, ("LENGTHUNIT",)) and not units]
        for unit in units[-1:]:
            factor = _number(unit[2]) if len(unit) > 2 else None
            if factor is None or abs(factor - 1.0) > _METRE_WITHIN:
                found = " ".join(str(part).strip('"') for part in unit[1:3])
                raise InputError(
                    f"{what} not in metres", file=path, key=key, found=found, allowed="metres, 1", hint=_REMEDY
                )
        if what != "is" and _points_down(node):
            raise InputError("its heights are depths", file=path, key=key, allowed="metres upwards", hint=_REMEDY)


def _points_down(node: _Node) -> bool:
    for part in _all_nodes(node):
        words = [str(word).strip('"').lower() for word in part[:3]]
        if words[0] == "axis" and words[-1] == "down":
            return True
        if words[:2] == ["parameter", "direction"] and (_number(part[-1]) or 0.0) < 0.0:  # in texts of ESRI
            return True
    return False


def _number(part: str | _Node) -> float | None:
    try:
        return float(str(part))
    except ValueError:
        return None


def _is(node: _Node, words: tuple[str, ...]) -> bool:
    return bool(node) and isinstance(node[0], str) and node[0].upper() in words


def _trees(text: str) -> list[_Node]:
    """The nodes of a text that are in no other node; brackets that do not close end with the text."""
    roots: _Node = []
    stack: list[_Node] = [roots]
    for token in _TOKENS.findall(text):
        if token in "[(":
            word = stack[-1].pop() if stack[-1] else ""
            inner: _Node = [word]
            stack[-1].append(inner)
            stack.append(inner)
        elif token in "])":
            if len(stack) > 1:
                stack.pop()
        elif token != ",":
            stack[-1].append(token)
    return [node for node in roots if isinstance(node, list)]


def _all_nodes(node: _Node) -> list[_Node]:
    """A node and all nodes in it."""
    found = [node]
    for part in node:
        if isinstance(part, list):
            found += _all_nodes(part)
    return found
