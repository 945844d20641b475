from .costs import PathCost, trajectory_costs, trajectory_energy
from .objectives import OBJECTIVES, Nodes
from .path import TipPath, step_lengths
from .problem import Problem, build_problem, hand_set_gains
from .smooth_way import SmoothWay
from .timing.drive import Drive, drive_of
from .timing.limit_usage import LimitUsage, limit_usage
from .timing.retiming import DRIVEN_WITHIN, retimed
from .timing.time_optimal import Rows, fastest
from .timing.timing import time_along, time_polyline, time_way
from .tracking import Detour, Tracking, progress, track_goal, track_path
from .trajectory import SAMPLE_PERIOD, Moments, Trajectory, chord_sagitta

__all__ = [
    "DRIVEN_WITHIN",
    "OBJECTIVES",
    "SAMPLE_PERIOD",
    "Detour",
    "Drive",
    "LimitUsage",
    "Moments",
    "Nodes",
    "PathCost",
    "Problem",
    "Rows",
    "SmoothWay",
    "TipPath",
    "Tracking",
    "Trajectory",
    "build_problem",
    "chord_sagitta",
    "drive_of",
    "fastest",
    "hand_set_gains",
    "limit_usage",
    "progress",
    "retimed",
    "step_lengths",
    "time_along",
    "time_polyline",
    "time_way",
    "track_goal",
    "track_path",
    "trajectory_costs",
    "trajectory_energy",
]
