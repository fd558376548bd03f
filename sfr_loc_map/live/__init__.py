"""Views of a run in progress: state, page and server, terminal, Foxglove. This package does not import ROS."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
