"""Studies: one scene or job planned many times, with parameters that differ from row to row."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
