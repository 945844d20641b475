"""Motions for a backhoe, or any redundant arm, along a path among obstacles.

    import backhoe_planner as bp

    robot = bp.load_robot("models/backhoe.urdf")
    scene = bp.load_scene("scenes/trench.yaml")
    plan = bp.plan(robot, scene)
    print(plan.verdict, plan.certificate.min_clearance)
    plan.save("plan.json")

SI units and radians everywhere; x away from the machine, y left, z up.
"""

from backhoe_planner.errors import (
    InputError,
    OutputError,
    PlanFileError,
    PlannerError,
    RobotError,
    SceneError,
)
from backhoe_planner.machine.digging import DiggingForces, digging_forces
from backhoe_planner.machine.hydraulics import BothWays, Hydraulics
from backhoe_planner.machine.inverse_kinematics import InverseKinematics, solve_inverse_kinematics
from backhoe_planner.machine.kinematics import Configuration, Kinematics
from backhoe_planner.machine.robot import JointLimits, Robot, load_robot
from backhoe_planner.machine.target import TipTarget
from backhoe_planner.planning.certificate import Certificate, certify
from backhoe_planner.planning.plan import Plan
from backhoe_planner.planning.plan_file import load_plan
from backhoe_planner.planning.planner import plan
from backhoe_planner.planning.stepping import Step
from backhoe_planner.planning.streaming import PlanFollower
from backhoe_planner.planning.trajectory import Trajectory
from backhoe_planner.redundancy.servo import Servo
from backhoe_planner.redundancy.servo_state import ServoState
from backhoe_planner.site.obstacles import build_obstacles
from backhoe_planner.site.proximity import Proximity
from backhoe_planner.site.scene import Scene, load_scene, scene_from_dict, scene_schema
from backhoe_planner.site.zones import Transgression, ZoneLog, zone_log

__all__ = [
    "BothWays",
    "Certificate",
    "Configuration",
    "DiggingForces",
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
