from .application import app
from .entry import main
from .plan_summary import describe_quantity

__all__ = [
    "app",
    "describe_quantity",
    "main",
]
