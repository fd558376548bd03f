"""Calibrations of a stereo pair, of the suite and of other programs, and the rectification of its images.

R and P are the rotation and the projection matrix of a rectified camera. A `PosedCamera` has intrinsics and a pose,
from which R and P are computed (`stereo_calibration`). A `RectifiableCamera` has intrinsics, R and P, as in
sensor_msgs/CameraInfo (`rectification`). A `RectifiedCamera` has only P (`camera_info`). Two of them give the
`StereoRig` and, for raw images, the `StereoRectifier`.

    messages    CameraInfo ─► RectifiedCamera or RectifiableCamera ─► rig, rectifier     rectification.rig_of_..._infos
    file        programs ─► CameraPair ─► StereoCalibration (rig, rectifier)             calibration_file
"""
