"""Terrain mapping: a point cloud from up to three stereo pairs.

The flow, file by file (`mapper.Mapper` calls them in this order):

    process(pair):  checks -> disparity/semi_global_matching -> disparity/variational_refinement
                    (rectification_correction, photometric_residual, regularisation, conjugate_gradient)
                    -> disparity/uncertainty -> disparity/validity (occlusion, edge_evidence, edge_network)
                    -> disparity/hole_filling -> reprojection
    fuse(maps):     multiview/registration -> multiview/fusion (view_reprojection, pose_agreement)
    products:       terrain/elevation, terrain/grid (cells, hazard)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
