from .certificate import (
    TOUCH,
    Certificate,
    certify,
    certify_problem,
    path_segment_is_clear,
    segment_is_clear,
    told_part,
)

__all__ = [
    "TOUCH",
    "Certificate",
    "certify",
    "certify_problem",
    "path_segment_is_clear",
    "segment_is_clear",
    "told_part",
]
