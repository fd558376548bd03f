"""Fusion of the views of up to three stereo pairs (`Mapper.fuse`).

Modules in the order of the calls:

    fixed_content         content that is fixed to the image is removed
    registration          on request, each later pair is moved to agree with the earlier pairs
    fusion                points on which pairs agree are averaged; conflicting points and duplicates are dropped
      projection          what a view observes at the points of another view
      pose_agreement      agreement of the poses where pairs overlap
"""
