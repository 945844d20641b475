"""The tables of a study in Parquet: one row for each plan, and a second table of what depends on the computer."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from backhoe_planner.errors import OutputError
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.rows.template import Template


def build_table(template: Template, rows: Sequence[StudyRow], found: Mapping[int, Outcome]) -> Any:
    """The table of the rows that are done, in their order: a `pyarrow.Table`.

    Columns are `row`, the parameters, `method`, `effort` and `seed` of the plan, `verdict`, `reason`, `message`, the
    metrics and `versions`. Nothing in it depends on the time or the computer. The fields of parameters and metrics have
    their units in their metadata, as ``unit``.

    Parameters
    ----------
    rows: all rows of the study; they determine the types of the parameters.
    found: their results, by row number.
    """
    import pyarrow as pa

    shown = [row for row in rows if row.number in found]
    units = template.column_units
    columns: dict[str, Any] = {"row": pa.array([row.number for row in shown], pa.int64())}
    names = list(rows[0].values) if rows else []
    for name in names:
        type_ = _type_of([row.values[name] for row in rows])
        columns[name] = pa.array([_cell(row.values[name], type_) for row in shown], type_)
    outcomes = [found[row.number] for row in shown]
    for name in ("method", "effort", "seed"):
        if name not in names and not (template.kind == "job" and name == "method"):
            value = template.filled({})[1][name]
            columns[name] = pa.array([value] * len(shown), pa.int64() if name == "seed" else pa.string())
    for name in ("verdict", "reason", "message"):
        columns[name] = pa.array([getattr(one, name) for one in outcomes], pa.string())
    types = {"float": pa.float64(), "int": pa.int64(), "string": pa.string(), "bool": pa.bool_()}
    for metric in template.metrics:
        values = [one.metrics.get(metric.name) for one in outcomes]
        columns[metric.name] = pa.array(values, types[metric.type])
    versions = json.dumps(installed_versions(), sort_keys=True)
    columns["versions"] = pa.array([versions] * len(shown), pa.string()).dictionary_encode()
    table = pa.table(columns)
    fields = [
        field.with_metadata({"unit": units[field.name]}) if field.name in units else field for field in table.schema
    ]
    return table.cast(pa.schema(fields))


def build_timings(found: Mapping[int, Outcome]) -> Any:
    """The table of the values that depend on the computer: a `pyarrow.Table`."""
    import pyarrow as pa

    done = sorted(found)
    columns = {"row": pa.array(done, pa.int64())}
    types = {"processor": pa.float64(), "wall": pa.float64(), "host": pa.string(), "process": pa.int64()}
    for name, type_ in types.items():
        columns[name] = pa.array([found[row].timing.get(name) for row in done], type_)
    return pa.table(columns)


def write_table(table: Any, file: Path) -> None:
    """Write a table, whole or not at all.

    Raises
    ------
    OutputError: it cannot be written.
    """
    import pyarrow.parquet as pq

    try:
        with whole_file(file, "wb") as stream:
            pq.write_table(table, stream)
    except OSError as error:  # pyarrow may raise a subclass of its own
        raise OutputError(f"cannot be written: {error.strerror or error}", file=file) from error


def _type_of(values: Sequence[Any]) -> Any:
    """The type of a parameter's column; JSON text if its values have no common type."""
    import pyarrow as pa

    kinds = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    found = {type(value) for value in values}
    if found == {int, float}:
        return pa.float64()
    if len(found) == 1 and (only := next(iter(found))) in kinds:
        return kinds[only]
    inner = [entry for value in values if isinstance(value, (list, tuple)) for entry in value]
    if found <= {list, tuple} and inner and {type(entry) for entry in inner} <= {int, float}:
        return pa.list_(pa.float64())
    return pa.string()


def _cell(value: Any, type_: Any) -> Any:
    import pyarrow as pa

    if type_ == pa.string() and not isinstance(value, str):
        return json.dumps(value)
    return value
