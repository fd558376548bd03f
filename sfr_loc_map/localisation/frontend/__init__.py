"""Measurements in a stereo pair, and its pose.

Each pair, from its images to a pose (`tracking`):

| step | modules | result |
|---|---|---|
| pyramids of both images | `stereo_frame`, `pyramid` | `StereoFrame` |
| alignment of the pose with the grey levels of 200 patches, coarse to fine | `photometric_alignment` | pose |
| tracking of each patch, warped by its local plane, in both images | `plane_warp`, `patch_tracking` | positions |
| noise of the positions, from the residuals of the patches | `noise` | `StereoObservations` |
| robust least squares of the pose | `pose_solver`, `projection` | `Tracks` |
| yaw of the right camera, shear of the rows | `right_camera` | `PairYaw` |

Each keyframe, from its left image to new landmarks (`keyframes.KeyframeMaker`):

| step | modules | result |
|---|---|---|
| the strongest corner of each cell of a grid, outside masks | `feature_detection`, `masks` | corners |
| search along the rows of the right image | `row_search` | initial disparities |
| patches around the corners | `patch` | `Templates` |
| alternately: slopes of local planes from neighbours, and disparities | `neighbour_slopes`, `patch_tracking` | |
| in large images: slopes from the pixels of each patch | `patch_slopes` | `StereoMatches` (`stereo_matching`) |

`landmarks` contains the landmarks of the map that are tracked.
"""
