"""Small machines whose dynamics are known in closed form."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import backhoe_planner as bp

MASS, LENGTH = 300.0, 2.0  # of the pendulum [kg], [m]
PENDULUM = f"""<robot name="pendulum">
  <link name="post"/>
  <link name="arm"><collision><geometry><sphere radius="0.01"/></geometry></collision>
    <inertial><origin xyz="{LENGTH} 0 0"/><mass value="{MASS}"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><origin xyz="0 0 2"/><parent link="post"/><child link="arm"/>
    <axis xyz="0 -1 0"/><limit lower="-0.8" upper="0.9" velocity="1" effort="1e4"/></joint>
  <link name="end"/>
  <joint name="tool" type="fixed"><origin xyz="{LENGTH} 0 0"/><parent link="arm"/><child link="end"/></joint>
</robot>"""

# a hinge at the origin and a slide along the arm, from 0 to 0.5 m; the tip is a ball of radius 0.1 m at its end
TURNING_SLIDE = """<robot name="turning slide"><link name="base"/>
  <link name="post"><collision><origin xyz="0 0 -1"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="post"/><child link="ball"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="ball"/><child link="tip"/></joint></robot>"""


@dataclass(frozen=True)
class Axis:
    """One joint of a chain, and its link.

    Attributes
    ----------
    kind: as in a URDF.
    place, axis: in the frame of the joint before, as in a URDF [m].
    lower, upper: limits [rad or m].
    mass: of the link, at its joint [kg].
    ball: radius of a ball around the joint [m]; none if 0.
    """

    kind: str
    axis: str
    lower: float
    upper: float
    place: str = "0 0 0"
    mass: float = 1.0
    ball: float = 0.0


def load_chain(
    folder: Path, axes: Iterable[Axis], *, tool: str = "0 0 0", ball: float = 0.0, effort: float = 500.0
) -> bp.Robot:
    """A machine of joints one after the other, with a tip at `tool` [m] behind the last, in a `ball` [m] if not 0."""
    parts, parent = ['<link name="base"/>'], "base"
    for number, one in enumerate(axes):
        link = f"link{number}"
        parts.append(
            f'<link name="{link}"><inertial><mass value="{one.mass}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" '
            f'ixy="0" ixz="0" iyz="0"/></inertial>{_ball(one.ball)}</link>'
            f'<joint name="joint{number}" type="{one.kind}"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{one.place}"/><axis xyz="{one.axis}"/>'
            f'<limit lower="{one.lower}" upper="{one.upper}" velocity="1" effort="{effort}"/></joint>'
        )
        parent = link
    parts.append(
        f'<link name="tip">{_ball(ball)}</link><joint name="tool" type="fixed"><origin xyz="{tool}"/>'
        f'<parent link="{parent}"/><child link="tip"/></joint>'
    )
    file = folder / "chain.urdf"
    file.write_text(f'<robot name="chain">{"".join(parts)}</robot>', encoding="utf-8")
    return bp.load_robot(file, tip="tip")


def _ball(radius: float) -> str:
    return f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>' if radius else ""
