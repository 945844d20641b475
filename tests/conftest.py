"""The machines that most tests use, loaded once."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

from backhoe_planner.machine.robot import Robot, load_robot

settings.register_profile("seeded", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("seeded")


@pytest.fixture(scope="session")
def planar4() -> Robot:
    return load_robot("example:planar4")


@pytest.fixture(scope="session")
def backhoe() -> Robot:
    return load_robot("example:backhoe")


@pytest.fixture(scope="session")
def ur5() -> Robot:
    return load_robot("example:ur5", tip="tool0")


@pytest.fixture(scope="session")
def panda() -> Robot:
    return load_robot("example:panda", tip="panda_hand_tcp")


@pytest.fixture(params=["planar4", "backhoe", "ur5", "panda"])
def any_robot(request: pytest.FixtureRequest) -> Robot:
    """Each of the four in turn."""
    robot: Robot = request.getfixturevalue(request.param)
    return robot
