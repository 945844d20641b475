from .entry import app as app
from .entry import main as main
from .plan_summary import describe_quantity as describe_quantity
