"""Stereo visual localisation: a trajectory from a sequence of stereo pairs.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser.process` takes one stereo pair and returns
one `PoseEstimate`. The docstring of `localiser.py` lists the stages of a pair and their sources. The packages are:

- `frontend`: measurements in one pair, and its pose
- `backend`: bundle adjustment of the keyframes, and online calibration
- `ground`: which of the motions in an image is the ground's
- `uncertainty`: error sources and covariances
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
