"""From tracked keyframes to a map: the sliding window, its bundle adjustment, and the calibration of the right camera.

A pair that becomes a keyframe passes through five steps (`keyframes.KeyframeMaker.make`):

| step | function | effect |
|---|---|---|
| 1 | `SlidingWindow.deactivated` | outliers are no longer tracked |
| 2 | `SlidingWindow.with_keyframe` | the pose and its observations are added; the oldest keyframe is marginalised |
| 3 | `OnlineCalibration.with_window_yaw` | the yaw of the previous adjustment is filtered |
| | `SlidingWindow.with_yaw_corrected` | the right observations are corrected by a step of the yaw |
| 4 | `SlidingWindow.with_landmarks` | stereo matches become landmarks (`with_matches`: pitch and roll) |
| 5 | `SlidingWindow.adjusted` | the bundle adjustment estimates all unknowns together |

| unknown of the adjustment | number | treatment |
|---|---|---|
| pose of a keyframe | 6 for each keyframe of the window | estimated; the first pose of a window is held fixed |
| landmark: host pixel and inverse depth | 3 for each of some thousand landmarks | eliminated (Schur complement) |
| offset of the right images along the rows | 1 | taken as zero for poses and landmarks, and estimated after them |

| result of the adjustment | is used by |
|---|---|
| poses, landmarks and their covariances | tracking of the next pairs (`LandmarkMap`) |
| `LandmarkMap.covariance` of the newest pose | covariance of poses (term `keyframes` of `uncertainty`) |
| `LandmarkMap.last_motion` with its covariance | covariance of steps |
| `LandmarkMap.right_offset` | yaw of the right camera, with the next keyframe (`YawEstimate.with_window`) |
| `SlidingWindow.prior` | the next adjustments: information of keyframes and landmarks that have left the window |

No step changes a value, and each step returns a new value. Some values compute a result on its first use and keep this
result (`cached_property`).
"""
