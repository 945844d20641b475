"""The ground as a scan found it: what was dug and heaped in the meantime, and what is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Flags, Vector, as_number
from backhoe_planner.errors import InputError, check_kind, check_path
from backhoe_planner.job.ground.grids import HeightGrid, filled
from backhoe_planner.job.ground.off_ground import join_voxels, standing_in
from backhoe_planner.job.ground.surveys import survey_on
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.schema.work import ROUGHNESS
from backhoe_planner.site import is_cloud

_NOISE = 0.02  # m by which a scan may differ although the ground is unchanged; chosen, a laser has 1 to 2 cm


@dataclass(frozen=True, eq=False)
class Scanned:
    """The ground after a scan.

    Attributes
    ----------
    terrain: the scanned ground; where the scan did not look, the ground as it was known before.
    unknown: (rows, columns) where the scan did not look.
    remark: what stands on the ground according to the scan, in words; empty if nothing does.
    """

    terrain: Terrain
    unknown: Flags
    remark: str = ""


def scanned(
    known: Terrain, file: str | Path, *, low: Sequence[float] | Vector | None = None, cell: float | None = None,
    fill: float = 0.0, noise: float = _NOISE, map_origin: Sequence[float] | Vector | None = None,
    roughness: float = ROUGHNESS,
) -> Scanned:  # fmt: skip
    """The ground according to a file, on the grid of the known ground.

    Where the scan is lower than the undisturbed soil was, soil was dug away and the rest is undisturbed. Where it is
    higher, there is loose soil on the undisturbed soil. What stands on the ground of a point cloud is told from it; a
    thing of before stays where the scan did not look, and if the scan is a table of heights. Where the ground beyond
    the grid is higher than at its border before, it is an obstacle like what stands there.

    Parameters
    ----------
    known: the ground before the scan, such as at the job's beginning or after its last cycle.
    file: heights or points, as in `Terrain.from_file`; on any grid.
    low: (2,) x, y of the file's first height [m]; required for a CSV.
    cell: distance between the file's heights [m]; required for a CSV.
    fill: holes are filled from their rims up to this distance from a known column [m]; none by default.
    map_origin: of points and of a GeoTIFF, as in `Terrain.from_file`. Without it a GeoTIFF is at `low`.
    roughness: of points.
    noise: the ground is unchanged where the scan is this close to the known surface [m].

    Raises
    ------
    InputError: the file is missing or malformed, does not contain its position, or covers none of this ground.
    """
    check_kind(known, Terrain, key="known")
    file = check_path(file, key="file")
    return scanned_around(
        known, None, file, low=low, cell=cell, fill=as_number(fill, key="fill", least=0.0),
        noise=as_number(noise, key="noise", least=0.0), map_origin=map_origin, roughness=roughness,
    )  # fmt: skip


def scanned_around(
    known: Terrain, around: HeightGrid | None, file: Path, *, low: Sequence[float] | Vector | None,
    cell: float | None, fill: float = 0.0, noise: float = _NOISE,
    map_origin: Sequence[float] | Vector | None = None, roughness: float = ROUGHNESS,
) -> Scanned:  # fmt: skip
    """See `scanned`.

    Parameters
    ----------
    around: the ground beyond the known one; None if it goes on level from its border.
    """
    onto = HeightGrid(known.low, known.cell, known.surface)
    survey = survey_on(file, onto, low=low, cell=cell, map_origin=map_origin, roughness=roughness, around=around)
    heights = filled(survey.heights, fill).z
    unknown = np.isnan(heights)
    if unknown.all():
        raise InputError(
            "lies nowhere on the ground", file=file,
            allowed=f"heights between x, y {known.low.tolist()} and {known.high.tolist()}",
        )  # fmt: skip
    same = unknown | (np.abs(heights - known.surface) <= noise)
    bank = np.where(same, known.bank, np.minimum(known.bank, heights))
    loose = np.where(same, known.loose, np.maximum(heights - bank, 0.0))
    left = standing_in(known.off_ground, unknown, onto) if is_cloud(file) else known.off_ground
    stands = join_voxels(survey.off_ground, left)
    return Scanned(replace(known.with_layers(bank, loose), off_ground=stands), unknown, survey.remark)
