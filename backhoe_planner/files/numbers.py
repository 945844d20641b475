"""The numbers of files: how far they may go, and the schema of one."""

from __future__ import annotations

from pydantic import GetPydanticSchema
from pydantic_core import core_schema

LARGEST = 1e5  # m, kg, s, ...: no site is larger, and products of a few such numbers are finite
FURTHEST = 1e7  # m or a file's units: map coordinates go no further


def number(
    *, ge: float | None = None, gt: float | None = None, le: float | None = None, lt: float | None = None,
    count: int | None = None,
) -> GetPydanticSchema:  # fmt: skip
    """A finite float within bounds, or a list of `count` of them; strict: neither true nor "0.3" is a number.

    pydantic takes it as it is. It would spend half of the time to load a scene on finding the same for each field.
    """
    one = core_schema.float_schema(strict=True, allow_inf_nan=False, ge=ge, gt=gt, le=le, lt=lt)
    schema = one if count is None else core_schema.tuple_schema([one] * count)
    return GetPydanticSchema(lambda _source, _handler: schema)
