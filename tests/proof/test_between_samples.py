"""What happens between two samples counts, however far apart they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp

TURNTABLE = """<robot name="turntable"><link name="base"/><link name="table"/>
<link name="rod"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="table"/><child link="rod"/><axis xyz="1 0 0"/>
  <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    path: Path = tmp_path_factory.mktemp("turntable") / "turntable.urdf"
    path.write_text(TURNTABLE)
    return bp.load_robot(path, tip="rod")


@pytest.mark.parametrize(("tolerance", "verified"), [(0.046, False), (0.063, True)])
def test_a_slide_outboard_of_a_hinge(turntable: bp.Robot, tolerance: float, verified: bool) -> None:
    """Both samples lie on the path; halfway the tip is 0.1 sin(0.5) = 0.0479 m off it.

    The bound is (0.1 * 1 + 2 * 0.2 * 1) / 8 = 0.0625 m.
    """
    end = [0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 0.0]
    path = {"waypoints": [{"position": [-0.1, 0.0, 0.0]}, {"position": end}], "tolerance": tolerance}
    scene = bp.scene_from_dict({"version": 1, "task": {"path": path}})
    motion = bp.Trajectory.from_steps(np.array([0.0, 1000.0]), np.array([[0.0, -0.1], [1.0, 0.1]]))
    certificate = bp.certify(turntable, scene, motion)
    assert certificate.verified == verified
    if verified:
        assert certificate.tracking.max_error == pytest.approx(0.0625)
