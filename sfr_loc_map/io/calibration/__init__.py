"""Calibrations of a stereo pair, of the suite and of other programs, and the rectification of its images.

R and P are the rotation and the projection matrix of a rectified camera. A `PosedCamera` has intrinsics and a pose,
from which R and P are computed (`stereo_calibration.with_rectification`). A `RectifiableCamera` has intrinsics, R and
P, as in sensor_msgs/CameraInfo. From two of them, `rectification.rig_of_cameras` computes the `StereoRig` and, if the
images are not rectified, the `StereoRectifier`.

    messages    CameraInfo ─► RectifiableCamera ─► rig, rectifier                        rectification.rig_of_infos
    file        programs ─► CameraPair ─► StereoCalibration (rig, rectifier)             calibration_file

`calibration_file` selects the program by the content of the file (`opened_file`), and `programs` has a module for each
program. `projections` checks P and the rig of any format. `rig_file` reads and writes the rig.json of the suite.
"""
