from .capability.denavit_hartenberg import dh_table
from .capability.digging import DiggingForces, digging_forces
from .capability.envelope import Envelope, reachable_points, working_envelope
from .collision_model import geometry_model, self_pairs
from .description.hydraulics_file import HydraulicsRecord
from .description.link_shapes import Visual
from .description.urdf import example_names, read_urdf, shipped
from .dynamics import GRAVITY, Dynamics, MotionEnergy, motion_energy
from .hydraulics.cylinder import Cylinder
from .hydraulics.hydraulics import BothWays, Hydraulics
from .hydraulics.linkage import FourBar, Triangle
from .kinematics.inverse_kinematics import InverseKinematics, solve_batch, solve_inverse_kinematics
from .kinematics.kinematics import BatchKinematics, Configuration, ConfigurationBatch, Kinematics, wrap_angle
from .kinematics.target import TargetBatch, TipTarget, movable_rows
from .reach import tip_travel_bound, travel_bounds
from .robot import JointLimits, Robot, load_robot
from .shape.convex import convex_cover, load_mesh, terrain_columns, voxel_boxes
from .shape.shapes import Piece

__all__ = [
    "GRAVITY",
    "BatchKinematics",
    "BothWays",
    "Configuration",
    "ConfigurationBatch",
    "Cylinder",
    "DiggingForces",
    "Dynamics",
    "Envelope",
    "FourBar",
    "Hydraulics",
    "HydraulicsRecord",
    "InverseKinematics",
    "JointLimits",
    "Kinematics",
    "MotionEnergy",
    "Piece",
    "Robot",
    "TargetBatch",
    "TipTarget",
    "Triangle",
    "Visual",
    "convex_cover",
    "dh_table",
    "digging_forces",
    "example_names",
    "geometry_model",
    "load_mesh",
    "load_robot",
    "motion_energy",
    "movable_rows",
    "reachable_points",
    "read_urdf",
    "self_pairs",
    "shipped",
    "solve_batch",
    "solve_inverse_kinematics",
    "terrain_columns",
    "tip_travel_bound",
    "travel_bounds",
    "voxel_boxes",
    "working_envelope",
    "wrap_angle",
]
