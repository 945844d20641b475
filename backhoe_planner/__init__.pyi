from .errors import (
    InputError,
    OutputError,
    PlanFileError,
    PlannerError,
    RobotError,
    SceneError,
)
from .live.follower import Followed, PlanFollower
from .live.servo.feedback import Feedback
from .live.servo.servo import Servo
from .live.servo.servo_state import Command, ServoState, Status
from .machine.capability.digging import DiggingForces, digging_forces
from .machine.hydraulics.hydraulics import BothWays, Hydraulics
from .machine.kinematics.inverse_kinematics import InverseKinematics, solve_inverse_kinematics
from .machine.kinematics.kinematics import Configuration, Kinematics
from .machine.kinematics.target import TipTarget
from .machine.robot import JointLimits, Robot, load_robot
from .motion.trajectory import Trajectory
from .planning.plan.plan import Plan
from .planning.plan.plan_file import load_plan
from .planning.planner import plan
from .planning.reactive.stepping import Step
from .proof.certificate import Certificate, certify
from .site.obstacles import build_obstacles
from .site.proximity import Proximity
from .site.scene_file import Scene, load_scene, scene_from_dict, scene_schema
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
