"""What the two joysticks of an excavator mean: the ISO and the SAE pattern.

Both agree on the swing (left stick, sideways) and the bucket (right stick, sideways:
curled in to the left, dumped to the right). They differ in which hand has the boom:

    ISO:  left stick forward and back: the stick;  right: the boom
    SAE:  left stick forward and back: the boom;   right: the stick

Forward puts the boom down and the stick out, in both.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.show.teleop.messages import Sticks

__all__ = ["joint_rates"]


def joint_rates(sticks: Sticks, velocity: Vector) -> Vector:
    """(n,) joint rates that the sticks ask for [rad/s or m/s].

    Parameters
    ----------
    velocity: (n,) the joints' greatest rates. Swing, boom, stick and bucket are the
        first four of them; further joints stand still.
    """
    (left_x, left_y), (right_x, right_y) = sticks.left, sticks.right
    boom, stick = (right_y, left_y) if sticks.pattern == "iso" else (left_y, right_y)
    # positive raises what is outboard: the boom comes up as its stick is pulled back
    roles = np.array([-left_x, -boom, stick, right_x])
    parts = np.zeros(len(velocity))
    count = min(len(velocity), len(roles))
    parts[:count] = roles[:count]
    return np.asarray(sticks.speed * parts * velocity)
