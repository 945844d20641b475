from .braking.braking_path import BrakingPath, Placements, bend
from .braking.joint_bounds import VelocityRange
from .braking.separation import Separation
from .follower import FollowerState, FollowerStatus, PlanFollower
from .recordings import is_recording, plan_from_recording, problem_to_show, unrecorded_changes
from .recovery.escape import MOST_LOOKS, EscapeRoute, EscapeSearch, RouteSearch
from .recovery.violation_descent import way_back
from .rejoining import NoRejoining, Rejoining, RejoiningQuery, find_rejoining, is_still_clear
from .servo.feedback import Feedback
from .servo.safe_velocity import VelocityWish, velocity_program
from .servo.servo import Servo
from .servo.servo_state import Command, ServoState, Status

__all__ = [
    "MOST_LOOKS",
    "BrakingPath",
    "Command",
    "EscapeRoute",
    "EscapeSearch",
    "Feedback",
    "FollowerState",
    "FollowerStatus",
    "NoRejoining",
    "Placements",
    "PlanFollower",
    "Rejoining",
    "RejoiningQuery",
    "RouteSearch",
    "Separation",
    "Servo",
    "ServoState",
    "Status",
    "VelocityRange",
    "VelocityWish",
    "bend",
    "find_rejoining",
    "is_recording",
    "is_still_clear",
    "plan_from_recording",
    "problem_to_show",
    "unrecorded_changes",
    "velocity_program",
    "way_back",
]
