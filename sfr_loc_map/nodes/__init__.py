"""The ROS 2 nodes and the processes around them; the only package that imports ROS."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
