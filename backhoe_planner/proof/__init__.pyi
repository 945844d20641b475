from .certificate import Certificate, certify, certify_problem
from .limits import LimitUse, describe_ratio
from .segments import TOUCH, path_segment_is_clear, segment_is_clear

__all__ = [
    "TOUCH",
    "Certificate",
    "LimitUse",
    "certify",
    "certify_problem",
    "describe_ratio",
    "path_segment_is_clear",
    "segment_is_clear",
]
