"""Facets, lines and lights as meshcat's objects.

meshcat's own mesh carries no normals and no opacity per vertex, and it has no lights;
three.js, which reads the messages, knows all of them.
"""

from __future__ import annotations

from typing import Any

import meshcat.geometry as g
import numpy as np
from meshcat.commands import SetProperty
from numpy.typing import NDArray

from backhoe_planner.show.drawing.palette import Rgba
from backhoe_planner.show.drawing.solids import Facets

__all__ = ["ambient", "line_segments", "material", "mesh", "set_property", "sun"]

Points = NDArray[np.float64]


class _FacetGeometry(g.Geometry):  # type: ignore[misc]
    def __init__(self, drawn: Facets) -> None:
        super().__init__()
        self.drawn = drawn

    def lower(self, object_data: dict[str, Any]) -> dict[str, Any]:
        attributes = {
            "position": g.pack_numpy_array(self.drawn.vertices.T),
            "normal": g.pack_numpy_array(self.drawn.normals.T),
        }
        if self.drawn.rgba is not None:
            attributes["color"] = g.pack_numpy_array(self.drawn.rgba.T)
        return {
            "uuid": self.uuid,
            "type": "BufferGeometry",
            "data": {"attributes": attributes, "index": g.pack_numpy_array(self.drawn.faces.T)},
        }


class _Light(g.Object):  # type: ignore[misc]
    def __init__(self, kind: str, properties: dict[str, Any]) -> None:
        g.SceneElement.__init__(self)
        self.kind = kind
        self.properties = properties

    def lower(self) -> dict[str, Any]:
        return {
            "metadata": {"version": 4.5, "type": "Object"},
            "geometries": [],
            "materials": [],
            "object": {"uuid": self.uuid, "type": self.kind, **self.properties},
        }


class _SetProperty(SetProperty):  # type: ignore[misc]
    def lower(self) -> dict[str, Any]:
        return {**super().lower(), "property": self.key}


def set_property(node: Any, key: str, value: object) -> None:
    """Set a property of the three.js object of a meshcat node.

    meshcat's own method puts the key in lower case, so that ``castShadow`` is lost on it.
    """
    node.window.send(_SetProperty(key, value, node["<object>"].path))


def material(
    rgba: Rgba,
    *,
    per_vertex: bool = False,
    lit: bool = True,
    one_sided: bool = False,
    behind: bool = False,
    through: bool = False,
) -> Any:
    """A surface of one colour.

    Parameters
    ----------
    per_vertex: the facets bring their colours; only the opacity of `rgba` counts.
    lit: slightly glossy, with light and shade; else the same colour from all sides.
    one_sided: draw the outside only, for see-through shells.
    behind: let what lies in the same plane win.
    through: visible through whatever stands in front.
    """
    clear = rgba[3] < 1.0
    extra: dict[str, Any] = {"depthWrite": not clear, "depthTest": not through}
    if lit:
        extra |= {"shininess": 24, "specular": 0x1C1C1C}
    if behind:
        extra |= {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 4.0}
    kind = g.MeshPhongMaterial if lit else g.MeshBasicMaterial
    return kind(
        color=0xFFFFFF if per_vertex else _code(rgba),
        opacity=1.0 if per_vertex else rgba[3],
        transparent=clear,
        vertexColors=per_vertex,
        side=0 if one_sided else 2,
        **extra,
    )


def mesh(
    drawn: Facets, rgba: Rgba, *, lit: bool = True, one_sided: bool = False, behind: bool = False, through: bool = False
) -> Any:
    """A mesh to be handed to ``set_object``; see `material`."""
    surface = material(
        rgba, per_vertex=drawn.rgba is not None, lit=lit, one_sided=one_sided, behind=behind, through=through
    )
    return g.Mesh(_FacetGeometry(drawn), surface)


def line_segments(points: Points, rgba: Points) -> Any:
    """Thin lines between points (2k, 3), two by two, with colours (2k, 4)."""
    return g.LineSegments(
        g.PointsGeometry(position=points.T, color=rgba.T),
        g.LineBasicMaterial(vertexColors=True, transparent=True, depthWrite=False),
    )


def sun(position: Points, *, colour: int, intensity: float, reach: float) -> Any:
    """A light from `position` (3,) towards the origin, whose shadows reach `reach` [m] from there."""
    distance = float(np.linalg.norm(position))
    return _Light(
        "DirectionalLight",
        {
            "color": colour,
            "intensity": intensity,
            "position": [float(x) for x in position],
            "shadow": {
                "bias": -0.0006,
                "normalBias": 0.02,
                "radius": 2.5,
                "mapSize": [2048, 2048],
                "camera": {
                    "uuid": g.SceneElement().uuid,
                    "type": "OrthographicCamera",
                    "left": -reach,
                    "right": reach,
                    "top": reach,
                    "bottom": -reach,
                    "near": max(0.1, distance - 1.5 * reach),
                    "far": distance + 1.5 * reach,
                    "zoom": 1.0,
                },
            },
        },
    )


def ambient(*, sky: int, ground: int, intensity: float) -> Any:
    """Light from all sides, one colour from above and one from below."""
    return _Light(
        "HemisphereLight",
        {"color": sky, "groundColor": ground, "intensity": intensity, "position": [0.0, 0.0, 1.0]},
    )


def _code(rgba: Rgba) -> int:
    r, g_, b = (round(255.0 * min(max(part, 0.0), 1.0)) for part in rgba[:3])
    return (r << 16) | (g_ << 8) | b
