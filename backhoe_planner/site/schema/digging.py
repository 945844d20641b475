"""The part of the scene file that describes the soil."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from backhoe_planner.files.numbers import LARGEST, number
from backhoe_planner.files.records import Record
from backhoe_planner.site.schema.quantities import Finite, NonNegative, Positive, Slope

_LIGHTEST = 100.0  # kg/m^3: peat has 300, and nobody digs in anything lighter than new snow


def _in_kilograms(density: Any) -> Any:
    if isinstance(density, (int, float)) and 10.0 <= density < 30.0:
        raise ValueError(
            f"density is in kg/m^3, at least {_LIGHTEST:g}; {density:g} kN/m^3 are {1e3 * density / 9.81:.0f} kg/m^3"
        )
    if isinstance(density, (int, float)) and 0.0 < density < 10.0:
        raise ValueError(
            f"density is in kg/m^3, at least {_LIGHTEST:g}; {density:g} t/m^3 are {1e3 * density:g} kg/m^3"
        )
    return density


class Soil(Record):
    """The soil that the bucket digs in (fundamental earthmoving equation).

    Every key may be left out: the defaults are those of a soil of medium strength.
    """

    density: Annotated[float, number(ge=_LIGHTEST, le=LARGEST), BeforeValidator(_in_kilograms)] = 1700.0
    """Density of the soil [kg/m^3]; 1700 by default, 1300 to 2000 is usual."""
    cohesion: Annotated[float, number(ge=0.0, le=1e8)] = 5000.0
    """Cohesion between its grains [Pa]; 5000 by default, 0 for dry sand, up to 50000 for clay, 1e6 for rock."""
    friction: Annotated[Slope, Field(gt=0.0)] = 0.55
    """Internal friction angle [rad]; 0.55 by default, 0.44 to 0.70 (25 to 40 degrees) is usual."""
    adhesion: NonNegative = 0.0
    """Adhesion between soil and blade [Pa]; 0 by default."""
    tool_friction: Slope | None = None
    """Friction angle between soil and blade [rad]; 2/3 of `friction` by default."""
    surface: Finite = 0.0
    """Height z of the ground, below which the soil resists [m], world; 0 by default."""
    surcharge: NonNegative = 0.0
    """Load on the ground beside the blade [Pa]; 0 by default."""
    width: Positive | None = None
    """Width of the blade [m]; that of the bucket's collision shape by default."""
