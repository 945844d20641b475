"""Sky, light and camera around what is shown."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.show.drawing.drawing import ambient, set_property, sun
from backhoe_planner.show.drawing.framing import FIELD_OF_VIEW, View

__all__ = ["set_camera", "set_stage"]

Vector = NDArray[np.float64]

_SKY_TOP = [0.62, 0.76, 0.90]
_SKY_BOTTOM = [0.95, 0.96, 0.96]
_UNWANTED = ("Lights/SpotLight", "Lights/PointLightNegativeX", "Lights/PointLightPositiveX", "Lights/AmbientLight",
             "Lights/FillLight", "Grid", "Axes")  # fmt: skip


def set_stage(visualizer: Any, *, reach: float) -> None:
    """Replace meshcat's own sky, lights, grid and axes.

    Parameters
    ----------
    visualizer: a ``meshcat.Visualizer``.
    reach: radius of what is shown, for the shadows [m].
    """
    for path in _UNWANTED:
        visualizer[f"/{path}"].set_property("visible", False)
    visualizer["/Background"].set_property("top_color", _SKY_TOP)
    visualizer["/Background"].set_property("bottom_color", _SKY_BOTTOM)
    away = 2.0 * reach
    sunlight = sun(np.array([0.35, -0.55, 1.0]) * away, colour=0xFFF6E6, intensity=0.62, reach=reach)
    visualizer["/Lights/sun"].set_object(sunlight)
    visualizer["/Lights/sky"].set_object(ambient(sky=0xF2F7FF, ground=0xB9AD98, intensity=0.58))
    set_property(visualizer["/Lights/sky"], "castShadow", False)
    back = sun(np.array([-0.6, 0.8, 0.5]) * away, colour=0xDDE8FF, intensity=0.16, reach=reach)
    visualizer["/Lights/back"].set_object(back)
    set_property(visualizer["/Lights/back"], "castShadow", False)


def set_camera(visualizer: Any, view: View, *, aspect: float = 1.5) -> None:
    """Put meshcat's camera where `view` says.

    meshcat's own page has no command for the point around which the camera turns: it
    is the world's origin. Our page puts it at the view's target.
    """
    camera = visualizer["/Cameras/default/rotated"]
    set_property(camera, "fov", float(np.degrees(FIELD_OF_VIEW)))
    set_property(camera, "near", 0.05)
    set_property(camera, "far", 400.0)
    x, y, z = (float(part) for part in view.eye(aspect))
    set_property(camera, "position", [x, z, -y])  # y is up for this node
