"""Stereo visual localisation: a trajectory from a sequence of stereo pairs.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser.process` takes one stereo pair and returns
one `PoseEstimate`. The docstring of `localiser.py` lists the stages of a pair and their sources, and states where a
pair is refused, which reason is published, and what enlarges the covariance.

| modules | content |
|---|---|
| `localiser`, `config`, `estimate` | the interface: `Localiser`, its parameters and its results |
| `visualisation` | the drawing of an estimate |
| `stale_images`, `guards`, `findings` | checks of images and poses, and the table of their consequences |
| `state` | the state between two pairs, and all of its changes |
| `path` | poses so far, and external poses |
| `motion_model`, `relocalisation` | initial guesses of the next pose, and recovery of lost tracking |
| `frontend` | measurements in one pair, and its pose |
| `ground` | which of the motions in an image is the ground's |
| `keyframes`, `backend` | keyframes, their bundle adjustment, and online calibration |
| `uncertainty` | error sources and covariances |
| `motion_size`, `small_linalg` | mathematical tools of several folders |
| `warm_up` | a small drive that compiles or loads all kernels |

Constants without a stated source were chosen by hand, most of them on rendered drives with injected faults. Most
descriptions state what a larger or a smaller value makes worse.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
