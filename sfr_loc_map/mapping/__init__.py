"""Terrain mapping: a point cloud from up to three stereo pairs, and elevation and hazard grids of a cloud.

`mapper` lists the stages in the order of their calls, with their modules. The stages for the images of one pair are in
`disparity`, the stages for several pairs in `multiview`, and the grids in `terrain`. `point_sigma` lists all
contributions to the sigma of a point. The stages exchange the values of `disparity.disparity_map`, `pair_view` and
`findings`, and the results of the mapper are in `maps`.

Names with a leading underscore are private to their module. The types of returned values have public names.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
