"""The machine with a telescopic stick has the kinematics of its dimensions."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from validation.habitats import load_machine


def test_the_slide_lengthens_the_stick() -> None:
    robot = load_machine("telescope")
    assert robot.joint_names == ("swing", "boom", "stick", "slide", "bucket")
    assert robot.has_pitch
    kinematics = bp.Kinematics(robot)
    # the boom's foot is at (0.3, 0, 0.9); 2.2 m of boom, 1.4 + 0.1 m of stick and slide, 0.8 m of bucket
    for swing, boom, stick, slide, bucket in np.array([[0.3, 0.4, -1.2, 0.0, -0.5], [-1.0, 0.9, -0.3, 1.1, 0.2]]):
        at = kinematics.at(np.array([swing, boom, stick, slide, bucket]))
        second, third = boom + stick, boom + stick + bucket
        out = 0.3 + 2.2 * np.cos(boom) + (1.5 + slide) * np.cos(second) + 0.8 * np.cos(third)
        up = 0.9 + 2.2 * np.sin(boom) + (1.5 + slide) * np.sin(second) + 0.8 * np.sin(third)
        assert at.tip_position == pytest.approx([out * np.cos(swing), out * np.sin(swing), up])
        assert at.pitch == pytest.approx(third)
