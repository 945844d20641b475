"""The paper's law by its equations, the completed law, and the shield."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
