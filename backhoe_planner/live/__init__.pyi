from .braking.braking_path import BrakingPath, Placements, bend
from .braking.separation import Separation
from .driven import is_driven, left_out, shown_problem
from .follower import Followed, Following, PlanFollower
from .recordings import recorded_plan
from .recovery.escape import MOST_LOOKS, EscapeRoute, EscapeSearch, RouteSearch
from .recovery.violation_descent import way_back
from .rejoining import NoRejoining, Rejoining, RejoiningQuery, find_rejoining, is_still_clear
from .servo.feedback import Feedback
from .servo.servo import Servo
from .servo.servo_state import Command, ServoState, Status

__all__ = [
    "MOST_LOOKS",
    "BrakingPath",
    "Command",
    "EscapeRoute",
    "EscapeSearch",
    "Feedback",
    "Followed",
    "Following",
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
    "bend",
    "find_rejoining",
    "is_driven",
    "is_still_clear",
    "left_out",
    "recorded_plan",
    "shown_problem",
    "way_back",
]
