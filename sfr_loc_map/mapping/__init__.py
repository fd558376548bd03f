"""Terrain mapping: a point cloud from up to three stereo pairs.

The flow in the order of the calls; each name is a module:

    process(pair):  checks                                    images that cannot be matched are refused
                    disparity/estimation                      estimate_disparity:
                        semi_global_matching                      initial disparity
                        variational_refinement                    field that fits both images, by
                            (rectification_correction, photometric_residual, smoothness)
                        uncertainty, saturation                   standard deviation of each disparity
                        validity (edge_evidence), texture         valid disparities
                    checks                                    pairs that do not match are refused
                    disparity/right_camera                    rotation of the right camera
                    disparity/hole_filling                    holes take the surface beside them
                    reprojection                              points in LM
                    stated_sigma                              sigma with saturation and calibration
                    findings                                  figures and warnings
    fuse(maps):     multiview/fixed_content, registration, fusion (pair_view), then stated_sigma
    products:       terrain/elevation, terrain/grid

`mapper` names the method and the papers that it follows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
