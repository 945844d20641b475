"""The surroundings of the machine: the scene file, obstacles, and distances to them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
