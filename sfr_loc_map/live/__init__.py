"""Views of a run in progress: its state, the page with its server, the terminal, Foxglove. Imports no ROS."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
