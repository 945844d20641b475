"""The versions that a plan file states are those of the installed packages."""

from __future__ import annotations

import importlib.metadata

import pytest

import backhoe_planner.machine  # loads the packages
from backhoe_planner.files.provenance import installed_versions


@pytest.mark.parametrize("package", ["backhoe_planner", "pin", "coal", "numpy"])
def test_versions_are_those_of_the_packages(package: str) -> None:
    backhoe_planner.machine.load_robot("example:planar4")
    assert installed_versions()[package] == importlib.metadata.version(package)
