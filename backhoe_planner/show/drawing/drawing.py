"""Facets, lines, animations, sky, lights and camera as meshcat objects, and the names of meshcat nodes.

meshcat's own mesh has no normals and no opacity per vertex, and meshcat has no lights. But three.js, which reads
the messages, supports all of these.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import meshcat.geometry as g
import numpy as np
import umsgpack
from meshcat.commands import SetProperty

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.show.drawing.framing import FIELD_OF_VIEW, View
from backhoe_planner.show.drawing.palette import Rgba
from backhoe_planner.show.drawing.solids import Facets

# A slash would begin a new level. The viewer keeps children in a plain JavaScript object, which already has members
# of these names.
_SLASH = "\N{DIVISION SLASH}"
_TAKEN = frozenset((
    "<object>", "__defineGetter__", "__defineSetter__", "__lookupGetter__", "__lookupSetter__", "__proto__",
    "constructor", "hasOwnProperty", "isPrototypeOf", "propertyIsEnumerable", "toLocaleString", "toString", "valueOf",
))  # fmt: skip
_TYPES = {"position": "vector3", "scale": "vector3", "quaternion": "quaternion", "material.color": "color"}
_FLOAT32 = 0x17  # MessagePack extension code by which meshcat marks such arrays

_SKY_TOP = [0.62, 0.76, 0.90]
_SKY_BOTTOM = [0.95, 0.96, 0.96]
_UNWANTED = ("Lights/SpotLight", "Lights/PointLightNegativeX", "Lights/PointLightPositiveX", "Lights/AmbientLight",
             "Lights/FillLight", "Grid", "Axes")  # fmt: skip


def node_name(name: str) -> str:
    """`name` as one level of a path in the viewer's tree."""
    plain = name.replace("/", _SLASH).strip() or "_"
    return f"{plain}_" if plain in _TAKEN else plain


def node_names(names: Iterable[str]) -> dict[str, str]:
    """The node of every name; names that would share a node get different ones."""
    found: dict[str, str] = {}
    for name in names:
        node, number = node_name(name), 2
        while node in found.values():
            node, number = f"{node_name(name)} ({number})", number + 1
        found[name] = node
    return found


class Track(NamedTuple):
    """One property of one node over time.

    Attributes
    ----------
    path: path of the node in the viewer's tree.
    kind: ``position``, ``scale``, ``quaternion`` (x, y, z, w) or ``material.color``.
    time: (K,) increasing times [s].
    values: (K, 3) values [m, or 1 for a scale or colour], or (K, 4) for a quaternion.
    """

    path: str
    kind: str
    time: Vector
    values: Matrix


class PlanAnimation:
    """Tracks that play together in the browser; meshcat accepts it in place of its own ``Animation``.

    Numbers have 32 bits: a second of motion takes about 1 kB per moving link.

    Parameters
    ----------
    duration: duration of the whole animation [s].
    """

    def __init__(self, tracks: Sequence[Track], duration: float) -> None:
        self.tracks = tuple(tracks)
        self.duration = duration

    def lower(self) -> list[dict[str, Any]]:
        """The animation in the form that meshcat's viewer reads: one clip per node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for path, kind, time, values in self.tracks:
            track = {"name": f".{kind}", "type": _TYPES[kind], "times": _packed(time), "values": _packed(values)}
            clips.setdefault(path, []).append(track)
        return [
            {"path": path, "clip": {"fps": 1, "name": "plan", "duration": self.duration, "tracks": tracks}}
            for path, tracks in clips.items()
        ]


def _packed(values: Array) -> Any:
    return umsgpack.Ext(_FLOAT32, np.ascontiguousarray(values, dtype="<f4").tobytes())


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

    meshcat's own method converts the key to lower case, so that ``castShadow`` has no effect.
    """
    node.window.send(_SetProperty(key, value, node["<object>"].path))


def draw(node: Any, drawn: Any, *, shadow: bool = True, order: int = 0) -> None:
    """Draw something on a meshcat node.

    Parameters
    ----------
    shadow: whether the object casts a shadow.
    order: drawing order of transparent objects; a higher one is drawn over a lower one.
    """
    node.set_object(drawn)
    if not shadow:
        set_property(node, "castShadow", False)
    if order:
        set_property(node, "renderOrder", order)


