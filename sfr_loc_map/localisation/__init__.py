"""Stereo visual localisation: a trajectory from a sequence of stereo pairs.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser.process` (`localiser.py`) takes one stereo
pair and returns one `PoseEstimate`:

1. Landmarks are pixels of keyframes with an inverse depth and the slope of their local plane (`frontend/landmarks.py`).
2. A new pair is aligned with at most 200 landmarks jointly (direct image alignment as in SVO, Forster et al. 2017).
   The patches of at most 800 landmarks (all landmarks in a keyframe) are then tracked by least squares in both images
   (Lucas and Kanade 1981; `frontend/`).
3. The pose is estimated from all observations, with robust weights (Geman and McClure 1985) and the uncertainty of each
   landmark (`frontend/pose_solver.py`).
4. Landmarks of another rigid motion are excluded (`ground/selection.py`). Guards check the images and the pose
   (`guards.py`).
5. The keyframes of the window are adjusted jointly, and keyframes that leave the window are marginalised as in OKVIS
   (Leutenegger et al. 2015; `keyframes.py`, `backend/`). The rotation error of the right camera is estimated online
   (`backend/online_calibration.py`).
6. The covariance of each pose and each step is composed of named error sources (`uncertainty/`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
