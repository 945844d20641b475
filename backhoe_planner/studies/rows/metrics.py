"""The figures of a plan that a study keeps, by key path: their names, types and values."""

from __future__ import annotations

import math
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from backhoe_planner.errors import nearest_name
from backhoe_planner.job import JobFigures, JobPlan, job_figures
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.planning import Bound, CertificateRecord, Findings, Metrics, Plan, describe_quantity
from backhoe_planner.studies.rows.key_paths import is_record, members
from backhoe_planner.studies.rows.units import unit_of

Type = Literal["float", "int", "string", "bool"]
Kind = Literal["scene", "job"]

_OF_PLANS: dict[str, Any] = {"metrics": Metrics, "certificate": CertificateRecord, "bound": Bound, "findings": Findings}
_SHORT = ("metrics", "certificate", "bound")  # roots that may be left out of a key path
_OF_VERIFIED = ("metrics", "bound", "figures")  # only valid for a verified motion; the others describe failures too
_TIMED = ("planning_time",)  # depends on the computer
DEFAULTS: dict[Kind, tuple[str, ...]] = {
    "scene": (
        "duration", "energy.work", "cost.value", "tip_length", "certificate.min_clearance.margin",
        "bound.longer_percent",
    ),
    "job": ("cycles", "bank", "duration", "work", "production", "seconds_per_cycle", "kwh_per_m3", "undug"),
}  # fmt: skip


@dataclass(frozen=True)
class Metric:
    """One figure of a plan.

    Attributes
    ----------
    name: as the study names it, and its column in the table.
    keys: the path to it, from `metrics`, `certificate`, `bound` or `findings` of a plan, or `figures` of a job's.
    type: of its values.
    unit: of its values; empty if they have none, or if it differs from plan to plan.
    """

    name: str
    keys: tuple[str, ...]
    type: Type
    unit: str = ""

    @property
    def heading(self) -> str:
        """The name with the unit, for a column or an axis: ``duration [s]``."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def describe(self, value: float) -> str:
        """A number in words, with its unit if it has one: ``11.39 kJ``."""
        if self.type == "int" or not self.unit:
            return f"{value:.4g}"
        return describe_quantity(value, self.unit)

    def value(self, sources: Mapping[str, Any], *, verified: bool) -> float | int | str | bool | None:
        """Its value in a plan; None if there is none, or if it requires a verified motion and this one is not.

        Parameters
        ----------
        sources: see `sources_of`.
        """
        if self.keys[0] in _OF_VERIFIED and not verified:
            return None
        node: Any = sources
        for key in self.keys:
            if isinstance(node, Mapping):
                node = node.get(key)
            elif isinstance(node, (tuple, list)):
                node = node[int(key)] if int(key) < len(node) else None
            else:
                node = getattr(node, key, None)
        if node is None or (isinstance(node, float) and not math.isfinite(node)):
            return None
        return {"float": float, "int": int, "string": str, "bool": bool}[self.type](node)  # type: ignore[no-any-return]


def sources_of(plan: Plan | JobPlan, metrics: Iterable[Metric]) -> dict[str, Any]:
    """The records of a plan that contain any of `metrics`; others are left out, since a bound takes time to compute."""
    if isinstance(plan, JobPlan):
        return {"figures": job_figures(plan)}
    found: dict[str, Any] = {}
    for root in dict.fromkeys(metric.keys[0] for metric in metrics):
        found[root] = CertificateRecord.of(plan.certificate) if root == "certificate" else getattr(plan, root)
    return found


def find_metric(name: str, kind: Kind, *, objective: str | None) -> Metric:
    """The figure that a key path names.

    Parameters
    ----------
    objective: the name of the objective that all plans minimise; None if it differs.

    Raises
    ------
    ValueError: there is none, it is not a single value, or it is a time of the computer; says what is allowed.
    """
    keys = name.split(".")
    if keys[-1] in _TIMED:
        raise ValueError(f"{name!r} depends on the computer; the times of planning are in timings.parquet")
    roots = {"figures": JobFigures} if kind == "job" else _OF_PLANS
    if keys[0] not in roots:
        above = "figures" if kind == "job" else next((root for root in _SHORT if keys[0] in keys_of(roots[root])), None)
        if above is None:
            allowed = sorted({*roots, *(key for root in _SHORT for key in keys_of(roots[root]))} - set(_TIMED))
            raise _unknown(name, keys[0], allowed)
        keys = [above, *keys]
    annotation: Any = roots[keys[0]]
    for key in keys[1:]:
        kinds = list(members(annotation))
        found = [below for one in kinds if (below := annotation_below(one, key)) is not None]
        if not found:
            raise _unknown(name, key, sorted({one for kind_ in kinds for one in keys_of(kind_)} - set(_TIMED)))
        annotation = typing.Union[tuple(found)]  # noqa: UP007
    types = {_type_of(one) for one in members(annotation)}
    (type_,) = types if len(types) == 1 else (None,)
    if type_ is None:
        below_it = sorted({one for kind_ in members(annotation) for one in keys_of(kind_)} - set(_TIMED))
        within = ", ".join(f"{name}.{one}" for one in below_it) or "a key within it"
        raise ValueError(f"{name!r} is no single figure; allowed: {within}")
    return Metric(name, tuple(keys), type_, unit_of(keys, objective) if type_ in ("float", "int") else "")


def _unknown(name: str, key: str, allowed: list[str]) -> ValueError:
    near = nearest_name(key, allowed)
    hint = f"; did you mean {near!r}?" if near else "."
    within = f" (in {name!r})" if key != name else ""
    return ValueError(f"there is no metric {key!r}{within}{hint} Allowed: {', '.join(allowed) or 'nothing below it'}")


def keys_of(kind: Any) -> list[str]:
    """The keys below a member of an annotation, as far as they are known."""
    if is_record(kind):
        return list(kind.model_fields)
    if hasattr(kind, "__dataclass_fields__"):
        return list(kind.__dataclass_fields__)
    if typing.get_origin(kind) is dict:
        words = typing.get_args(typing.get_args(kind)[0])
        return list(words) if words else list(OBJECTIVES)
    return []


def annotation_below(kind: Any, key: str) -> Any:
    """The annotation of `key` below a member of an annotation; None if there is no such key."""
    if typing.get_origin(kind) is tuple:
        entries = [one for one in typing.get_args(kind) if one is not Ellipsis]
        return entries[0] if key.isdecimal() else None
    if key not in keys_of(kind):
        return None
    if is_record(kind):
        return kind.model_fields[key].annotation
    if typing.get_origin(kind) is dict:
        return typing.get_args(kind)[1]
    return typing.get_type_hints(kind)[key]


def _type_of(kind: Any) -> Type | None:
    if typing.get_origin(kind) is Literal:
        return "string"
    known: dict[Any, Type] = {float: "float", int: "int", str: "string", bool: "bool"}
    return known.get(kind)
