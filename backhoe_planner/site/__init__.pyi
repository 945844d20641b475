from .clearance_screen import ClearanceScreen
from .limits import scaled_limits, within_sectors
from .obstacles import Obstacle, build_obstacle, build_obstacles, swept
from .obstruction import Obstruction
from .proximity import Nearby, Pair, Proximity
from .quantities import Finite
from .scene_file import (
    Box,
    Capsule,
    Gains,
    Goal,
    HalfSpace,
    Pose,
    Scene,
    Soil,
    Wall,
    Waypoint,
    load_scene,
    obstacle_from_dict,
    scene_from_dict,
    scene_schema,
)
from .soil import LIP, SoilReaction, blade_force, bucket_width, failure_angle, soil_force
from .survey_files import read_heights, read_points
from .zones import Level, Transgression, ZoneLog, pace, worst_first, zone_log

__all__ = [
    "LIP",
    "Box",
    "Capsule",
    "ClearanceScreen",
    "Finite",
    "Gains",
    "Goal",
    "HalfSpace",
    "Level",
    "Nearby",
    "Obstacle",
    "Obstruction",
    "Pair",
    "Pose",
    "Proximity",
    "Scene",
    "Soil",
    "SoilReaction",
    "Transgression",
    "Wall",
    "Waypoint",
    "ZoneLog",
    "blade_force",
    "bucket_width",
    "build_obstacle",
    "build_obstacles",
    "failure_angle",
    "load_scene",
    "obstacle_from_dict",
    "pace",
    "read_heights",
    "read_points",
    "scaled_limits",
    "scene_from_dict",
    "scene_schema",
    "soil_force",
    "swept",
    "within_sectors",
    "worst_first",
    "zone_log",
]
