from .paths.corners import round_corners
from .paths.dynamic_programming import cheapen_stretch
from .paths.layered_graph import Edge, EdgeKind, LayeredGraph
from .paths.local_resolution import resolve_along
from .paths.path_layers import PathLayers, redundancy_of
from .paths.path_resolution import PathResolver, Stretch
from .paths.smoothing import smooth_stretch, stretch_cost
from .planner import plan
from .reactive.law_timing import as_fast_as_allowed, places_on, shortest_time
from .reactive.reaching import approach_goal
from .reactive.stepping import Step, Stepper
from .report.asked_speed import AskedSpeed, asked_speed
from .report.comparison import (
    LawComparison,
    compare_with_law,
    joined,
    law_motion,
    least_norm_resolution,
    part_on_path,
    stations_of,
)
from .result.export import export_plan
from .result.findings import NOTHING, Findings, NearestPose, Reaction, RecordingNotes
from .result.metrics import DetourTotal, Metrics, measure_motion
from .result.plan import Plan, load_plan, plan_to_dict
from .result.plan_file import Method, Reason
from .search.blending import blend
from .search.effort import DEFAULT_BUDGET, EFFORTS, Brake, Effort, OutOfTime, Work
from .search.motion_check import MotionCheck
from .search.sampling import JointPath, sample_path
from .search.shortening import shorten
from .world import World

__all__ = [
    "DEFAULT_BUDGET",
    "EFFORTS",
    "NOTHING",
    "AskedSpeed",
    "Brake",
    "DetourTotal",
    "Edge",
    "EdgeKind",
    "Effort",
    "Findings",
    "JointPath",
    "LawComparison",
    "LayeredGraph",
    "Method",
    "Metrics",
    "MotionCheck",
    "NearestPose",
    "OutOfTime",
    "PathLayers",
    "PathResolver",
    "Plan",
    "Reaction",
    "Reason",
    "RecordingNotes",
    "Step",
    "Stepper",
    "Stretch",
    "Work",
    "World",
    "approach_goal",
    "as_fast_as_allowed",
    "asked_speed",
    "blend",
    "cheapen_stretch",
    "compare_with_law",
    "export_plan",
    "joined",
    "law_motion",
    "least_norm_resolution",
    "load_plan",
    "measure_motion",
    "part_on_path",
    "places_on",
    "plan",
    "plan_to_dict",
    "redundancy_of",
    "resolve_along",
    "round_corners",
    "sample_path",
    "shorten",
    "shortest_time",
    "smooth_stretch",
    "stations_of",
    "stretch_cost",
]
