"""Terrain mapping: a point cloud from up to three stereo pairs.

The flow, file by file (`mapper.Mapper` calls them in this order):

    process(pair):  checks -> disparity/semi_global_matching -> disparity/variational_refinement
                    (right_camera, photometric_residual, smoothness) -> disparity/uncertainty
                    -> disparity/validity (edge_evidence) -> disparity/hole_filling -> reprojection
    fuse(maps):     multiview/fixed_content -> multiview/registration -> multiview/fusion (pair_view)
    products:       terrain/elevation, terrain/grid
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
