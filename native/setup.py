"""Builds the extension; what else there is to say stands in pyproject.toml."""

import numpy as np
from setuptools import Extension, setup

SOURCES = (
    "arrays",
    "kinematics",
    "poses",
    "pairs",
    "clusters",
    "distance",
    "place",
    "around",
    "asked",
    "ground",
    "rings",
    "grids",
    "cell_trees",
    "voxels",
    "law",
    "shield",
    "servo",
    "boxes",
    "rows",
    "odometers",
    "screen",
    "near",
    "timing",
    "programs",
    "held",
    "rods",
    "routes",
    "dynamics",
    "goals",
    "linkages",
    "ways",
    "module",
)
HEADERS = ("arrays", "asked", "cells", "distance", "grids", "place", "rings", "screen")

setup(
    ext_modules=[
        Extension(
            "backhoe_planner_native",
            [f"src/{name}.c" for name in SOURCES],
            depends=[f"src/{name}.h" for name in HEADERS],
            include_dirs=[np.get_include()],
            # no product and sum are made one: the same numbers on every processor
            extra_compile_args=["-O3", "-std=gnu11", "-ffp-contract=off"],
        )
    ]
)
