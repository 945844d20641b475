"""What a person looks at: pages, the live view, and plots. The planner never imports this package."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
