"""The deviation of the right camera from a rectified camera with the exposure of the left camera.

Modules in the order of the calls:

    right_image_correction    the exposure and the vertical disparity are removed from the right image
    rotation                  the rotation of the camera that explains the vertical disparity
    vertical_disparity        a polynomial that is fitted to the vertical disparity, for both
"""
