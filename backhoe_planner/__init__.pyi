from .errors import (
    InputError,
    OutputError,
    PlanFileError,
    PlannerError,
    RobotError,
    SceneError,
)
from .machine.digging import DiggingForces, digging_forces
from .machine.hydraulics import BothWays, Hydraulics
from .machine.inverse_kinematics import InverseKinematics, solve_inverse_kinematics
from .machine.kinematics import Configuration, Kinematics
from .machine.robot import JointLimits, Robot, load_robot
from .machine.target import TipTarget
from .planning.live.streaming import Followed, PlanFollower
from .planning.plan import Plan
from .planning.plan_file import load_plan
from .planning.planner import plan
from .planning.proof.certificate import Certificate, certify
from .planning.stepping import Step
from .planning.task.trajectory import Trajectory
from .redundancy.live.feedback import Feedback
from .redundancy.live.servo import Servo
from .redundancy.live.servo_state import Command, ServoState, Status
from .site.obstacles import build_obstacles
from .site.proximity import Proximity
from .site.scene import Scene, load_scene, scene_from_dict, scene_schema
from .site.zones import Transgression, ZoneLog, zone_log

__all__ = [
    "BothWays",
    "Certificate",
    "Command",
    "Configuration",
    "DiggingForces",
    "Feedback",
    "Followed",
    "Hydraulics",
    "InputError",
    "InverseKinematics",
    "JointLimits",
    "Kinematics",
    "OutputError",
    "Plan",
    "PlanFileError",
    "PlanFollower",
    "PlannerError",
    "Proximity",
    "Robot",
    "RobotError",
    "Scene",
    "SceneError",
    "Servo",
    "ServoState",
    "Status",
    "Step",
    "TipTarget",
    "Trajectory",
    "Transgression",
    "ZoneLog",
    "build_obstacles",
    "certify",
    "digging_forces",
    "load_plan",
    "load_robot",
    "load_scene",
    "plan",
    "scene_from_dict",
    "scene_schema",
    "solve_inverse_kinematics",
    "zone_log",
]
