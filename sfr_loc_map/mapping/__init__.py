"""Terrain mapping: a point cloud from up to three stereo pairs, and elevation and hazard grids of a cloud.

`mapper` lists the stages in the order of the calls, with the module of each. `disparity` has those of the images of one
pair, `multiview` those of several pairs, and `terrain` the grids. `point_sigma` lists all that makes the sigma of a
point.

A name that begins with an underscore is used in its module alone. Values that a module returns have types without one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
