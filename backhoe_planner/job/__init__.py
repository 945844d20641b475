"""Jobs: ground that changes, cuts that can be dug, and cycles from the first cut to the last."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
