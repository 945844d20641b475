from .certificate import Certificate as Certificate
from .certificate import certify as certify
from .certificate import certify_problem as certify_problem
from .clearances import TOUCH as TOUCH
from .clearances import path_segment_is_clear as path_segment_is_clear
from .clearances import segment_is_clear as segment_is_clear
from .limits import LimitUse as LimitUse
from .limits import describe_ratio as describe_ratio
