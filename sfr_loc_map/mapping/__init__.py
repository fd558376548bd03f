"""Terrain mapping: a point cloud from up to three stereo pairs, and elevation and hazard grids of a cloud.

`mapper` lists the stages in the order of their calls, with their modules and results. The stages that estimate and
change disparities are in `disparity`, the stages for several pairs in `multiview`, and the grids in `terrain`.
`point_sigma` lists all contributions to the sigma of a point. The results of the mapper are in `maps`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
