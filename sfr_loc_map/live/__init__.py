"""What a run looks like while it goes on: its state, and the server that shows it. Knows no ROS."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
