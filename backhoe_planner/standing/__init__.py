"""Where to stand: the places from which a job is dug in least time or work. What other rooms use is in __init__.pyi."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
