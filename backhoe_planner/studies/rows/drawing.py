"""The rows of a study: the values of every plan, drawn before anything is planned."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from backhoe_planner.studies.schema.study_file import Study


@dataclass(frozen=True)
class StudyRow:
    """One plan of a study.

    Attributes
    ----------
    number: from 0, in the order of the table.
    values: of every parameter, by its key path.
    """

    number: int
    values: Mapping[str, Any]

    def identity(self, template: str) -> str:
        """A digest of everything that determines its plan.

        Parameters
        ----------
        template: a digest of everything that all rows share.
        """
        text = json.dumps([template, self.number, dict(self.values)], sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def draw_rows(study: Study) -> Iterator[StudyRow]:
    """All rows, in order. A row depends on the study's seed and its own number, not on the number of rows."""
    return (StudyRow(number, values) for number, values in enumerate(_combinations(study)))


def _combinations(study: Study) -> Iterator[dict[str, Any]]:
    values = study.values
    listed = {name: one.listed for name, one in values.items() if one.draw is None}
    drawn = [name for name, one in values.items() if one.draw is not None]
    if study.combine == "random":
        for number in range(study.rows):
            rng = np.random.default_rng([study.seed, number])
            yield {name: one.one(rng) for name, one in values.items()}
        return
    if study.combine == "zip":
        points: Iterator[tuple[Any, ...]] = zip(
            *(one if len(one) > 1 else itertools.repeat(one[0], study.rows) for one in listed.values()), strict=True
        )
        points = points if listed else iter([()] * study.rows)
    else:
        repeats = study.count or 1
        points = itertools.chain.from_iterable(itertools.product(*listed.values()) for _ in range(repeats))
    for number, point in enumerate(points):
        found = dict(zip(listed, point, strict=True))
        if drawn:
            rng = np.random.default_rng([study.seed, number])
            found |= {name: values[name].one(rng) for name in drawn}
        yield {name: found[name] for name in values}
