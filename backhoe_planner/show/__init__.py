"""Rooms to look into: pages, the live view, and plots. The planner never imports it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
