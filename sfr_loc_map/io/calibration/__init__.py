"""Calibrations of a stereo pair, of the suite and of other programs, and the rectification of its images.

R and P are the rotation and the projection matrix of a rectified camera. A `PosedCamera` has intrinsics and a pose,
from which R and P are computed (`stereo_calibration`). A `RectifiableCamera` has intrinsics, R and P, as in
sensor_msgs/CameraInfo (`rectification`). A `RectifiedCamera` has only P (`camera_info`). Two cameras are a
`StereoCalibration`, which gives the `StereoRig` and, for raw images, the `StereoRectifier`. `calibration_file` reads a
file of any program in `programs`.
"""
