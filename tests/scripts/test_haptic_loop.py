"""The haptic example: the hand feels the wall and gets no energy from it."""

from __future__ import annotations

import numpy as np
from haptic_loop import simulate


def test_the_wall_pushes_the_hand_back_and_never_gives_it_energy() -> None:
    record = simulate(4.0)
    assert float(np.max(record["work"])) <= 1e-6
    assert float(np.min(record["force"][:, 0])) < -5.0
    assert float(np.max(np.linalg.norm(record["force"], axis=1))) <= 2.0 * 30.0
    assert float(np.min(record["margin"])) >= 0.0
