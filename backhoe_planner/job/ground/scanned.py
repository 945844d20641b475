"""The ground as a scan found it: what was dug and heaped meanwhile, and what is not known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Flags, Vector, as_number
from backhoe_planner.errors import InputError, check_kind, check_path
from backhoe_planner.job.ground.grids import HeightGrid, filled
from backhoe_planner.job.ground.surveys import survey_on
from backhoe_planner.job.ground.terrain import Terrain

_NOISE = 0.02  # m by which a scan may differ without saying that the ground does; chosen, a laser's 1 to 2 cm


@dataclass(frozen=True, eq=False)
class Scanned:
    """The ground after a scan.

    Attributes
    ----------
    terrain: as the scan found it; where it did not look, as it was known before.
    unknown: (rows, columns) where it did not look.
    """

    terrain: Terrain
    unknown: Flags


def scanned(
    known: Terrain, file: str | Path, *, low: Sequence[float] | Vector | None = None, cell: float | None = None,
    fill: float = 0.0, noise: float = _NOISE,
) -> Scanned:  # fmt: skip
    """The ground as a file has it, on the grid of the ground as it was known.

    What is lower than the undisturbed soil was is undisturbed soil with the rest dug away; what is higher is
    loose soil on it.

    Parameters
    ----------
    known: the ground before, such as at the job's beginning or after its last cycle.
    file: heights or points, as of `Terrain.from_file`; its grid may be any.
    low: (2,) x, y of the file's first height [m], which a CSV needs.
    cell: between the file's heights [m], which a CSV needs.
    fill: holes are filled from their rims up to this far from a known column [m]; by default none is.
    noise: where the scan is this near to the known surface, nothing is changed [m].

    Raises
    ------
    InputError: the file is missing or malformed, does not say where it lies, or knows nothing of this ground.
    """
    check_kind(known, Terrain, key="known")
    file, noise = check_path(file, key="file"), as_number(noise, key="noise", least=0.0)
    onto = HeightGrid(known.low, known.cell, np.full(known.shape, np.nan))
    heights = filled(survey_on(file, onto, low=low, cell=cell), as_number(fill, key="fill", least=0.0)).z
    unknown = np.isnan(heights)
    if unknown.all():
        raise InputError(
            "lies nowhere on the ground", file=file,
            allowed=f"heights between x, y {known.low.tolist()} and {known.high.tolist()}",
        )  # fmt: skip
    same = unknown | (np.abs(heights - known.surface) <= noise)
    bank = np.where(same, known.bank, np.minimum(known.bank, heights))
    loose = np.where(same, known.loose, np.maximum(heights - bank, 0.0))
    return Scanned(known.with_layers(bank, loose), unknown)
