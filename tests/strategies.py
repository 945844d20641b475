"""Strategies for hypothesis: whole scenes as plain data."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

Data = dict[str, Any]

numbers = st.floats(-100.0, 100.0, allow_subnormal=False) | st.integers(-5, 5)
turns = st.floats(-6.0, 6.0, allow_subnormal=False)
positive = st.floats(0.001, 50.0) | st.integers(1, 5)
amounts = st.floats(0.0, 50.0, allow_subnormal=False) | st.integers(0, 5)
vectors = st.lists(numbers, min_size=3, max_size=3)
angles = st.lists(st.floats(-math.pi, math.pi, allow_subnormal=False), min_size=3, max_size=3)
names = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=12)


def _unit(parts: list[float]) -> list[float]:
    length = math.hypot(*parts)
    return [part / length for part in parts]


quaternions = (
    st.lists(st.floats(-1.0, 1.0, allow_subnormal=False), min_size=4, max_size=4)
    .filter(lambda parts: math.hypot(*parts) > 0.1)
    .map(_unit)
)
scales: st.SearchStrategy[Any] = st.one_of(positive, st.lists(positive, min_size=3, max_size=3))
normals = vectors.filter(lambda parts: math.hypot(*parts) > 1e-3)


def record(required: dict[str, st.SearchStrategy[Any]], **optional: st.SearchStrategy[Any]) -> st.SearchStrategy[Data]:
    return st.fixed_dictionaries(required, optional=optional)


def oriented(draw: st.DrawFn, data: Data, *, pitch: bool) -> Data:
    """`data` with none or one of the ways to give an orientation."""
    kind = draw(st.sampled_from(["none", "rpy", "quaternion", *(["pitch", "range"] if pitch else [])]))
    if kind == "rpy":
        data["rpy"] = draw(angles)
    elif kind == "quaternion":
        data["quaternion"] = draw(quaternions)
    elif kind == "pitch":
        data["pitch"] = draw(turns)
    elif kind == "range":
        data["pitch"] = sorted(draw(st.lists(turns, min_size=2, max_size=2)))
    return data


@st.composite
def poses(draw: st.DrawFn) -> Data:
    return oriented(draw, {"position": draw(vectors)}, pitch=True)


COMMON: dict[str, st.SearchStrategy[Any]] = {
    "clearance": amounts,
    "links": st.lists(names, min_size=1, max_size=3),
    "appears_at": amounts,
    "velocity": vectors,
}
SHAPES: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "sphere": {"radius": positive},
    "box": {"size": st.lists(positive, min_size=3, max_size=3)},
    "cylinder": {"radius": positive, "length": positive},
    "capsule": {"from": vectors, "to": vectors, "radius": positive},
    "halfspace": {"point": vectors, "normal": normals},
    "mesh": {"file": names},
    "heightmap": {"file": names, "size": st.lists(positive, min_size=2, max_size=2)},
    "pointcloud": {"file": names, "resolution": positive},
}


@st.composite
def obstacles(draw: st.DrawFn, shape: str) -> Data:
    data: Data = draw(record({"name": names, "shape": st.just(shape), **SHAPES[shape]}, **COMMON))
    if shape in ("capsule", "halfspace"):
        return data
    if draw(st.booleans()):
        data["position"] = draw(vectors)
    if shape == "mesh" and draw(st.booleans()):
        data["scale"] = draw(scales)
    return oriented(draw, data, pitch=False)


@st.composite
def path_tasks(draw: st.DrawFn) -> Data:
    origins = record({"position": vectors}, rpy=st.tuples(st.just(0.0), st.just(0.0), turns).map(list))
    data: Data = draw(record({}, speed=positive, tolerance=positive, detour=st.booleans(), origin=origins,
                             turn_on_the_spot=st.booleans(), max_joint_step=positive))  # fmt: skip
    if draw(st.booleans()):
        return {**data, "file": draw(names)}
    points = draw(st.lists(vectors, min_size=2, max_size=5, unique_by=tuple))
    pitched = draw(st.booleans())
    waypoints: list[Data] = [{"position": point} for point in points]
    for waypoint in waypoints:
        if pitched and draw(st.booleans()):
            waypoint["pitch"] = draw(turns)
        elif not pitched and draw(st.booleans()):
            waypoint["quaternion"] = draw(quaternions)
    return {**data, "waypoints": waypoints}


starts = st.one_of(
    st.dictionaries(names, numbers, max_size=4).map(lambda joints: {"joints": joints}),
    poses().map(lambda pose: {"tip": pose}),
)
soils = record(
    {},
    density=st.floats(100.0, 1e4),
    cohesion=amounts,
    friction=st.floats(0.01, 1.5),
    adhesion=amounts,
    tool_friction=st.floats(0.0, 1.5, allow_subnormal=False),
    surface=numbers,
    surcharge=amounts,
    width=positive,
)
gains = st.just("auto") | record({}, s_e=amounts, s_o=amounts, s_k=st.dictionaries(names, amounts, max_size=3))
limits = record({}, velocity_scale=st.floats(0.01, 1.0), acceleration=st.dictionaries(names, positive, max_size=3))


@st.composite
def scenes(draw: st.DrawFn) -> Data:
    """A valid scene; every shape of obstacle occurs."""
    data: Data = draw(
        record(
            {"version": st.just(1)},
            name=names,
            tip=names,
            clearance=amounts,
            influence=positive,
            gains=gains,
            limits=limits,
            objective=st.sampled_from(["velocity_norm", "kinetic", "effort", "work", "hydraulic", "time"]),
            payload=amounts,
            soil=soils,
        )
    )
    to_goal = draw(st.booleans())
    data["task"] = {"goal": draw(poses())} if to_goal else {"path": draw(path_tasks())}
    if to_goal or draw(st.booleans()):
        data["start"] = draw(starts)
    chosen = draw(st.lists(st.sampled_from(sorted(SHAPES)), max_size=8))
    found = [draw(obstacles(shape)) for shape in chosen]
    for index, obstacle in enumerate(found):
        obstacle["name"] = f"{index} {obstacle['name']}"
    if found:
        data["obstacles"] = found
    return data
