"""An excavator with a telescopic stick, written as URDF text: five joints, one of them a slide.

    swing, boom, stick, slide, bucket

It is not a real product. Size, axes and signs are those of `models/backhoe.urdf`; each link is a
solid box of one density. The post, whose corners swing 0.2 m behind its axis, turns 50 mm in
front of the chassis. The slide lengthens the stick and gives the machine one redundant joint:
position and pitch of the tip need four of the five.
"""

from __future__ import annotations

import atexit
import tempfile
from functools import cache
from pathlib import Path

TIP = "bucket_tip"

# name, mass [kg], edges of the box [m], its middle in the link's frame [m]
_LINKS = (
    ("chassis", 3500.0, (2.85, 2.0, 0.8), (-1.675, 0.0, 0.6)),
    ("post", 300.0, (0.3, 0.4, 0.9), (0.15, 0.0, 0.65)),
    ("boom", 350.0, (2.2, 0.25, 0.3), (1.1, 0.0, 0.0)),
    ("stick", 180.0, (1.4, 0.24, 0.28), (0.6, 0.0, 0.0)),
    ("slide", 120.0, (1.4, 0.16, 0.18), (-0.6, 0.0, 0.0)),
    ("bucket", 180.0, (0.8, 0.5, 0.3), (0.4, 0.0, 0.05)),
)
# name, type, parent, where, axis, lower, upper, velocity, acceleration, effort: [rad] or [m], [N m] or [N]
_JOINTS = (
    ("swing", "revolute", "chassis", "post", (0.0, 0.0, 0.0), (0, 0, 1), -1.57, 1.57, 0.7, 0.5, 30e3),
    ("boom", "revolute", "post", "boom", (0.3, 0.0, 0.9), (0, -1, 0), -1.0, 1.35, 0.45, 0.8, 70e3),
    ("stick", "revolute", "boom", "stick", (2.2, 0.0, 0.0), (0, -1, 0), -2.4, -0.2, 0.8, 1.5, 35e3),
    ("slide", "prismatic", "stick", "slide", (1.4, 0.0, 0.0), (1, 0, 0), 0.0, 1.1, 0.4, 0.6, 20e3),
    ("bucket", "revolute", "slide", "bucket", (0.1, 0.0, 0.0), (0, -1, 0), -2.5, 0.5, 1.1, 3.0, 20e3),
)


def telescope_urdf() -> str:
    """The machine as URDF text; its tip is the link `TIP`, at the end of the bucket."""
    links = [_link(*link) for link in _LINKS]
    joints = [_joint(*joint) for joint in _JOINTS]
    tip = (
        f'<link name="{TIP}"/><joint name="teeth" type="fixed"><origin xyz="0.8 0 0"/>'
        f'<parent link="bucket"/><child link="{TIP}"/></joint>'
    )
    return "\n".join(['<robot name="telescope">', *links, *joints, tip, "</robot>"])


def _link(name: str, mass: float, size: tuple[float, float, float], middle: tuple[float, float, float]) -> str:
    a, b, c = (edge * edge * mass / 12.0 for edge in size)
    place, edges = (" ".join(map(str, values)) for values in (middle, size))
    box = f'<origin xyz="{place}"/><geometry><box size="{edges}"/></geometry>'
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass}"/>'
        f'<inertia ixx="{b + c}" ixy="0" ixz="0" iyy="{a + c}" iyz="0" izz="{a + b}"/></inertial>'
        f"<visual>{box}</visual><collision>{box}</collision></link>"
    )


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: tuple[float, float, float],
    axis: tuple[int, int, int],
    lower: float,
    upper: float,
    velocity: float,
    acceleration: float,
    effort: float,
) -> str:
    at, along = " ".join(map(str, place)), " ".join(map(str, axis))
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="{along}"/><limit lower="{lower}" upper="{upper}" '
        f'velocity="{velocity}" acceleration="{acceleration}" effort="{effort}"/></joint>'
    )


@cache
def telescope_file() -> Path:
    """The URDF as a file; written once per process and deleted with it."""
    folder = tempfile.TemporaryDirectory(prefix="telescope-")
    atexit.register(folder.cleanup)
    file = Path(folder.name) / "telescope.urdf"
    file.write_text(telescope_urdf(), encoding="utf-8")
    return file