def mesh(
    drawn: Facets, rgba: Rgba, *, lit: bool = True, one_sided: bool = False, behind: bool = False, through: bool = False
) -> Any:
    """A mesh for ``set_object``.

    Parameters
    ----------
    rgba: colour; for facets with colours of their own, only the opacity counts.
    lit: slightly glossy, with light and shade; otherwise the same colour from all sides.
    one_sided: draw only the outside, for transparent shells.
    behind: draw other objects in the same plane over this one.
    through: draw this object over everything in front of it.
    """
    coloured, clear = drawn.rgba is not None, rgba[3] < 1.0
    extra: dict[str, Any] = {"depthWrite": not clear, "depthTest": not through}
    if lit:
        extra |= {"shininess": 24, "specular": 0x1C1C1C}
    if behind:
        extra |= {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 4.0}
    kind = g.MeshPhongMaterial if lit else g.MeshBasicMaterial
    surface = kind(
        color=0xFFFFFF if coloured else _code(rgba),
        opacity=1.0 if coloured else rgba[3],
        transparent=clear,
        vertexColors=coloured,
        side=0 if one_sided else 2,
        **extra,
    )
    return g.Mesh(_FacetGeometry(drawn), surface)


def line_segments(points: Matrix, rgba: Matrix) -> Any:
    """Thin lines between pairs of points (2k, 3) [m], with colours (2k, 4)."""
    return g.LineSegments(
        g.PointsGeometry(position=points.T, color=rgba.T),
        g.LineBasicMaterial(vertexColors=True, transparent=True, depthWrite=False),
    )


def set_stage(visualizer: Any, *, reach: float) -> None:
    """Replace meshcat's own sky, lights, grid and axes.

    Parameters
    ----------
    visualizer: a ``meshcat.Visualizer``.
    reach: radius around the origin within which there are shadows [m].
    """
    for path in _UNWANTED:
        visualizer[f"/{path}"].set_property("visible", False)
    visualizer["/Background"].set_property("top_color", _SKY_TOP)
    visualizer["/Background"].set_property("bottom_color", _SKY_BOTTOM)
    for light in ("sun", "sky", "back"):  # the page's list of nodes fails where a light replaces another
        visualizer[f"/Lights/{light}"].delete()
    away = 2.0 * reach
    sunlight = _sun(np.array([0.35, -0.55, 1.0]) * away, colour=0xFFF6E6, intensity=0.62, reach=reach)
    visualizer["/Lights/sun"].set_object(sunlight)
    from_all_sides = {"color": 0xF2F7FF, "groundColor": 0xB9AD98, "intensity": 0.58, "position": [0.0, 0.0, 1.0]}
    draw(visualizer["/Lights/sky"], _Light("HemisphereLight", from_all_sides), shadow=False)
    back = _sun(np.array([-0.6, 0.8, 0.5]) * away, colour=0xDDE8FF, intensity=0.16, reach=reach)
    draw(visualizer["/Lights/back"], back, shadow=False)


def set_camera(visualizer: Any, view: View) -> None:
    """Place meshcat's camera at `view`.

    meshcat has no command for the point around which the camera turns, and uses the world's origin. Our page sets it to
    the view's target.
    """
    camera = visualizer["/Cameras/default/rotated"]
    set_property(camera, "fov", float(np.degrees(FIELD_OF_VIEW)))
    set_property(camera, "near", 0.05)
    set_property(camera, "far", 400.0)
    x, y, z = (float(part) for part in view.eye())
    set_property(camera, "position", [x, z, -y])  # y is up for this node


def _sun(position: Matrix, *, colour: int, intensity: float, reach: float) -> Any:
    """A light from `position` (3,) [m] towards the origin, with shadows within `reach` [m] of the origin."""
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
                    **{"left": -reach, "right": reach, "bottom": -reach, "top": reach},
                    "near": max(0.1, distance - 1.5 * reach),
                    "far": distance + 1.5 * reach,
                    "zoom": 1.0,
                },
            },
        },
    )


def _code(rgba: Rgba) -> int:
    r, g_, b = (round(255.0 * min(max(part, 0.0), 1.0)) for part in rgba[:3])
    return (r << 16) | (g_ << 8) | b
