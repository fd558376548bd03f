"""Terrain mapping: a point cloud from up to three stereo pairs, and elevation and hazard grids of a cloud.

Modules in the order of the calls:

    mapper                `Mapper`, which lists the stages
      checks              input that cannot be mapped is refused
      disparity           the disparity map of a pair
      pair_view           the points of a pair: reprojection
      calibration_sigma   the uncertainty of the calibration
      point_sigma         sigma of the points, with a list of all contributions
      pair_findings       statistics and warnings (`findings`)
      multiview           the fusion of several pairs
    maps                  the results: the map of a pair, and of several pairs
    point_covariance      covariances of points, from a cloud
    terrain               elevation and hazard grids, from a cloud

Trials of constants are listed by name in measurements/mapper_trials.md. Constants without a trial or a citation were
chosen by hand.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
