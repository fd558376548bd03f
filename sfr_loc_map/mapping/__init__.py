"""Terrain mapping: a point cloud from up to three stereo pairs.

The flow in the order of the calls; each name is a module:

    Mapper(rig):    disparity/semi_global_matching            search_range: disparities that are searched and kept
    process(pair):  checks                                    images that cannot be matched are refused
                    disparity/estimation                      estimate_disparity:
                        semi_global_matching                      initial disparity
                        cell_field                                initial field on cells of 2 x 2 pixels
                        right_image_correction                  corrected right image
                        variational_refinement                    refined disparity, which fits both images, by
                            (photometric_residual, smoothness)
                        uncertainty                               standard deviation of each disparity
                        saturation                                saturated pixels
                        validity (segments, wrong_surface)        valid disparities
                        texture                                   fraction of the textured pixels that are valid
                    checks                                    pairs that do not match are refused
                    disparity/right_camera                    rotation of the right camera
                    disparity/hole_filling                    holes take the surface beside them
                    disparity/right_camera                    without_roll: the effect of a roll is removed
                    reprojection                              points in LM
                    point_sigma                               sigma with saturation and calibration
                    pair_findings                             figures and warnings
    fuse(maps):     multiview/fixed_content, registration, fusion (pair_view), then point_sigma
    products:       terrain/elevation, terrain/grid, point_covariance

`mapper` names the method and the papers that it follows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
